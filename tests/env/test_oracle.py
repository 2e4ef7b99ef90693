"""The kernel against the oracle: whatever is played, both tell the same, bit for bit.

`oracle.py` tells the rules tick by tick in plain Python. `Pair` plays it beside the kernel and compares
all state, events, observations and masks after every step and reset. Levels, characters,
configurations and ways to play are Hypothesis's (`oracle_cases.py`); below that come cases set up by
hand, each with what must have happened in it.
"""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from pneuma.env.fields import make_env_config
from pneuma.env.players import Hunter
from pneuma.env.rules import (
    ATTACK,
    CLEARED,
    FLAME,
    HEAL,
    KILLED,
    LEFT,
    RIGHT,
    RUNNING,
    TIME_LIMIT,
    UP,
)
from pneuma.env.worlds import Worlds

from .oracle import Oracle
from .oracle_arrays import Pair
from .oracle_cases import STEPS_OF_A_MOOD, Case, cases, choose_actions, hunt, make_worlds
from .oracle_moves import CONTACT_EPS, Box
from .oracle_parts import Player
from .oracle_stage import FAR, HERE, QUIET, act, put, set_up, told

FEW = settings(
    max_examples=60,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
MANY = settings(FEW, max_examples=2000)

# --- Whatever is played ------------------------------------------------------------------------------


def check_cases(many: settings, folder: Path) -> Counter[str]:
    """Play so many cases, and return how often what happened."""
    happened: Counter[str] = Counter()
    folders = itertools.count()

    @many
    @given(cases())
    def check(case: Case) -> None:
        play(case, make_worlds(case, folder / str(next(folders))), happened)

    check()
    return happened


def play(case: Case, worlds: Worlds, happened: Counter[str]) -> None:
    """Play a case; ended worlds begin anew after a step or two, and at times all of them do."""
    pair = Pair(worlds, case.seed)
    for step in range(len(case.breaks) * STEPS_OF_A_MOOD):
        pair.step(choose_actions(case, pair.oracles, step))
        count_events(pair, happened)
        over = np.flatnonzero(worlds.worlds["ending"] != RUNNING)
        pause = case.breaks[step // STEPS_OF_A_MOOD]
        if pause >= 250 and step % STEPS_OF_A_MOOD == 0:
            start = pause % len(worlds.level.starts)
            pair.reset(range(case.count), start, seed=pause if pause % 2 else None)
        else:
            pair.reset([index for index in over if (pause + step + index) % 3])


def count_events(pair: Pair, happened: Counter[str]) -> None:
    worlds = pair.worlds
    for name in ("hits", "kills", "notices", "contacts"):
        happened[name] += int(worlds.events[name].sum())
    for world in pair.oracles:
        happened["opened"] += sum(monster.opened > 0 for monster in world.monsters)
        for player in world.players:
            happened["second weapon"] += player.second
            happened["token"] += player.token > 0
            drowned = bool(player.events.died) and world.ground.is_sea(player.x, player.y)
            happened["drowned"] += drowned
            happened["bitten to death"] += player.events.died - drowned
            happened["healed"] += player.events.hp_gained > 0
            happened["player at a monster"] += touches(world, player)
        happened["flying"] += sum(monster.knocked > 0 for monster in world.monsters)
        happened[f"ending {world.ending}"] += world.steps > 0


def touches(world: Oracle, player: Player) -> bool:
    """Tell whether a living monster's body lies flush to a player's, or a little inside."""
    (left, top), (wide, high) = player.box.centre, player.box.half
    grown = Box((left, top), (wide + 2 * CONTACT_EPS, high + 2 * CONTACT_EPS))
    return player.hp > 0 and any(monster.hp > 0 and grown.meets(monster.box) for monster in world.monsters)


def test_the_kernel_plays_as_the_oracle_tells(tmp_path: Path) -> None:
    happened = check_cases(FEW, tmp_path)
    together = ("opened", "second weapon", "token")
    usual = ("hits", "kills", "notices", "contacts", "healed", "drowned", "bitten to death")
    bodies = ("player at a monster", "flying")
    for name in (
        *usual,
        *bodies,
        *together,
        *(f"ending {ending}" for ending in (KILLED, CLEARED, TIME_LIMIT)),
    ):
        assert happened[name], happened


@pytest.mark.slow
def test_the_kernel_plays_as_the_oracle_tells_in_many_more_cases(tmp_path: Path) -> None:
    check_cases(MANY, tmp_path)


# --- The shipped and the random levels ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "chosen"),
    [
        ("pneuma/Pneuma-v0", {}),
        ("pneuma/PneumaGodot-v0", {}),
        ("pneuma/Pneuma-v0", {"players": 2, "classes": ["mage", "tank"], "observation": "pygame"}),
    ],
)
def test_the_hunter_on_the_shipped_level(env_id: str, chosen: dict[str, object]) -> None:
    worlds = Worlds(2, make_env_config(chosen, env_id))
    pair, hunter = Pair(worlds, seed=5), Hunter(worlds)
    kills = 0
    for _ in range(300):
        pair.step(hunter.act(worlds))
        kills += int(worlds.events["kills"].sum())
        pair.reset(np.flatnonzero(worlds.worlds["ending"]))
    assert kills >= 2


def test_random_levels_are_drawn_before_starts() -> None:
    worlds = Worlds(3, make_env_config({"level": "random:train:3", "random_levels": 4, "players": 2}))
    pair, played = Pair(worlds, seed=1), set()
    for _ in range(12):
        played |= set(worlds.worlds["level"].tolist())
        for _ in range(20):
            pair.step(np.array([[hunt(o, player, ATTACK) for player in o.players] for o in pair.oracles]))
        pair.reset(range(3))
    assert played == {0, 1, 2, 3}
    assert worlds.worlds["draws"].tolist() == [26, 26, 26]  # a level and a start for each of 13 episodes


# --- Cases set up by hand ----------------------------------------------------------------------------


@pytest.mark.parametrize(("kill_credit", "xp"), [("striker", [0, 1]), ("near", [1, 1])])
def test_two_players_kill_one_monster_in_one_tick(tmp_path: Path, kill_credit: str, xp: list[float]) -> None:
    pair = set_up(tmp_path, (512.0, 564.0), players=2, kill_credit=kill_credit)
    pair.worlds.monsters["noticed"], pair.worlds.monsters["bite"][..., :2] = 3, 30  # both are near it
    put(pair, x=512.0, y=(514.0, 510.0))
    act(pair, ATTACK, ATTACK)
    assert (told(pair, "hits"), told(pair, "kills"), told(pair, "xp")) == ([1, 1], [0, 1], xp)


def test_when_one_dies_in_a_step_the_others_live_on_without_him(tmp_path: Path) -> None:
    # The first is bitten to death in tick 1; the bamboo then turns to the second, who walks up to it.
    pair = set_up(tmp_path, (560.0, 512.0), players=2, characters="")
    put(pair, hp=(7, 100), x=(512.0, 800.0), y=512.0)
    act(pair, UP, LEFT)
    assert (told(pair, "died"), told(pair, "present"), told(pair, "hp")) == ([1, 0], [1, 8], [0, 100])
    assert told(pair, "xp") == [-1, 0]
    assert told(pair, "y") == [507, 512]  # the one tick that he lived
    assert pair.worlds.monsters["x"][0, 0] > 560
    for _ in range(5):
        act(pair, UP, LEFT)
    assert told(pair, "hp") == [0, 93]
    assert (told(pair, "present"), told(pair, "y")) == ([0, 8], [507, 512])


@pytest.mark.parametrize(("hp", "left"), [(7.0, 20.0), (95.0, 93.0)])
def test_a_spell_heals_before_the_bite_of_its_tick(tmp_path: Path, hp: float, left: float) -> None:
    pair = set_up(tmp_path, (550.0, 512.0), magic=True)
    put(pair, hp=hp)
    act(pair, HEAL)  # 7 + 20 - 7; 95 + 5 - 7
    assert (told(pair, "hp"), told(pair, "contacts")) == ([left], [1])


def test_death_at_sea_costs_nothing_and_ends_the_episode(tmp_path: Path) -> None:
    pair = set_up(tmp_path, (832.0, 300.0), coast="deadly", players=2)
    put(pair, x=(74.0, 69.0))  # the land begins at 64
    act(pair, LEFT, LEFT)  # 69, 64, 59; 64, 59
    assert (told(pair, "x"), told(pair, "present"), told(pair, "xp")) == ([59, 59], [2, 1], [0, 0])
    assert (told(pair, "hp_lost"), pair.worlds.ending(0)) == ([100, 100], "killed")


def test_eight_players_fill_every_bit(tmp_path: Path) -> None:
    tough = "[monsters.bamboo]\nhp = 5000\n"
    pair = set_up(tmp_path, HERE, players=8, classes="tank", characters=tough)
    put(pair, x=458.0, y=512.0 + 3 * np.arange(8), facing=RIGHT)
    act(pair, *[ATTACK] * 8)
    assert pair.worlds.monsters["noticed"][0, 0] == 255
    assert pair.worlds.monsters["struck_by"][0, 0].tolist() == [1] * 8
    for step in range(40):
        act(pair, *[(step // 4 + p) % 5 for p in range(8)])


# --- Cases in which kernel and oracle once told different things -------------------------------------


def test_bitten_to_death_one_tick_before_the_sea_is_no_death_at_sea(tmp_path: Path) -> None:
    pair = set_up(tmp_path, (110.0, 512.0), coast="deadly")
    put(pair, x=70.0, hp=7)
    act(pair, LEFT)  # bitten at 65; the next tick would have taken him to 60, beyond the land
    assert (told(pair, "x"), told(pair, "present"), told(pair, "xp")) == ([65], [1], [-1])
    assert told(pair, "reward") == [-1]


def test_a_monster_right_at_the_hilt_flies_nowhere(tmp_path: Path) -> None:
    # Its flight is too short to be flown: with a longer one, the NaN of 0 / 0 once ended the process.
    own = "hilt = {down = 0, left = 0, up = 0, right = 0}\n"
    still = "knock_back = 120\nknock_back_time = 0\n"
    pair = set_up(tmp_path, HERE, characters=f"[weapons.blade]\n{own}{QUIET}{still}")
    act(pair, ATTACK)
    assert (told(pair, "hits"), pair.worlds.monsters["knock_x"].tolist()) == ([1], [[0.0]])


@pytest.mark.parametrize(("spell", "place", "cost"), [(FLAME, 5, 20.0), (HEAL, 6, 10.0)])
def test_a_mask_allows_a_spell_that_can_be_paid_during_the_step(
    tmp_path: Path, spell: int, place: int, cost: float
) -> None:
    pair = set_up(tmp_path, FAR, magic=True)
    put(pair, hp=50, energy=cost - 0.1)  # 0.04 a tick come back
    allowed = int(pair.worlds.masks[0, 0, place])
    act(pair, spell)
    assert told(pair, "busy") == [24 - 5]
    assert allowed == 1
