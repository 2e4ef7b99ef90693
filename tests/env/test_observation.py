"""Observations in every layout, order and scale, of all monsters or of some."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

from pneuma.env.fields import OBSERVATIONS, ORDERS, SCALES
from pneuma.env.worlds import Worlds

from .arena import GODOT, RIGHT, STAND, THESIS, Place, begin, play, stage

WIDTHS = {"thesis": (4, 4), "pygame": (6, 5), "godot": (4, 5)}  # of the player's part and of a monster's


def look(level: str, *monsters: Place, players: tuple[Place, ...] = ((0.0, 0.0),), **settings: Any) -> Worlds:
    """Set up a world in which nothing moves and observe it."""
    worlds = stage(level, *monsters, players=players, still=True, settings=settings)
    play(worlds, STAND)
    return worlds


def seen(worlds: Worlds) -> np.ndarray:
    return np.asarray(worlds.observations[0, 0])


def rows(worlds: Worlds) -> np.ndarray:
    """Return the monsters' part of what the first player sees, a row each."""
    head, width = WIDTHS[worlds.config.observation]
    return seen(worlds)[head:].reshape(-1, width)


def test_the_godot_environment_begins_with_74_published_numbers() -> None:
    worlds = begin(1, env_id=GODOT)
    assert seen(worlds)[:4].tolist() == [204, -105, 100, 0]
    assert rows(worlds).shape == (14, 5)
    # The first monster is at (-538, -531): (742, 426) to the player, 855.59 px.
    assert rows(worlds)[0] == pytest.approx([-538, -531, 40, 742 / 855.593, 426 / 855.593], abs=1e-5)
    assert rows(worlds)[13, :3].tolist() == [560, -141, 40]


def test_pygame_sees_facing_energy_and_what_monsters_are_worth(zoo: str) -> None:
    worlds = stage(zoo, (-300.0, 400.0), still=True, settings={"observation": "pygame", "magic": True})
    worlds.players["hp"], worlds.players["energy"] = 43, 15
    play(worlds, RIGHT)
    worlds.players["x"], worlds.players["energy"] = 0.0, 15
    worlds.observe()
    # The map of 20 x 20 tiles is 1280 px wide and high. Of 100 HP, 60 energy.
    assert seen(worlds)[:6] == pytest.approx([0.5, 0.5, 1, 0, 0.43, 0.25])
    # The bamboo is 500 px away along (-0.6, 0.8); the dearest, the raccoon, is worth 25 XP.
    assert rows(worlds)[0] == pytest.approx([500 / 1280, -0.6, 0.8, 1, 1 / 25])


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
    worlds = look(arena, (-240.0, -130.0), players=((-540.0, 270.0),), scale=scale)
    worlds.players["hp"], worlds.players["xp"] = 40, 3
    worlds.monsters["hp"][0] = [20, 0, 0, 0]
    worlds.observe()
    assert seen(worlds)[:4] == pytest.approx([x, y, hp, xp], abs=1e-6)
    assert rows(worlds)[0] == pytest.approx([distance, 0.6, -0.8, monster_hp], abs=1e-6)  # (300, -400)


@pytest.mark.parametrize(
    ("perceive", "distances"),
    [
        ("kind:spirit", [110]),
        ("kind:squid,bamboo", [90, 300]),
        ("kind:raccoon,spirit,squid", [110, 180, 300]),
    ],
)
def test_monsters_may_be_perceived_by_kind(zoo: str, perceive: str, distances: list[float]) -> None:
    places = (0.0, 90.0), (-110.0, 0.0), (180.0, 0.0), (0.0, -300.0)  # bamboo, spirit, raccoon, squid
    worlds = look(zoo, *places, perceive=perceive, scale="raw")
    assert rows(worlds)[:, 0].tolist() == pytest.approx(distances)
    worlds = look(zoo, *places, perceive=perceive, scale="raw", order="fixed")
    assert rows(worlds)[:, 0].tolist() == pytest.approx(sorted(distances))  # they stand in this order
    assert worlds.space.contains(seen(worlds))


SEEN_AS = [
    (env_id, {"observation": layout, "scale": scale, "order": order})
    for layout, scale in product(OBSERVATIONS, SCALES)
    for env_id, order in zip((THESIS, GODOT), ORDERS, strict=True)
]
OTHER_RULES = {"coast": "deadly", "trees": "pass", "bodies": "pass", "scale": "raw"}
RAYS = [(env_id, {"perceive": "rays:16", **own}) for env_id in (THESIS, GODOT) for own in ({}, OTHER_RULES)]


@pytest.mark.parametrize(("env_id", "seen_as"), [*SEEN_AS, *RAYS], ids=str)
def test_no_observation_ever_leaves_its_space(env_id: str, seen_as: dict[str, Any]) -> None:
    two: dict[str, Any] = {"players": 2, "classes": ["base", "tank"], "start": "random", "episode_steps": 150}
    worlds = begin(6, env_id=env_id, magic=True, **{**two, **seen_as})
    for space in worlds.spaces:
        assert space.dtype == np.float32 and np.isfinite(space.low).all() and np.isfinite(space.high).all()
    generator = np.random.default_rng(2)
    stride = generator.integers(7, size=(6, 2))
    endings = 0
    for _ in range(400):
        stride = np.where(generator.random((6, 2)) < 0.1, generator.integers(7, size=(6, 2)), stride)
        endings += worlds.step(stride)
        for player, space in enumerate(worlds.spaces):
            here = worlds.observations[:, player]
            assert (here >= space.low).all() and (here <= space.high).all()
        worlds.reset(worlds.worlds["ending"] != 0)
    assert endings > 5


def test_rays_tell_what_they_meet_first_and_how_far_off_it_is(zoo: str) -> None:
    # A bamboo 100 px to the right: its body begins 12 px before. A raccoon behind it is not seen. A dead
    # squid below is nothing; down there the coast begins at 576. A player at (-200, 200), down and left, has
    # a body from -225 to -178 and from 178 to 226, so the diagonal enters it at (-178, 178).
    places = (100.0, 0.0), (0.0, -500.0), (250.0, 0.0), (0.0, 200.0)  # bamboo, spirit, raccoon, squid
    worlds = look(zoo, *places, players=((0.0, 0.0), (-200.0, 200.0)), perceive="rays:8", scale="raw")
    worlds.monsters["hp"][0, 3] = 0
    worlds.observe()
    assert worlds.space.shape == (4 + 8 * (1 + 6),)
    rays = seen(worlds)[4:].reshape(8, 7)
    terrain, player, bamboo, spirit = 0, 1, 2, 4  # kinds by name: bamboo, raccoon, spirit, squid
    assert rays[:, 1:].argmax(axis=1).tolist() == [
        bamboo, terrain, terrain, player, terrain, terrain, spirit, terrain,
    ]  # fmt: skip
    assert rays[:, 1:].sum(axis=1).tolist() == [1] * 8
    spirit_ends = worlds.monster_stats[0, 1]["body_y"] + worlds.monster_stats[0, 1]["half_height"]
    corner = 576 * np.sqrt(2)
    assert rays[:, 0] == pytest.approx(
        [88, corner, 576, 178 * np.sqrt(2), 576, corner, 500 - spirit_ends, corner]
    )


@pytest.mark.parametrize(("scale", "unit"), [("unit", 300), ("map", 1280), ("raw", 1)])
def test_rays_end_at_trees_and_at_a_sea_that_drowns(arena: str, scale: str, unit: float) -> None:
    # The obstacle is from 256 to 320 and from 0 to 64; of 4 rays the first goes right, the second down.
    worlds = look(
        arena, players=((100.0, 30.0),), perceive="rays:4", scale=scale, coast="deadly", observe_facing=True
    )
    rays = seen(worlds)[8:].reshape(4, 4)  # one kind of monster
    assert rays[:, 1].tolist() == [1, 1, 1, 1]
    assert rays[:, 0] * unit == pytest.approx([156, 546, 676, 606], rel=1e-6)
    passed = look(arena, players=((100.0, 30.0),), perceive="rays:4", scale=scale, trees="pass")
    assert seen(passed)[4] * unit == pytest.approx(476)
