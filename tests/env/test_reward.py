"""Rewards: every formula by hand on situations set up for it, and one for each player."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from pneuma.env.reward import load_reward
from pneuma.env.worlds import Worlds

from .arena import (
    ATTACK,
    STAND,
    UP,
    Place,
    move_monster,
    play,
    stage,
)


def rewards(worlds: Worlds) -> list[float]:
    """Return the rewards of the first world's players for the last step."""
    return [float(reward) for reward in worlds.events["reward"][0]]


def fight(arena: str, reward: str | Sequence[str], *monsters: Place, **settings: object) -> Worlds:
    """Set up a player with 3 XP and 50 HP, facing right, and monsters that stay where they are."""
    worlds = stage(arena, *monsters, still=True, settings={"reward": reward, **settings})
    worlds.players["xp"], worlds.players["hp"] = 3, 50
    return worlds


def fly(worlds: Worlds, index: int, x: float, y: float, speed: float) -> None:
    """Put a monster somewhere and let it fly along x, so many pixels a tick, for the next 30."""
    move_monster(worlds, index, x, y)
    monster = worlds.monsters[0, index]
    monster["knocked"], monster["knock_x"], monster["knock_y"] = 30, speed, 0.0


# --- Levels: XP and HP as they are ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("reward", "quiet", "bitten", "killing"),
    [
        ("thesis", 3 - 0.5, 3 - 0.43, 4 - 0.57),
        ("pygame", 3 + 0.5, 3 + 0.43, 4 + 0.57),
    ],
)
def test_xp_and_the_share_of_hp_at_every_step(
    arena: str, reward: str, quiet: float, bitten: float, killing: float
) -> None:
    worlds = fight(arena, reward)
    play(worlds, UP)
    assert rewards(worlds) == [quiet]

    worlds = fight(arena, reward, (-40.0, 0.0))
    play(worlds, STAND)  # a bite of 7
    assert rewards(worlds) == [bitten]

    worlds = fight(arena, reward, (80.0, 0.0))
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, ATTACK)  # 1 XP and 7 HP
    assert rewards(worlds) == [killing]
    play(worlds, STAND)
    assert rewards(worlds) == [killing]


# --- Gains: what the step brought ----------------------------------------------------------------


def test_kills_is_xp_gained_less_the_share_of_hp_lost(arena: str) -> None:
    worlds = fight(arena, "kills", (80.0, 0.0), (-40.0, 0.0))
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, ATTACK)  # 1 XP, and 7 HP lost; those gained do not count
    assert rewards(worlds) == [1 - 0.07]
    play(worlds, STAND)
    assert rewards(worlds) == [0.0]


@pytest.mark.parametrize(
    ("distance", "closeness"),
    [
        (150.0, 0.5),
        (100.0, 0.5 + 0.5 / math.sqrt(2)),  # z = 1
        (200.0, 0.5 - 0.5 / math.sqrt(2)),
        (25.0, 0.5 + 2.5 / 2 / math.sqrt(7.25)),  # z = 2.5
        (250.0, 0.5 - 2 / 2 / math.sqrt(5)),  # z = -2
    ],
)
def test_distance_sigmoid_pays_for_being_near(arena: str, distance: float, closeness: float) -> None:
    worlds = fight(arena, "distance-sigmoid", (-distance, 0.0), (400.0, 400.0))
    play(worlds, STAND)
    assert rewards(worlds) == [pytest.approx(closeness, abs=1e-12)]


# --- Godot: event by event -----------------------------------------------------------------------


def test_godot_sets_the_reward_to_the_xp_at_a_kill(arena: str) -> None:
    # Tick 1: both monsters notice, +2. Tick 5: the first has flown from 96.5 to 88.5, within the sword's 90,
    # and dies: the reward is set to 3 + 1 XP. Tick 6: the other comes within 40 px, +1.
    worlds = fight(arena, "godot")
    fly(worlds, 0, 96.5, 0.0, -2.0)
    fly(worlds, 1, -73.5, 0.0, 2.0)
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, ATTACK)
    event = worlds.events[0, 0]
    assert (event["notices"], event["kills"], event["contacts"]) == (2, 1, 1)
    assert rewards(worlds) == [5.0]


@pytest.mark.parametrize(("cost", "paid"), [(0.0, 2.0), (1.0, 2.0), (2.0, 1.0)])
def test_godot_sets_the_reward_to_the_xp_at_a_death_that_costs(arena: str, cost: float, paid: float) -> None:
    # A notice and a contact, +2, and the death by the bite: the reward is set to 3 XP less the cost.
    worlds = fight(arena, "godot", (-40.0, 0.0), ending_cost=cost)
    worlds.players["hp"] = 7
    play(worlds, STAND)
    assert worlds.ending(0) == "killed"
    assert rewards(worlds) == [paid]
    assert worlds.players["xp"][0, 0] == 3 - cost
    assert worlds.events["xp_gained"][0, 0] == -cost


# --- What every formula leaves out ---------------------------------------------------------------


def test_each_player_is_rewarded_by_its_own_formula(arena: str) -> None:
    names = ["thesis", "pygame", "kills", "distance-sigmoid", "godot"]
    players = [(0.0, -300.0 + 150 * p) for p in range(5)]
    worlds = stage(arena, still=True, players=players, settings={"reward": names})
    worlds.players["xp"], worlds.players["hp"] = 2, 25
    for monster in range(1, 4):
        worlds.monsters["hp"][0, monster] = 0
    move_monster(worlds, 0, -150.0, 150.0)  # 150 px from player 3
    worlds.monster_stats["attack_squared"] = 0.0
    play(worlds, STAND)
    # Players 1 to 4 are within 300 px of the monster: entering its circle pays by Godot's formula alone.
    assert rewards(worlds) == [2 - 0.25, 2 + 0.25, 0.0, pytest.approx(0.5), 1.0]


# --- Rewards of one's own, in a process that goes on ----------------------------------------------


def test_a_reward_that_was_edited_or_stands_elsewhere_is_read_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As between two cells of a notebook; with the modules beside it that it imports."""
    name = "reread_reward"

    def write(folder: str, told: str, helper: str) -> None:
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / f"{name}.py").write_text(
            f"import {name}_helper\ndef pay(events, players, stats):\n"
            f"    return {told} + {name}_helper.MORE + 0 * events['died']\n"
        )
        (tmp_path / folder / f"{name}_helper.py").write_text(f"MORE = {helper}\n")

    def paid() -> float:
        return float(load_reward(f"{name}:pay")({"died": 0}, None, None))  # type: ignore[arg-type]

    write("one", "1", "0.5")
    write("two", "20", "0.25")
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.chdir(tmp_path / "one")
    assert paid() == 1.5
    write("one", "300", "0.5")
    assert paid() == 300.5
    write("one", "300", "0.25")
    assert paid() == 300.25
    write("one", "400", "0.75")  # as long as before, and within the second
    assert paid() == 400.75
    monkeypatch.chdir(tmp_path / "two")
    assert paid() == 20.25
