"""The two players that anchor every scale: the random one and the hunter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env.players import Hunter, RandomPlayer
from pneuma.env.worlds import Worlds

from .arena import (
    ARENA,
    ATTACK,
    DOWN,
    GODOT,
    LEFT,
    RIGHT,
    THESIS,
    UP,
    Place,
    begin,
    bits,
    monster_hp,
    stage,
    write_level,
)


def play_out(worlds: Worlds, player: Hunter | RandomPlayer) -> None:
    """Play every world to its end."""
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(player.act(worlds))


# --- The random player ---------------------------------------------------------------------------


def test_the_random_player_chooses_every_action_equally_often() -> None:
    worlds = Worlds(5000)
    counts = np.bincount(RandomPlayer(np.random.default_rng(0)).act(worlds)[:, 0], minlength=5)
    # 1000 of each expected; chi-square with 4 degrees of freedom is above 18.5 once in a thousand.
    assert ((counts - 1000) ** 2 / 1000).sum() < 18.5


def test_the_random_player_knows_the_spells_where_there_are_any() -> None:
    worlds = Worlds(7000, make_env_config({"magic": True}))
    counts = np.bincount(RandomPlayer(np.random.default_rng(0)).act(worlds)[:, 0], minlength=7)
    # 1000 of each expected; chi-square with 6 degrees of freedom is above 22.5 once in a thousand.
    assert len(counts) == 7 and ((counts - 1000) ** 2 / 1000).sum() < 22.5


def test_the_random_player_is_as_random_as_its_generator() -> None:
    worlds = Worlds(4, make_env_config({"players": 2}))
    one, same, other = (RandomPlayer(np.random.default_rng(seed)) for seed in (3, 3, 4))
    actions = one.act(worlds)
    assert actions.shape == (4, 2)
    assert np.array_equal(actions, same.act(worlds))
    assert not np.array_equal(actions, other.act(worlds))


def test_the_random_player_kills_fewer_than_three_on_average() -> None:
    worlds = Worlds(120)
    worlds.seed(range(120))
    worlds.reset(starts=np.arange(120) % 6)
    play_out(worlds, RandomPlayer(np.random.default_rng(0)))
    assert worlds.players["kills"].mean() < 3


# --- The hunter ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "level", "players"),
    [
        *((env_id, "thesis", players) for env_id in (THESIS, GODOT, ARENA) for players in (1, 2)),
        *((THESIS, f"random:test:{number}", 1) for number in (1, 4)),
        *((THESIS, f"random:test:{number}", 2) for number in (0, 5)),
    ],
)
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, level: str, players: int) -> None:
    settings: dict[str, Any] = {"level": level, "players": players, "end_on_clear": True, "start": "random"}
    worlds = Worlds(6, make_env_config(settings, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    play_out(worlds, Hunter(worlds))
    assert [worlds.ending(i) for i in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()


@pytest.mark.parametrize(
    ("place", "way"),
    [
        ((250.0, 20.0), RIGHT),
        ((-250.0, 20.0), LEFT),
        ((20.0, 250.0), DOWN),
        ((20.0, -250.0), UP),
    ],
)
def test_the_hunter_walks_towards_the_nearest_monster(arena: str, place: Place, way: int) -> None:
    worlds = stage(arena, place, facing=(way + 1) % 4)
    assert Hunter(worlds).act(worlds).tolist() == [[way]]


def test_the_hunter_strikes_what_its_sword_would_meet(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), facing=RIGHT)
    assert Hunter(worlds).act(worlds).tolist() == [[ATTACK]]
    worlds.monsters["hp"][0, 0] = 0  # but not the dead
    assert Hunter(worlds).act(worlds).tolist() != [[ATTACK]]


def test_the_hunter_gets_round_an_obstacle(arena: str) -> None:
    # The obstacle, x 256 … 320 and y 0 … 64, lies straight between the two; the monster stays.
    worlds = stage(arena, (450.0, 32.0), players=[(150.0, 32.0)], still=True)
    hunter = Hunter(worlds)
    for _ in range(60):
        worlds.step(hunter.act(worlds))
    assert monster_hp(worlds, 0) == 0


def test_the_hunter_does_not_drown() -> None:
    worlds = Worlds(6, make_env_config({"level": "random:test:3", "coast": "deadly"}))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    play_out(worlds, Hunter(worlds))
    assert (worlds.players["hp"] > 0).all()


def test_the_hunter_walks_around_a_monster_that_waits_behind_a_tree(tmp_path: Path) -> None:
    """Awake and held up by the tree, it never comes into reach: striking at it would go on for ever."""
    level = write_level(tmp_path / "tree", [(-32.0, 32.0)], [(100.0, 32.0)], [(10, 10)])
    worlds = begin(1, level=level)
    hunter = Hunter(worlds)
    for _ in range(150):
        worlds.step(hunter.act(worlds))
    assert monster_hp(worlds) == 0


def test_every_world_is_hunted_as_if_it_were_alone() -> None:
    company = Worlds(6)
    company.seed(range(6))
    company.reset(starts=np.arange(6))
    hunter = Hunter(company)
    for _ in range(300):
        company.step(hunter.act(company))
    for start in range(6):
        alone = Worlds(1)
        alone.seed([start])
        alone.reset(starts=np.array([start]))
        hunter = Hunter(alone)
        for _ in range(300):
            alone.step(hunter.act(alone))
        assert np.array_equal(alone.players["x"][0], company.players["x"][start])
        assert np.array_equal(alone.players["kills"][0], company.players["kills"][start])


@pytest.mark.parametrize(("count", "levels", "players"), [(5, 3, 1), (3, 3, 1), (4, 2, 2)])
def test_every_world_is_hunted_by_its_own_level(count: int, levels: int, players: int) -> None:
    settings: dict[str, Any] = {"level": "random:train:3", "players": players}
    company = begin(count, seed=9, random_levels=levels, **settings)
    drawn = company.worlds["level"].tolist()
    assert len(set(drawn)) > 1
    alone = []
    for world in range(count):
        level = f"random:train:{3 + drawn[world]}"
        alone.append(Worlds(1, make_env_config({**settings, "level": level})))
        alone[world].reset(starts=company.worlds["start"][world : world + 1].astype(np.int64))
    hunters = [Hunter(worlds) for worlds in (company, *alone)]
    for _ in range(400):
        company.step(hunters[0].act(company))
        for worlds, hunter in zip(alone, hunters[1:], strict=True):
            worlds.step(hunter.act(worlds))
    for world, worlds in enumerate(alone):
        assert bits(worlds.players) == bits(company.players[world : world + 1])
    assert (company.players["kills"] > 0).any()


def test_a_world_without_monsters_can_be_played(tmp_path: Path) -> None:
    level = write_level(tmp_path / "empty", [(0.0, 0.0)], [])
    worlds = begin(2, level=level, episode_steps=5)
    play_out(worlds, Hunter(worlds))
    assert [worlds.ending(world) for world in range(2)] == ["time-limit"] * 2
