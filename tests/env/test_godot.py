"""PneumaGodot-v0: the published code's environment with its quirks (facts.md section 1)."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from pneuma.env.gym import PneumaEnv

from .arena import ATTACK, GODOT, LEFT, RIGHT, begin, move_monster, play, player_hp, stage


@pytest.mark.parametrize("action", [LEFT, RIGHT])
def test_who_walks_one_way_for_ever_is_bitten_to_death_as_the_collapsed_logs_are(action: int) -> None:
    """Six of the published logs end with episodes of 93 to 115 steps in the mean."""
    worlds = begin(1, env_id=GODOT)
    while worlds.ending(0) == "running":
        play(worlds, action)
    assert (worlds.ending(0), worlds.worlds["steps"][0]) == ("killed", 111)


def test_xp_outlives_an_unseeded_reset_and_not_a_seeded_one() -> None:
    env = PneumaEnv(GODOT)
    env.reset(seed=0)
    env.state.players["xp"] = -7.0
    assert env.reset()[0][3] == -7.0
    env.step(np.int64(ATTACK))
    assert env.reset()[0][3] == -7.0
    assert env.reset(seed=0)[0][3] == 0.0


def test_clearing_the_level_costs_1_xp_and_terminates() -> None:
    env = PneumaEnv(GODOT)
    env.reset(seed=0)
    worlds = env.state
    worlds.players["facing"], worlds.players["xp"] = RIGHT, 4
    worlds.monsters["hp"] = 0
    worlds.monsters["hp"][0, 0], worlds.monsters["bite"][0, 0, 0] = 20, 30
    worlds.worlds["monsters_left"] = 1
    move_monster(worlds, 0, 204.0 + 54, -105.0)
    _, paid, terminated, truncated, info = env.step(np.int64(ATTACK))
    assert (terminated, truncated, paid) == (True, False, 4.0)
    assert (info["ending"], info["kills"], info["xp"], info["hp"]) == ("cleared", 1, 4.0, 107.0)  # 4 + 1 - 1
    with pytest.raises(ResetNeeded):
        env.step(np.int64(ATTACK))


def test_the_time_limit_terminates_and_costs_1_xp() -> None:
    env = PneumaEnv(GODOT, episode_steps=3)
    env.reset(seed=0)
    ends = [env.step(np.int64(ATTACK)) for _ in range(3)]
    assert [end[1:4] for end in ends] == [(0.0, False, False), (0.0, False, False), (-1.0, True, False)]
    assert (ends[2][4]["ending"], ends[2][4]["xp"]) == ("time-limit", -1.0)


@pytest.mark.parametrize(("x", "paid"), [(62.0, True), (62.5, False)])  # 40 px off the body, and more
def test_a_kill_earns_only_within_the_attack_circle(arena: str, x: float, paid: bool) -> None:
    worlds = stage(arena, (x, 0.0), ticks=1, still=True, env_id=GODOT)
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, LEFT, RIGHT)  # it has stood there for a tick
    worlds.players["xp"], worlds.players["hp"] = 4, 50
    play(worlds, ATTACK)
    assert (worlds.players["xp"][0, 0], player_hp(worlds)) == ((5, 57) if paid else (4, 50))
    assert worlds.players["kills"][0, 0] == 1  # it is a kill all the same
    assert worlds.events["reward"][0, 0] == (5 if paid else 0)  # set to the XP of who earns it
