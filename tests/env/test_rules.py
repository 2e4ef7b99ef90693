"""The rules by hand: walking, the sword, magic, monsters, and what is told of a step.

`test_bodies.py` has how far circles and swords reach; `test_oracle.py` all else, against the oracle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneuma.env.worlds import Worlds

from .arena import (
    ATTACK,
    DOWN,
    FLAME,
    HEAL,
    LEFT,
    RIGHT,
    STAND,
    UP,
    Place,
    layer,
    monster_at,
    monster_hp,
    play,
    player_at,
    player_hp,
    stage,
    write_level,
)

DIRECTIONS = {LEFT: (-1, 0), RIGHT: (1, 0), UP: (0, -1), DOWN: (0, 1)}

# --- The sword -----------------------------------------------------------------------------------


def test_an_attack_lasts_three_steps_in_which_walking_does_nothing(arena: str) -> None:
    worlds = stage(arena, facing=UP)
    play(worlds, ATTACK, LEFT, DOWN)  # 0.4 s = 24 ticks = 3 steps
    assert player_at(worlds) == (0.0, 0.0)
    assert worlds.players["facing"][0, 0] == UP
    play(worlds, LEFT)
    assert player_at(worlds) == (-40.0, 0.0)
    assert worlds.players["facing"][0, 0] == LEFT


def test_a_blow_knocks_back_60_px_away_from_the_hilt(arena: str) -> None:
    # The monster at (84, -26) is (30, -40) = 50 x (0.6, -0.8) from the hilt. 2 px a tick for 30 ticks:
    # 60 x (0.6, -0.8) = (36, -48), so it lands at (120, -74).
    worlds = stage(arena, (84.0, -26.0), ticks=1)
    play(worlds, ATTACK)
    assert monster_at(worlds) == pytest.approx((85.2, -27.6))
    play(worlds, *[ATTACK] * 29)
    assert monster_at(worlds) == pytest.approx((120.0, -74.0))
    play(worlds, ATTACK)  # then it comes back, 2.5 px on each axis
    assert monster_at(worlds) == pytest.approx((117.5, -71.5))


# --- Dashing -------------------------------------------------------------------------------------
# Thrice 5 px a tick for 8 ticks; then 60 ticks of rest.

DASH = 5  # the last action, without magic


def test_a_dash_goes_120_px_ahead_and_the_next_one_waits_for_60_ticks(arena: str) -> None:
    worlds = stage(arena, players=((0.0, -200.0),), settings={"dash": True})
    play(worlds, DASH)
    assert player_at(worlds) == (120.0, -200.0)
    assert worlds.masks[0, 0].tolist() == [1] * 5 + [0]
    play(worlds, *[DASH] * 6)
    assert (player_at(worlds), worlds.players["dash_cooldown"][0, 0]) == ((120.0, -200.0), 12)
    play(worlds, DASH)
    assert worlds.masks[0, 0, DASH] == 1  # 4 ticks from now
    play(worlds, DASH)
    assert player_at(worlds) == (180.0, -200.0)
    play(worlds, UP)  # the other 4 ticks of the dash, then 4 of walking
    assert player_at(worlds) == (240.0, -220.0)


# --- Slow ground ----------------------------------------------------------------------------------
# Half of 5 px a tick where the body's centre, 1.5 px left of the player's place, is on a slow tile.


def test_who_walks_over_a_slow_tile_takes_twice_as_long_on_it(tmp_path: Path) -> None:
    level = write_level(tmp_path, [(0.0, 0.0)], [(540.0, 540.0)])
    ground = np.pad(np.full((18, 18), 2), 1)
    ground[:, 12] = 3  # 128 <= x < 192
    (tmp_path / "ground.csv").write_text(layer(ground))
    worlds = stage(level, players=((100.0, -200.0),), settings={"slow": [3]})
    for x in (
        135,  # 6 ticks of 5 to 130, where the centre is at 128.5, and 2 of 2.5
        155,  # 8 of 2.5
        175,
        195,  # the last one from 192.5, where the centre is at 191
        235,
    ):
        play(worlds, RIGHT)
        assert player_at(worlds) == (x, -200.0)


# --- Magic ---------------------------------------------------------------------------------------
# A base player has magic 4, 60 of energy and recovers 0.6 x 4 / 60 = 0.04 a tick. A flame burns 5 + 4 = 9 HP
# and costs 20; healing gives 20 HP and costs 10; both take 24 ticks.


def cast(level: str, *monsters: Place, facing: int = RIGHT, ticks: int = 8) -> Worlds:
    """Set up a world with magic in which monsters neither move nor bite."""
    worlds = stage(level, *monsters, facing=facing, ticks=ticks, still=True, settings={"magic": True})
    worlds.monster_stats["damage"] = 0.0
    return worlds


@pytest.mark.parametrize("facing", DIRECTIONS)
def test_a_flame_burns_the_320_x_64_px_ahead_and_nothing_else(arena: str, facing: int) -> None:
    # A body is 24 x 50 px, 2 px below its place: half of it along the way faced, and half across.
    along, across = (12.0, 25.0) if facing in (LEFT, RIGHT) else (25.0, 12.0)
    x, y = DIRECTIONS[facing]
    for inside, burnt in ((0.001, 31), (0.0, 40)):
        for far, aside in (
            (320 + along - inside, 0.0),
            (-along + inside, 0.0),
            (160.0, 32 + across - inside),
            (160.0, -32 - across + inside),
        ):
            worlds = cast(arena, (x * far + y * aside, y * far + x * aside - 2), facing=facing)
            play(worlds, FLAME, FLAME, FLAME)
            assert monster_hp(worlds) == burnt, (far, aside)
            assert worlds.monsters["knocked"][0, 0] == 0


@pytest.mark.parametrize(("spell", "cost", "hp"), [(FLAME, 20, 85), (HEAL, 10, 100)])
def test_a_spell_costs_energy_and_takes_24_ticks(arena: str, spell: int, cost: float, hp: float) -> None:
    worlds = cast(arena, ticks=1)
    worlds.players["hp"] = 85
    play(worlds, spell)
    assert player_hp(worlds) == hp  # healed up to full
    assert worlds.players["energy"][0, 0] == pytest.approx(60 - cost + 0.04)
    play(worlds, *[spell] * 23)
    assert worlds.players["energy"][0, 0] == pytest.approx(60 - cost + 24 * 0.04)
    play(worlds, RIGHT)
    assert player_at(worlds) == (5.0, 0.0)


# --- Monsters ------------------------------------------------------------------------------------


def test_a_monster_comes_no_nearer_than_30_px_on_either_axis(arena: str) -> None:
    # y: 100 - 28 x 2.5 = 30 after 28 ticks; x: 200 - 68 x 2.5 = 30 after 68.
    worlds = stage(arena, (-200.0, 100.0), ticks=1, settings={"bodies": "pass"})
    for ticks, place in ((28, (-130.0, 30.0)), (40, (-30.0, 30.0)), (10, (-30.0, 30.0))):
        play(worlds, *[STAND] * ticks)
        assert monster_at(worlds) == place


def test_the_first_bite_comes_at_once_and_the_next_60_ticks_later(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), ticks=1)
    hp = []
    for _ in range(121):
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93] * 60 + [86] * 60 + [79]


# --- A step --------------------------------------------------------------------------------------


def told(worlds: Worlds) -> dict[str, float]:
    """Return what was told to have happened in the last step."""
    row = worlds.events[0, 0]
    state_of_things = ("reward", "distance", "present")
    return {name: float(row[name]) for name in row.dtype.names if row[name] and name not in state_of_things}


def test_everything_that_happens_in_a_step_is_told_once(arena: str) -> None:
    worlds = stage(arena, (80.0, 0.0), (40.0, 40.0), (-40.0, 0.0), (-200.0, 0.0), still=True)
    worlds.players["hp"], worlds.monsters["hp"][0, 0] = 50, 20
    play(worlds, ATTACK)
    # Monster 0 dies of the sword before it senses anything. Monster 1 is struck, sees and touches, and
    # flies before it can bite; monster 2 sees and bites, monster 3 sees: 50 + 7 - 7 = 50 HP.
    assert told(worlds) == {
        "hits": 2, "kills": 1, "xp_gained": 1, "hp_gained": 7, "notices": 3, "contacts": 2, "hp_lost": 7,
    }  # fmt: skip
    assert worlds.events["reward"][0, 0] == 1 - 0.5
    play(worlds, ATTACK)
    assert told(worlds) == {}
