"""Worlds saved and put back elsewhere, and the checks that find what saving forgets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.env.check import check_restore
from pneuma.env.worlds import Snapshot, Worlds
from pneuma.env_fields import make_env_config
from pneuma.errors import UserError

from .arena import GODOT, THESIS, Fighter, begin, state_bits

CONFIGS: dict[str, tuple[str, dict[str, Any]]] = {
    "thesis": (THESIS, {}),
    "three players": (
        THESIS,
        {
            "players": 3,
            "classes": ["tank", "mage", "warrior"],
            "weapons": ["lance", "own", "sai"],
            "magic": True,
        },
    ),
    "random levels": (THESIS, {"level": "random:train:3", "random_levels": 4}),
    "godot": (GODOT, {"players": 2, "start": "random"}),
}
each_config = pytest.mark.parametrize("name", CONFIGS)


def config_of(name: str) -> Any:
    env_id, settings = CONFIGS[name]
    return make_env_config(settings, env_id)


def played(name: str, count: int, steps: int = 150) -> Worlds:
    """Return worlds in the middle of their episodes: players hunt, and stray."""
    env_id, settings = CONFIGS[name]
    worlds = begin(count, seed=60, env_id=env_id, **settings)
    fighter = Fighter(worlds, seed=1)
    for _ in range(steps):
        worlds.step(fighter.act(worlds))
        worlds.reset(worlds.worlds["ending"] != 0)
    return worlds


def plan(worlds: Worlds, steps: int, seed: int = 5) -> np.ndarray:
    """Return actions for one world, (steps, players)."""
    generator = np.random.default_rng(seed)
    kinds = int(worlds.action_space.n)
    return np.repeat(generator.integers(kinds, size=(steps, worlds.players.shape[1])), 2, axis=0)[:steps]


def go_on(worlds: Worlds, world: int, actions: np.ndarray) -> list[bytes]:
    """Play one world on, the others standing, and return every bit of it and of what it tells."""
    told: list[bytes] = []
    for row in actions:
        every = np.full(worlds.players.shape, 4, np.int64)
        every[world] = row
        worlds.step(every)
        told += state_bits(worlds, world)
        worlds.reset(worlds.worlds["ending"] != 0)
    return told


@each_config
def test_a_world_goes_on_the_same_in_another_batch(name: str) -> None:
    worlds, other = played(name, 3), played(name, 7, steps=31)
    saved = worlds.save(2)
    actions = plan(worlds, 200)
    told = go_on(worlds, 2, actions)
    other.restore(6, saved)
    assert go_on(other, 6, actions) == told
    fresh = Worlds(1, config_of(name))  # never reset
    fresh.restore(0, saved)
    assert go_on(fresh, 0, actions) == told


def test_a_world_of_other_levels_or_characters_is_refused() -> None:
    """Equal in numbers of players and monsters, and in the size of the grid."""
    worlds = begin(1)
    others = [
        begin(1, level="random:train:1"),
        begin(1, level="random:train:1", random_levels=2),
        begin(1, classes="tank"),
        begin(1, weapons="axe"),
        begin(1, characters="pygame"),
        begin(1, trees="pass"),  # who stands in a tree there would be stuck here
        begin(1, bodies="pass"),
    ]
    for other in others:
        with pytest.raises(ValueError, match="a state of another"):
            worlds.restore(0, other.save(0))
        with pytest.raises(ValueError, match="a state of another"):
            other.restore(0, worlds.save(0))


# --- The checks find what saving forgets ----------------------------------------------------------


@pytest.mark.parametrize(("array", "field"), [("worlds", "draws"), ("players", "kills"), ("monsters", "hp")])
def test_whatever_saving_forgets_is_found(array: str, field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Even what no observation shows: the number of draws from the random stream, and of kills."""
    save = Worlds.save

    def forgetful(worlds: Worlds, world: int) -> Snapshot:
        snapshot = save(worlds, world)
        getattr(snapshot, array)[field] += 1
        return snapshot

    monkeypatch.setattr(Worlds, "save", forgetful)
    with pytest.raises(UserError, match="put back into another slot"):
        check_restore(THESIS, {})
