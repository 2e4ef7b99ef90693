"""Worlds: the laws that hold whatever is played, starts, and the hunter; the checkers find nothing."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasiums_check
from stable_baselines3.common.env_checker import check_env as sb3s_check

from pneuma.env import MO_ENVIRONMENTS, REGISTERED
from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.pettingzoo import parallel_env
from pneuma.env.players import Hunter
from pneuma.env.worlds import Worlds

from .arena import ARENA, GODOT, RIGHT, THESIS, begin, play

STATE = ("worlds", "players", "monsters", "events", "observations", "masks")


def bits(worlds: Worlds, which: object = slice(None)) -> list[bytes]:
    """Return every bit of some worlds, field by field: what lies between fields is nobody's."""
    arrays = [getattr(worlds, name)[which] for name in STATE]
    return [array[name].tobytes() for array in arrays for name in array.dtype.names or (...,)]


def test_every_world_is_alone_as_in_company() -> None:
    company = begin(6, seed=40)
    alone = [begin(1, seed=40 + i) for i in range(6)]
    hunter, generator = Hunter(company), np.random.default_rng(3)
    for _ in range(400):
        drawn = generator.integers(5, size=(6, 1))
        actions = np.where(generator.random((6, 1)) < 0.5, drawn, hunter.act(company))
        company.step(actions)
        over = company.worlds["ending"] != 0
        for i, world in enumerate(alone):
            world.step(actions[i : i + 1])
            assert bits(world) == bits(company, slice(i, i + 1))
            world.reset(over[i : i + 1])
        company.reset(over)


def test_what_a_mask_leaves_out_is_not_reset() -> None:
    worlds = begin(6)
    play(worlds, RIGHT, RIGHT)
    mask = np.array([True, False, False, True, False, True])
    before = bits(worlds, ~mask)
    worlds.reset(mask)
    assert bits(worlds, ~mask) == before
    assert worlds.worlds["steps"].tolist() == [0, 2, 2, 0, 2, 0]


def test_starts_are_drawn_uniformly_in_one_world_after_another() -> None:
    drawn = begin(3000).worlds["start"]
    counts = np.bincount(drawn, minlength=6)
    # 500 of each expected; chi-square with 5 degrees of freedom is above 20.5 once in a thousand.
    assert len(counts) == 6 and ((counts - 500) ** 2 / 500).sum() < 20.5


def test_a_chosen_start_is_taken_and_draws_no_number() -> None:
    worlds = Worlds(6)
    worlds.seed(range(6))
    worlds.reset(starts=np.array([5, 4, 3, 2, 1, 0]))
    assert worlds.players["x"][:, 0].tolist() == [-47, -918, -517, -239, 389, 204]
    assert worlds.players["y"][:, 0].tolist() == [201, -35, 897, -798, 348, -105]
    assert (worlds.worlds["draws"] == 0).all()


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (lambda worlds: worlds.step(np.full((2, 1), 5)), "are outside 2 of Discrete"),
        (lambda worlds: worlds.step(np.zeros(3, np.int64)), r"actions \[0 0 0\] are outside 2 of"),
        (lambda worlds: worlds.reset(np.ones(2, np.int64)), "mask: must be booleans of shape"),
        (lambda worlds: worlds.reset(starts=np.array([0, 6])), "start 6 is none of the level's 6"),
    ],
)
def test_what_the_rules_could_not_take_is_refused(asked: Callable[[Worlds], object], told: str) -> None:
    """They look nothing up twice: an index that is too large would read beyond an array."""
    worlds = begin(2)
    before = bits(worlds)
    with pytest.raises(ValueError, match=told):
        asked(worlds)
    assert bits(worlds) == before


@pytest.mark.parametrize("players", [1, 2])
@pytest.mark.parametrize("env_id", [THESIS, GODOT, ARENA])
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, players: int) -> None:
    worlds = Worlds(6, make_env_config({"players": players, "end_on_clear": True, "start": "random"}, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    hunter = Hunter(worlds)
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(hunter.act(worlds))
    assert [worlds.ending(i) for i in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()


# --- The checkers of Gymnasium, Stable-Baselines3 and PettingZoo ----------------------------------


@pytest.mark.parametrize("env_id", REGISTERED)
def test_gymnasiums_and_stable_baselines3s_checkers(env_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env: Any = gymnasium.make(env_id, disable_env_checker=True).unwrapped
    if env_id in MO_ENVIRONMENTS:
        monkeypatch.setattr(env, "_reward", lambda: 0.0)  # Gymnasium's checker knows no vectors
    elif env_id in ENVIRONMENTS:
        sb3s_check(env)
    gymnasiums_check(env, skip_render_check=True)  # which would open a window


TEAM = {"magic": True, "dash": True, "second_weapon": "lance", "tokens": 3, "shared_reward": True}


@pytest.mark.parametrize(("env_id", "chosen"), [(THESIS, TEAM), *((env_id, {}) for env_id in ENVIRONMENTS)])
def test_pettingzoos_checker(env_id: str, chosen: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test, parallel_seed_test
    parallel_api_test(parallel_env(env_id=env_id, players=3, **chosen), num_cycles=100)
    parallel_seed_test(lambda: parallel_env(env_id=env_id, players=3, **chosen), num_cycles=100)
