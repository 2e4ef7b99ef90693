"""Observations by hand, in every layout and scale, of all monsters or of some."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pneuma.env import layouts
from pneuma.env.worlds import Worlds

from .arena import ARENA, EMPTY, FLAME, GODOT, HEAL, RIGHT, THESIS, begin, play, stage

WIDTHS = {"thesis": (4, 4), "pygame": (6, 5), "godot": (4, 5)}  # of the player's part and of a monster's


def rows(worlds: Worlds) -> np.ndarray:
    """Return the monsters' part of what the first player sees, a row each."""
    head, width = WIDTHS[worlds.config.observation]
    return np.asarray(worlds.observations[0, 0, head:].reshape(-1, width))


def test_the_godot_environment_begins_with_74_published_numbers() -> None:
    worlds = begin(1, env_id=GODOT)
    assert worlds.observations[0, 0, :4].tolist() == [204, -105, 100, 0]
    assert rows(worlds).shape == (14, 5)
    # The first monster is at (-538, -531): (742, 426) to the player, 855.59 px.
    assert rows(worlds)[0] == pytest.approx([-538, -531, 40, 742 / 855.593, 426 / 855.593], abs=1e-5)
    assert rows(worlds)[13, :3].tolist() == [560, -141, 40]


def test_pygame_sees_facing_energy_and_what_monsters_are_worth(zoo: str) -> None:
    pair = stage(zoo, (-300.0, 400.0), facing=RIGHT, observation="pygame")
    pair.put(hp=43, energy=15)
    # The map of 20 x 20 tiles is 1280 px wide and high. Of 100 HP, 60 energy.
    assert pair.worlds.observations[0, 0, :6] == pytest.approx([0.5, 0.5, 1, 0, 0.43, 0.25])
    # The bamboo is 500 px away along (-0.6, 0.8); the dearest, the raccoon, is worth 25 XP.
    assert rows(pair.worlds)[0] == pytest.approx([500 / 1280, -0.6, 0.8, 1, 1 / 25])


@pytest.mark.parametrize(
    ("scale", "x", "y", "hp", "xp", "distance", "monster_hp"),
    [
        ("unit", -540 / 576, 270 / 576, 0.4, 3 / 4, 500 / 300, 0.5),
        ("map", 100 / 1280, 910 / 1280, 0.4, 3 / 4, 500 / 1280, 0.5),
        ("raw", -540, 270, 40, 3, 500, 20),
    ],
)
def test_a_scale_holds_for_every_number(
    arena: str, scale: str, x: float, y: float, hp: float, xp: float, distance: float, monster_hp: float
) -> None:
    pair = stage(arena, (-240.0, -130.0), scale=scale)
    pair.put(monsters=True, hp=[20, 0, 0, 0])
    pair.put(x=-540, y=270, hp=40, xp=3)
    assert pair.worlds.observations[0, 0, :4] == pytest.approx([x, y, hp, xp], abs=1e-6)
    assert rows(pair.worlds)[0] == pytest.approx([distance, 0.6, -0.8, monster_hp], abs=1e-6)  # (300, -400)


@pytest.mark.parametrize(("spell", "cost"), [(FLAME, 20), (HEAL, 10)])
@pytest.mark.parametrize(("missing", "allowed"), [(0.0, True), (0.26, True), (0.3, False)])
def test_a_spell_is_allowed_if_it_can_be_paid_at_the_last_tick_of_a_step(
    arena: str, spell: int, cost: float, missing: float, allowed: bool
) -> None:
    """A player gains 0.6 energy a second a point of magic, of which it has 4: 0.28 in seven ticks."""
    pair = stage(arena, magic=True)
    pair.put(energy=cost - missing, hp=50)
    assert bool(pair.worlds.masks[0, 0, spell]) == allowed
    play(pair.worlds, spell)
    assert bool(pair.worlds.players["energy"][0, 0] < 1) == allowed  # it was paid


@pytest.mark.parametrize("env_id", [ARENA, THESIS, GODOT])
def test_no_bound_of_a_space_is_minus_zero(env_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To processors of ARM -0 is the lesser of 0 and -0, to those of Intel the second of both."""

    def minimum_of_arm(a: np.ndarray, b: float) -> np.ndarray:
        return np.where((a == b) & np.signbit(a), a, np.minimum(a, b))

    monkeypatch.setattr(layouts, "np", SimpleNamespace(**{**vars(np), "minimum": minimum_of_arm}))
    space = begin(1, env_id=env_id).space
    bounds = np.concatenate([space.low, space.high])
    assert not np.signbit(bounds[bounds == 0]).any()


def test_rays_show_what_they_meet_first_and_how_far_off_it_is(zoo: str) -> None:
    # A bamboo 100 px to the right: its body begins 12 px before. A raccoon behind it is not seen. A dead
    # squid below is nothing; down there the coast begins at 576. A player at (-200, 200), down and left, has
    # a body from -225 to -178 and from 178 to 226, so the diagonal enters it at (-178, 178).
    places = (100.0, 0.0), (0.0, -500.0), (250.0, 0.0), (0.0, 200.0)  # bamboo, spirit, raccoon, squid
    pair = stage(zoo, *places, players=2, perceive="rays:8", scale="raw")
    pair.put(x=(0.0, -200.0), y=(0.0, 200.0))
    pair.put(monsters=True, hp=[40, 1, 1, 0])
    rays = pair.worlds.observations[0, 0, 4:].reshape(8, 1 + 6)
    terrain, player, bamboo, spirit = 0, 1, 2, 4  # kinds by name: bamboo, raccoon, spirit, squid
    met = [bamboo, terrain, terrain, player, terrain, terrain, spirit, terrain]
    assert np.array_equal(rays[:, 1:], np.eye(6)[met])
    stats, corner = pair.worlds.monster_stats[0, 1], 576 * np.sqrt(2)
    spirit_ends = float(stats["body_y"] + stats["half_height"])
    far = [88, corner, 576, 178 * np.sqrt(2), 576, corner, 500 - spirit_ends, corner]
    assert rays[:, 0] == pytest.approx(far)


@pytest.mark.parametrize(
    ("obstacles", "distance"),
    [([(11, 10)], 32), ([(10, 11)], 32), ([(11, 10), (10, 11)], 32), ([(11, 11)], 32), ([], 544)],
)
def test_a_ray_passes_a_corner_only_between_two_open_tiles(
    obstacles: list[tuple[int, int]], distance: float, tmp_path: Path
) -> None:
    """From the middle of a tile of 64 px its corner is 32 px each way; the coast is at 576."""
    monsters = (("bamboo", -500.0, 0.0),)
    level = replace(EMPTY, starts=((32.0, 32.0),), obstacles=tuple(obstacles), monsters=monsters)
    pair = stage(level.write(tmp_path), perceive="rays:8", scale="raw")
    rays = pair.worlds.observations[0, 0, 4:].reshape(8, -1)
    assert rays[1, 0] == pytest.approx(distance * np.sqrt(2))  # the first goes right, the third down


@pytest.mark.parametrize(("scale", "unit"), [("unit", 300), ("map", 1280), ("raw", 1)])
def test_rays_end_at_trees_and_at_the_sea(arena: str, scale: str, unit: float) -> None:
    # The obstacle is from 256 to 320 and from 0 to 64; of 4 rays the first goes right, the second down.
    rays: dict[str, Any] = {"perceive": "rays:4", "scale": scale}
    pair = stage(arena, **rays)
    pair.put(x=100, y=30)
    numbers = pair.worlds.observations[0, 0, 4:].reshape(4, 4)  # one kind of monster
    assert numbers[:, 0] * unit == pytest.approx([156, 546, 676, 606], rel=1e-6)
