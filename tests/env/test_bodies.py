"""The rules of bodies, by hand-derived values: kernel and oracle side by side, and both against them.

A player stands at (512, 512): its body is 47 x 48 px around (510.5, 514), a bamboo's 24 x 50 px around a
point 2 px below its place. So they touch 35.5 px apart on x and 49 px apart on y, centre from centre.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.env.rules import ATTACK, COAST, DOWN, LEFT, RIGHT, SOLID, UP

from .oracle_stage import QUIET, act, place_of, put, set_up, told

TOUGH = "[monsters.bamboo]\nhp = 5000\n"
STILL = f"{TOUGH}speed = 0\n"

# --- In the way ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("way", "bamboo", "end"),
    [
        (RIGHT, (590.0, 512.0), (556.0, 512.0)),  # 590 - 35.5 + 1.5
        (LEFT, (430.0, 512.0), (467.0, 512.0)),  # 430 + 35.5 + 1.5
        (DOWN, (512.0, 590.0), (512.0, 541.0)),  # 590 + 2 - 49 - 2
        (UP, (512.0, 430.0), (512.0, 479.0)),
    ],
)
def test_a_player_stops_where_it_touches_a_bamboo(
    tmp_path: Path, way: int, bamboo: tuple[float, float], end: tuple[float, float]
) -> None:
    pair = set_up(tmp_path, bamboo)
    for _ in range(2):
        act(pair, way)
    assert (told(pair, "x"), told(pair, "y")) == ([end[0]], [end[1]])
    act(pair, RIGHT if way in (UP, DOWN) else DOWN)  # along it
    along = (40.0, 0.0) if way in (UP, DOWN) else (0.0, 40.0)
    assert (told(pair, "x"), told(pair, "y")) == ([end[0] + along[0]], [end[1] + along[1]])


@pytest.mark.parametrize(
    ("chosen", "beside", "end"),
    [
        ({}, 48.875, 556.0),
        ({}, 49.0, 592.0),  # 16 ticks of 5 px: past it
        ({}, 49.0 - 2**-11, 592.0),  # less than a hair inside
        ({"bodies": "pass"}, 0.0, 592.0),
    ],
)
def test_who_only_touches_passes(tmp_path: Path, chosen: dict[str, Any], beside: float, end: float) -> None:
    pair = set_up(tmp_path, (590.0, 512.0 + beside), **chosen)
    act(pair, RIGHT)
    act(pair, RIGHT)
    assert told(pair, "x") == [end]


def test_who_is_inside_another_is_not_held(tmp_path: Path) -> None:
    pair = set_up(tmp_path, (520.0, 512.0))
    act(pair, RIGHT)
    assert told(pair, "x") == [552.0]


def test_the_dead_stop_nobody(tmp_path: Path) -> None:
    pair = set_up(tmp_path, (590.0, 512.0))
    pair.worlds.monsters["hp"], pair.worlds.worlds["monsters_left"] = 0, 0
    pair.take_over()
    act(pair, RIGHT)
    act(pair, RIGHT)
    assert told(pair, "x") == [592.0]


def test_players_stop_each_other_in_their_order(tmp_path: Path) -> None:
    # The first walks on as the second gives way; bodies touch 47 px apart.
    pair = set_up(tmp_path, (112.0, 900.0), players=2)
    put(pair, x=(512.0, 570.0), y=512.0)
    act(pair, RIGHT, ATTACK)
    assert told(pair, "x") == [523.0, 570.0]
    put(pair, busy=0, armed=0)
    act(pair, RIGHT, RIGHT)  # in each tick the first acts before the second has moved: 7 of 8 steps
    assert told(pair, "x") == [558.0, 610.0]


def test_a_player_bitten_to_death_is_in_the_way_until_the_tick_is_over(tmp_path: Path) -> None:
    # The bamboo on the right chases the player on the left, past the one whom it bites in tick 1.
    pair = set_up(tmp_path, (547.0, 512.0), players=2, characters="")
    put(pair, hp=(7, 100), x=(512.0, 392.0), y=512.0)
    act(pair, UP, ATTACK)  # upwards in tick 1: 5 px, still beside it
    assert told(pair, "died") == [1, 0]
    assert place_of(pair) == (546.0 - 7 * 2.5, 512.0)  # held at contact for one tick: 510.5 + 35.5


# --- Chasing -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("facing", "bamboo", "end"),
    [
        (LEFT, (660.0, 512.0), (546.0, 512.0)),  # 510.5 + 35.5
        (RIGHT, (362.0, 512.0), (475.0, 512.0)),
        (UP, (512.0, 660.0), (512.0, 561.0)),  # 514 + 49 - 2
        (DOWN, (512.0, 362.0), (512.0, 463.0)),
        (LEFT, (660.0, 552.0), (546.0, 542.0)),  # within 30 px on y, it comes no nearer there
    ],
)
def test_a_bamboo_comes_up_to_who_stands(
    tmp_path: Path, facing: int, bamboo: tuple[float, float], end: tuple[float, float]
) -> None:
    pair = set_up(tmp_path, bamboo, characters="")
    put(pair, facing=facing)  # it strikes behind its own back
    for _ in range(7):
        act(pair, ATTACK)
    assert place_of(pair) == end


def test_bamboos_queue(tmp_path: Path) -> None:
    """Two bamboos touch 24 px apart on x."""
    pair = set_up(tmp_path, (620.0, 512.0), (700.0, 512.0), characters=TOUGH)
    put(pair, facing=LEFT)
    for _ in range(8):
        act(pair, ATTACK)
    assert (place_of(pair), place_of(pair, 1)) == ((546.0, 512.0), (570.0, 512.0))


# --- Flying and biting -------------------------------------------------------------------------------


def test_a_bamboo_close_by_flies_from_the_hilt_until_bodies_touch(tmp_path: Path) -> None:
    # Facing right the hilt is at (566, 526): the bamboo at (550, 526) flies 2 px a tick to the left.
    pair = set_up(tmp_path, (550.0, 526.0), characters=STILL)
    put(pair, facing=RIGHT)
    act(pair, ATTACK)
    assert pair.worlds.monsters["knock_x"].tolist() == [[-2.0]]
    assert place_of(pair) == (546.0, 526.0)


def test_a_blow_in_flight_neither_turns_nor_lengthens_it(tmp_path: Path) -> None:
    pair = set_up(tmp_path, (580.0, 526.0), characters=STILL, players=2)
    put(pair, x=(512.0, 612.0), y=(512.0, 600.0), facing=(RIGHT, UP))
    act(pair, ATTACK, RIGHT)
    assert place_of(pair) == (596.0, 526.0)  # from (566, 526)
    put(pair, x=(512.0, 612.0), y=(512.0, 600.0), facing=(RIGHT, UP))
    act(pair, ATTACK, ATTACK)
    assert told(pair, "hits") == [0, 1]
    assert place_of(pair) == (612.0, 526.0)
    assert pair.worlds.monsters["knocked"].tolist() == [[14]]
    assert pair.worlds.monsters["hp"].tolist() == [[4960.0]]


@pytest.mark.parametrize(("knocked", "hp"), [(False, [100, 100, 100, 93]), (True, [93, 93, 93, 93])])
def test_what_flies_bites_when_it_has_landed(tmp_path: Path, knocked: bool, hp: list[float]) -> None:
    # Struck in tick 1, it flies to the end of tick 30, and never out of reach.
    pair = set_up(tmp_path, (550.0, 526.0), characters=STILL, bite_while_knocked=knocked)
    put(pair, facing=RIGHT)
    left, contacts = [], 0.0
    for _ in range(4):
        act(pair, ATTACK)
        left += told(pair, "hp")
        contacts += told(pair, "contacts")[0]
    assert (left, contacts) == (hp, 1)


@pytest.mark.parametrize(("cap", "hp"), [(False, 107.0), (True, 100.0)])
def test_a_kill_heals_past_full_hp_unless_that_is_a_cap(tmp_path: Path, cap: bool, hp: float) -> None:
    pair = set_up(tmp_path, (580.0, 526.0), healing_cap=cap)
    pair.worlds.monsters["hp"] = 20
    put(pair, facing=RIGHT)
    act(pair, ATTACK)
    assert (told(pair, "kills"), told(pair, "hp"), told(pair, "hp_gained")) == ([1], [hp], [hp - 100])


@pytest.mark.parametrize(
    ("facing", "bamboo", "struck"),
    [
        # Half of box and body: 39.5 + 12 or 25.5 + 12 on x, 25.5 + 25 or 39.5 + 25 on y.
        (RIGHT, (512 + 38.5 + 51.25, 512.0), True),
        (RIGHT, (512 + 38.5 + 51.5, 512.0), False),
        (RIGHT, (580.0, 512 + 3.5 - 2 + 50.25), True),
        (RIGHT, (580.0, 512 + 3.5 - 2 + 50.5), False),
        (LEFT, (512 - 38.5 - 51.25, 512.0), True),
        (LEFT, (512 - 38.5 - 51.5, 512.0), False),
        (LEFT, (440.0, 512 + 24.5 - 2 - 50.25), True),
        (LEFT, (440.0, 512 + 24.5 - 2 - 50.5), False),
        (DOWN, (512 - 1.5 + 37.25, 570.0), True),
        (DOWN, (512 - 1.5 + 37.5, 570.0), False),
        (DOWN, (512.0, 512 + 36.5 - 2 + 64.25), True),
        (DOWN, (512.0, 512 + 36.5 - 2 + 64.5), False),
        (UP, (512 - 2.5 - 37.25, 460.0), True),
        (UP, (512 - 2.5 - 37.5, 460.0), False),
        (UP, (512.0, 512 - 28.5 - 2 - 64.25), True),
        (UP, (512.0, 512 - 28.5 - 2 - 64.5), False),
    ],
)
def test_the_blade_strikes_as_far_as_in_the_scenes(
    tmp_path: Path, facing: int, bamboo: tuple[float, float], struck: bool
) -> None:
    pair = set_up(tmp_path, bamboo)
    put(pair, facing=facing)
    act(pair, ATTACK)
    assert told(pair, "hits") == [struck]


@pytest.mark.parametrize(
    ("bamboo", "noticed"),
    [
        ((834.0, 512.0), True),  # 510.5 + 23.5 + 300
        ((834.25, 512.0), False),
        ((512.0, 831.0), True),  # 514 + 24 + 300 - 7
        ((512.0, 831.25), False),
        ((512.0, 183.0), True),  # 514 - 24 - 300 - 7
        ((512.0, 182.75), False),
    ],
)
def test_the_notice_circle_is_7_px_below_a_bamboo(
    tmp_path: Path, bamboo: tuple[float, float], noticed: bool
) -> None:
    pair = set_up(tmp_path, bamboo)
    act(pair, ATTACK)
    assert told(pair, "notices") == [noticed]


@pytest.mark.parametrize(
    ("bamboo", "bitten"),
    [
        ((574.0, 512.0), True),  # 510.5 + 23.5 + 40
        ((574.25, 512.0), False),
        ((512.0, 445.0), True),  # 514 - 24 - 40 - 5
        ((512.0, 444.75), False),
    ],
)
def test_the_attack_circle_is_5_px_below_a_bamboo(
    tmp_path: Path, bamboo: tuple[float, float], bitten: bool
) -> None:
    pair = set_up(tmp_path, bamboo)
    act(pair, ATTACK)
    assert told(pair, "contacts") == [bitten]


# --- What stops whom ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chosen", "players", "monsters"),
    [
        ({}, {SOLID, COAST}, {SOLID, COAST}),
        ({"trees": "pass"}, {COAST}, {COAST}),
        ({"coast": "deadly"}, {SOLID}, {SOLID, COAST}),
        ({"terrain_stops": "players"}, {SOLID, COAST}, set()),
        ({"terrain_stops": "players", "trees": "pass", "coast": "deadly"}, set(), set()),
    ],
)
def test_which_tiles_stop_whom(
    tmp_path: Path, chosen: dict[str, Any], players: set[int], monsters: set[int]
) -> None:
    settings = set_up(tmp_path, (700.0, 512.0), **chosen).worlds.settings[0]
    assert settings["player_stops"] == sum(1 << code for code in players)
    assert settings["monster_stops"] == sum(1 << code for code in monsters)


@pytest.mark.parametrize(("terrain_stops", "end"), [("all", 76.0), ("players", 12.0)])
def test_the_edge_of_the_grid_stops_monsters_in_any_case(
    tmp_path: Path, terrain_stops: str, end: float
) -> None:
    # The coast is 64 px wide; the bamboo's body reaches 12 px to the left.
    pair = set_up(tmp_path, (100.0, 512.0), characters=STILL, terrain_stops=terrain_stops)
    pair.worlds.monsters["knocked"], pair.worlds.monsters["knock_x"] = 30, -5.0
    pair.take_over()
    for _ in range(4):
        act(pair, DOWN)
    assert place_of(pair) == (end, 512.0)


def test_facing_is_observed_right_after_the_player(tmp_path: Path) -> None:
    pair = set_up(tmp_path, (700.0, 512.0), observe_facing=True, scale="raw")
    put(pair, facing=UP)
    seen = pair.worlds.observations[0, 0].tolist()
    assert seen[:8] == [512.0, 512.0, 100.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert seen[8] == 188.0  # to the monster


def test_a_body_in_the_way_is_no_wall_to_a_mask(tmp_path: Path) -> None:
    """It may be gone before the step is over."""
    pair = set_up(tmp_path, (546.0, 512.0), characters=QUIET)
    put(pair, facing=RIGHT)
    assert pair.worlds.masks[0, 0, RIGHT] == 1
