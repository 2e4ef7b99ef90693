"""The rules by hand: what facts and text say of numbers, worked out as short sums; the oracle plays along.

`test_oracle.py` holds the compiled rules to the oracle in whatever else there is.
"""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env.rules import ATTACK, DOWN, FLAME, HEAL, LEFT, RIGHT, UP

from .arena import GODOT, Place, begin, play, stage

DIRECTIONS = {LEFT: (-1, 0), RIGHT: (1, 0), UP: (0, -1), DOWN: (0, 1)}

# --- Walking and the sword --------------------------------------------------------------


def test_an_attack_lasts_three_steps_in_which_walking_does_nothing(arena: str) -> None:
    pair = stage(arena, facing=UP)
    pair.play(ATTACK, LEFT, DOWN)  # 0.4 s = 24 ticks = 3 steps
    assert (pair.told("x"), pair.told("y"), pair.told("facing")) == ([0], [0], [UP])
    pair.play(LEFT)
    assert (pair.told("x"), pair.told("y"), pair.told("facing")) == ([-40], [0], [LEFT])


def test_a_blow_knocks_back_60_px_away_from_the_hilt(arena: str) -> None:
    # The monster at (84, -26) is (30, -40) = 50 x (0.6, -0.8) from the hilt. 2 px a tick for 30 ticks:
    # 60 x (0.6, -0.8) = (36, -48), so it lands at (120, -74).
    pair = stage(arena, (84.0, -26.0), ticks=1)
    for ticks, place in ((1, (85.2, -27.6)), (29, (120.0, -74.0)), (1, (117.5, -71.5))):  # then it comes back
        pair.play(*[ATTACK] * ticks)
        assert pair.monster("x", "y") == pytest.approx(place)


def test_a_second_blow_does_not_extend_a_flight(arena: str) -> None:
    # At the hilt itself, (54, 14), a blow knocks nowhere, for 30 ticks. The second attack begins in tick 25
    # and strikes; in tick 31 the monster comes nearer by 2.5 px on x, as on y it is within 30 px.
    pair = stage(arena, (54.0, 14.0), ticks=1)
    pair.put(monsters=True, hp=[400])
    hits = 0
    for _ in range(30):
        pair.play(ATTACK)
        hits += pair.told("hits")[0]
        assert pair.monster("x", "y") == (54.0, 14.0)
    assert hits == 2
    pair.play(ATTACK)
    assert pair.monster("x", "y") == (51.5, 14.0)


@pytest.mark.parametrize(
    ("what", "facing", "last", "outwards"),
    [
        # The blade. Half of box and body: 39.5 + 12 or 25.5 + 12 on x, 25.5 + 25 or 39.5 + 25 on y.
        ("hits", RIGHT, (38.5 + 51.25, 0.0), (1, 0)),
        ("hits", RIGHT, (68.0, 3.5 - 2 + 50.25), (0, 1)),
        ("hits", LEFT, (-38.5 - 51.25, 0.0), (-1, 0)),
        ("hits", LEFT, (-72.0, 24.5 - 2 - 50.25), (0, -1)),
        ("hits", DOWN, (-1.5 + 37.25, 58.0), (1, 0)),
        ("hits", DOWN, (0.0, 36.5 - 2 + 64.25), (0, 1)),
        ("hits", UP, (-2.5 - 37.25, -52.0), (-1, 0)),
        ("hits", UP, (0.0, -28.5 - 2 - 64.25), (0, -1)),
        # The notice circle, 7 px below a bamboo, and the attack circle, 5 px below.
        ("notices", UP, (322.0, 0.0), (1, 0)),  # -1.5 + 23.5 + 300
        ("notices", UP, (0.0, 319.0), (0, 1)),  # 2 + 24 + 300 - 7
        ("notices", UP, (0.0, -329.0), (0, -1)),  # 2 - 24 - 300 - 7
        ("contacts", DOWN, (62.0, 0.0), (1, 0)),  # -1.5 + 23.5 + 40
        ("contacts", DOWN, (0.0, -67.0), (0, -1)),  # 2 - 24 - 40 - 5
    ],
)
def test_blade_and_circles_reach_as_far_as_in_the_scenes(
    arena: str, what: str, facing: int, last: Place, outwards: tuple[int, int]
) -> None:
    for further in (0.0, 0.25):
        bamboo = last[0] + further * outwards[0], last[1] + further * outwards[1]
        pair = stage(arena, bamboo, facing=facing, still=True)
        pair.play(ATTACK)
        assert pair.told(what) == [further == 0]


# --- Magic ---------------------------------------------------------------------------------------
# A base player has magic 4, 60 of energy and recovers 0.6 x 4 / 60 = 0.04 a tick. A flame burns 5 + 4 = 9 HP
# and costs 20; healing gives 20 HP and costs 10; both take 24 ticks.


@pytest.mark.parametrize("facing", DIRECTIONS)
def test_a_flame_burns_the_320_x_64_px_ahead_and_nothing_else(arena: str, facing: int) -> None:
    # A body is 24 x 50 px, 2 px below its place: half of it along the way faced, and half across.
    along, across = (12.0, 25.0) if facing in (LEFT, RIGHT) else (25.0, 12.0)
    x, y = DIRECTIONS[facing]
    places = (320 + along, 0.0), (-along, 0.0), (160.0, 32 + across), (160.0, -32 - across)
    for far, aside in places:
        for inside, burnt in ((0.001, 31), (0.0, 40)):
            ahead = far - inside * np.sign(far - 160), aside - inside * np.sign(aside)
            place = x * ahead[0] + y * ahead[1], y * ahead[0] + x * ahead[1] - 2
            pair = stage(arena, place, facing=facing, still=True, magic=True)
            pair.play(FLAME, FLAME, FLAME)
            assert pair.monster("hp", "knocked") == (burnt, 0), (far, aside)


@pytest.mark.parametrize(("spell", "cost", "hp"), [(FLAME, 20, 85), (HEAL, 10, 100)])
def test_a_spell_costs_energy_and_takes_24_ticks(arena: str, spell: int, cost: float, hp: float) -> None:
    pair = stage(arena, ticks=1, magic=True)
    pair.put(hp=85)
    for ticks in (1, 24):
        pair.play(*[spell] * (ticks if ticks == 1 else 23))
        assert pair.told("hp") == [hp]  # healed up to full
        assert pair.told("energy")[0] == pytest.approx(60 - cost + ticks * 0.04)
    pair.play(RIGHT)
    assert pair.told("x") == [5]


# --- Monsters ------------------------------------------------------------------------------------


def test_a_monster_comes_no_nearer_than_30_px_on_either_axis(arena: str) -> None:
    # 100 - 28 x 2.5 = 30 on one axis after 28 ticks; then it comes nearer on the other axis alone.
    for start, place, later in (
        ((-200.0, 100.0), (-130.0, 30.0), (-127.5, 30.0)),
        ((100.0, -200.0), (30.0, -130.0), (30.0, -127.5)),
    ):
        pair = stage(arena, start, ticks=1)
        pair.play(*[ATTACK] * 28)
        assert pair.monster("x", "y") == place
        pair.play(ATTACK)
        assert pair.monster("x", "y") == later


def test_the_first_bite_comes_at_once_and_the_next_60_ticks_later(arena: str) -> None:
    pair = stage(arena, (-40.0, 0.0), ticks=1)
    hp = []
    for _ in range(121):
        pair.play(ATTACK)
        hp += pair.told("hp")
    assert hp == [93] * 60 + [86] * 60 + [79]


def test_everything_that_happens_in_a_step_is_told_once(arena: str) -> None:
    pair = stage(arena, (80.0, 0.0), (40.0, 40.0), (-40.0, 0.0), (-200.0, 0.0), still=True)
    pair.put(hp=50)
    pair.put(monsters=True, hp=[20])
    pair.play(ATTACK)
    # Monster 0 dies of the sword before it senses anything. Monster 1 is struck, sees and touches, and
    # flies before it can bite; monster 2 sees and bites, monster 3 sees: 50 + 7 - 7 = 50 HP.
    expected = {
        "hits": 2, "kills": 1, "xp_gained": 1, "hp_gained": 7, "notices": 3, "contacts": 2, "hp_lost": 7,
        "died": 0, "present": 8, "reward": 1 - 0.5,
    }  # fmt: skip
    assert {name: pair.told(name)[0] for name in expected} == expected
    pair.play(ATTACK)
    assert {name: pair.told(name)[0] for name in expected} == dict.fromkeys(expected, 0) | {
        "present": 8, "reward": 0.5,
    }  # fmt: skip


def test_healing_saves_from_a_deadly_bite_in_the_same_tick(arena: str) -> None:
    # One monster dies of the sword, which heals 7 HP, before another one bites for 7: 5 + 7 - 7 = 5.
    pair = stage(arena, (80.0, 0.0), (-40.0, 0.0), ticks=1, still=True)
    pair.put(hp=5)
    pair.put(monsters=True, hp=[20])
    pair.play(ATTACK)
    assert (pair.told("kills"), pair.told("hp_lost"), pair.told("hp"), pair.told("died")) == (
        [1],
        [7],
        [5],
        [0],
    )


# --- The published code's quirks -----------------------------------------------------------------


@pytest.mark.parametrize("action", [LEFT, RIGHT])
def test_who_walks_one_way_for_ever_is_bitten_to_death_as_the_collapsed_logs_are(action: int) -> None:
    """Six of the published logs end with episodes of 93 to 115 steps in the mean."""
    worlds = begin(1, env_id=GODOT)
    while worlds.ending(0) == "running":
        play(worlds, action)
    assert (worlds.ending(0), worlds.worlds["steps"][0]) == ("killed", 111)


@pytest.mark.parametrize(("x", "paid"), [(62.0, True), (62.5, False)])  # 40 px off the body, and more
def test_a_kill_earns_only_within_the_attack_circle(arena: str, x: float, paid: bool) -> None:
    pair = stage(arena, (x, 0.0), ticks=1, still=True, env_id=GODOT)
    pair.put(monsters=True, hp=[20])
    pair.play(LEFT, RIGHT)  # it has stood there for a tick
    pair.put(xp=4, hp=100)
    pair.play(ATTACK)
    assert (pair.told("xp"), pair.told("hp"), pair.told("kills")) == ([4 + paid], [100 + 7 * paid], [1])
    assert pair.told("reward") == [5 * paid]  # set to the XP of who earns it


def test_clearing_the_level_costs_1_xp(arena: str) -> None:
    pair = stage(arena, (54.0, 0.0), env_id=GODOT)
    pair.put(xp=4)
    pair.put(monsters=True, hp=[20, 0, 0, 0], bite=[[30] * 8])
    pair.play(ATTACK)
    assert (pair.told("xp"), pair.told("reward"), pair.worlds.ending(0)) == ([4], [4], "cleared")  # 4 + 1 - 1
