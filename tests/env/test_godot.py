"""PneumaGodot-v0: the published code's environment with its quirks (facts.md section 1)."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env.single import PneumaEnv
from pneuma.env.worlds import Worlds

from .arena import (
    ATTACK,
    GODOT,
    LEFT,
    RIGHT,
    Place,
    move_monster,
    play,
    player_hp,
    stage,
)

FIRST = (204.0, -105.0)


def make(**settings: Any) -> PneumaEnv:
    env = gymnasium.make(GODOT, **settings).unwrapped
    assert isinstance(env, PneumaEnv)
    return env


def xp(worlds: Worlds, player: int = 0, world: int = 0) -> float:
    return float(worlds.players["xp"][world, player])


def reward(worlds: Worlds, player: int = 0) -> float:
    return float(worlds.events["reward"][0, player])


def scene(
    level: str,
    *monsters: Place,
    ticks: int = 8,
    players: tuple[Place, ...] = ((0.0, 0.0),),
    **settings: object,
) -> Worlds:
    """Set up a world by Godot's rules in which monsters stay where they are."""
    return stage(level, *monsters, players=players, ticks=ticks, still=True, env_id=GODOT, settings=settings)


# --- Start ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("action", [LEFT, RIGHT])
def test_who_walks_one_way_for_ever_is_bitten_to_death_as_the_collapsed_logs_are(action: int) -> None:
    """Six of the published logs end with episodes of 93 to 115 steps in the mean."""
    worlds = Worlds(1, make_env_config({}, GODOT))
    worlds.seed([0])
    worlds.reset()
    while worlds.ending(0) == "running":
        worlds.step(np.array([[action]]))
    assert (worlds.ending(0), worlds.worlds["steps"][0]) == ("killed", 111)


# --- XP that is never reset ----------------------------------------------------------------------


def test_xp_outlives_an_unseeded_reset_and_not_a_seeded_one() -> None:
    env = make()
    env.reset(seed=0)
    env.state.players["xp"] = -7.0
    observation, _ = env.reset()
    assert xp(env.state) == observation[3] == -7.0
    env.step(np.int64(ATTACK))
    assert env.reset()[0][3] == -7.0
    assert env.reset(seed=0)[0][3] == 0.0
    assert xp(env.state) == 0.0


# --- Endings -------------------------------------------------------------------------------------


def test_clearing_the_level_costs_1_xp_and_terminates() -> None:
    env = make()
    env.reset(seed=0)
    env.state.players["facing"], env.state.players["xp"] = RIGHT, 4
    env.state.monsters["hp"] = 0
    env.state.monsters["hp"][0, 0] = 20
    env.state.monsters["bite"][0, 0, 0] = 30
    env.state.worlds["monsters_left"] = 1
    move_monster(env.state, 0, FIRST[0] + 54, FIRST[1])
    _, paid, terminated, truncated, info = env.step(np.int64(ATTACK))
    assert (terminated, truncated) == (True, False)
    assert (info["ending"], info["kills"], info["xp"], info["hp"]) == ("cleared", 1, 4.0, 107.0)  # 4 + 1 - 1
    assert paid == 4.0


def test_the_time_limit_terminates_and_costs_1_xp() -> None:
    env = make(episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.int64(ATTACK)) for _ in range(3)]
    assert [(end[2], end[3]) for end in ends] == [(False, False), (False, False), (True, False)]
    assert [end[1] for end in ends] == [0.0, 0.0, -1.0]
    assert (ends[2][4]["ending"], ends[2][4]["xp"]) == ("time-limit", -1.0)


# --- Kills ---------------------------------------------------------------------------------------


def strike(arena: str, x: float, y: float, *others: Place) -> Worlds:
    """Let player 0 with 4 XP and 50 HP, who faces right, kill a monster that has stood there for a tick."""
    worlds = scene(arena, (x, y), ticks=1, players=((0.0, 0.0), *others))
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, LEFT, RIGHT)
    worlds.players["xp"], worlds.players["hp"] = 4, 50
    play(worlds, ATTACK)
    assert worlds.events["kills"][0, 0] == 1
    return worlds


@pytest.mark.parametrize(
    ("x", "paid"),
    [
        (62.0, True),  # 40 px off the body
        (62.5, False),
    ],
)
def test_a_kill_earns_only_within_the_attack_circle(arena: str, x: float, paid: bool) -> None:
    worlds = strike(arena, x, 0.0)
    assert (xp(worlds), player_hp(worlds)) == ((5, 57) if paid else (4, 50))
    assert worlds.players["kills"][0, 0] == 1  # it is a kill all the same
    assert reward(worlds) == (5 if paid else 0)  # set to the XP of who earns it
