"""What players do together: strike a monster that falls to two, heal, speak, share, change weapons.

Every number is worked out by hand; the oracle plays along (`oracle_arrays.Pair`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneuma.env.fields import make_env_config
from pneuma.env.rules import ATTACK, DOWN, HEAL, LEFT, RIGHT, UP
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .oracle_stage import FAR, HERE, QUIET, act, put, set_up, told

GUARDED = QUIET + "pair_time = 1.0\nhp = 40\n"
BESIDE = {"x": (458.0, 566.0), "y": 512.0}
"""One on each side of `HERE`, a sword's length off."""


def hp_of_monster(pair: object) -> float:
    return float(pair.worlds.monsters["hp"][0, 0])  # type: ignore[attr-defined]


def test_a_monster_that_falls_to_two_is_wounded_by_the_second_blow_only(tmp_path: Path) -> None:
    pair = set_up(tmp_path, HERE, players=2, characters=GUARDED)
    put(pair, **BESIDE, facing=(RIGHT, LEFT))
    act(pair, ATTACK, LEFT)  # the first opens it, unharmed
    assert (hp_of_monster(pair), told(pair, "hits")) == (40.0, [0, 0])
    assert pair.worlds.monsters["opened"][0, 0] == 60 - 7  # struck in the first of 8 ticks
    put(pair, **BESIDE, facing=(RIGHT, LEFT))
    act(pair, ATTACK, ATTACK)  # the second, from the other side, wounds it: 20 of 40
    assert (hp_of_monster(pair), told(pair, "hits")) == (20.0, [0, 1])


@pytest.mark.parametrize(
    ("places", "facings"), [((458.0, 458.0), (RIGHT, RIGHT)), ((458.0, 832.0), (RIGHT, LEFT))]
)
def test_not_by_two_from_one_side_nor_by_one_alone(
    tmp_path: Path, places: tuple[float, float], facings: tuple[int, int]
) -> None:
    pair = set_up(tmp_path, HERE, players=2, characters=GUARDED, bodies="pass")
    for _ in range(6):  # two attacks each
        put(pair, x=places, y=512.0, facing=facings)
        act(pair, ATTACK, ATTACK)
    assert hp_of_monster(pair) == 40.0


def test_healing_reaches_others_where_a_file_says_so(tmp_path: Path) -> None:
    reaching = QUIET + "[spells.heal]\nreach = 100\n"
    pair = set_up(tmp_path, FAR, players=3, magic=True, characters=reaching, bodies="pass")
    put(pair, x=(400.0, 500.0, 501.0), y=400.0, hp=(50.0, 90.0, 50.0))
    act(pair, HEAL, ATTACK, ATTACK)  # at 100 px: in reach; at 101: not
    assert told(pair, "hp") == [70.0, 100.0, 50.0]
    assert told(pair, "hp_gained") == [20.0, 10.0, 0.0]


def test_a_token_is_heard_by_the_others_in_the_next_step(tmp_path: Path) -> None:
    pair = set_up(tmp_path, FAR, players=3, tokens=2)
    assert pair.worlds.action_names[-2:] == ("say_1", "say_2")
    place = told(pair, "x"), told(pair, "y")
    act(pair, 6, 5, DOWN)  # the first says 2, the second 1
    heard = pair.worlds.observations[0, :, 4:8].tolist()
    assert heard == [[1, 0, 0, 0], [0, 0, 0, 1], [0, 1, 1, 0]]  # of the next player, then of the one after
    assert (told(pair, "x")[:2], told(pair, "y")[:2]) == (place[0][:2], place[1][:2])
    act(pair, DOWN, DOWN, DOWN)
    assert not pair.worlds.observations[0, :, 4:8].any()


def test_a_shared_reward_is_the_mean_of_all(tmp_path: Path) -> None:
    pair = set_up(
        tmp_path, HERE, players=2, reward="kills", shared_reward=True, characters=QUIET + "hp = 20\n"
    )
    put(pair, x=(458.0, 832.0), y=(512.0, 832.0), facing=RIGHT)
    act(pair, ATTACK, UP)
    assert told(pair, "xp_gained") == [1.0, 0.0]
    assert told(pair, "reward") == [0.5, 0.5]


def test_another_weapon_strikes_otherwise(tmp_path: Path) -> None:
    pair = set_up(tmp_path, HERE, second_weapon="lance", reward="kills")
    put(pair, x=420.0, y=512.0, facing=RIGHT)
    act(pair, ATTACK)  # the blade's box ends at 420 + 38.5 + 39.5, the bamboo begins at 500
    assert told(pair, "hits") == [0]
    for _ in range(2):
        act(pair, ATTACK)
    assert pair.worlds.masks[0, 0, 5:7].tolist() == [0, 1]
    act(pair, 6)
    assert (told(pair, "second"), told(pair, "busy"), pair.worlds.observations[0, 0, 4]) == ([1], [0], 1.0)
    act(pair, ATTACK)  # the lance's at 420 + 68 + 40
    assert (told(pair, "hits"), hp_of_monster(pair), told(pair, "busy")) == ([1], 10.0, [48 - 8])
    assert pair.worlds.masks[0, 0, 5] == 0  # who attacks keeps its weapon
    act(pair, 5)
    assert told(pair, "second") == [1]
    assert pair.worlds.weapon_stats(0)["swing"].tolist() == [48]


def test_how_far_bodies_may_meet_holds_for_the_second_weapon_too(tmp_path: Path) -> None:
    hard = tmp_path / "hard.toml"
    hard.write_text("[weapons.lance]\nknock_back = 3000\n")
    reaches = {
        float(Worlds(1, make_env_config({"characters": str(hard), **chosen})).settings["body_reach"][0])
        for chosen in ({"weapons": "lance"}, {"second_weapon": "lance"})
    }
    assert len(reaches) == 1


def test_a_flame_burns_who_was_in_the_swords_box_where_blows_fall_on_entry(tmp_path: Path) -> None:
    tough = QUIET + "hp = 1000\n[weapons.blade]\nknock_back = 0\n"
    pair = set_up(tmp_path, HERE, blow="entry", magic=True, characters=tough)
    put(pair, x=458.0, y=512.0, facing=RIGHT)
    for _ in range(3):
        act(pair, ATTACK)
    before = hp_of_monster(pair)
    act(pair, 5)
    assert (before, hp_of_monster(pair)) == (980.0, 980.0 - 9)


@pytest.mark.parametrize(("blow", "hits"), [("attack", 1), ("entry", 2)])
def test_a_monster_that_comes_back_is_hit_again_where_blows_fall_on_entry(
    tmp_path: Path, blow: str, hits: int
) -> None:
    pair = set_up(
        tmp_path,
        HERE,
        blow=blow,
        characters=QUIET + "hp = 1000\n[weapons.blade]\nknock_back = 0\nswing = 0.6\n",
    )
    put(pair, x=458.0, y=512.0, facing=RIGHT)
    landed = 0
    for x in (458.0, 300.0, 458.0):  # one attack of 36 ticks, in which the player is carried off and back
        put(pair, x=x)
        act(pair, ATTACK)
        landed += int(told(pair, "hits")[0])
    assert landed == hits


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"level": "random:train:1", "monsters": "golems"}, "a golem falls to two players only"),
        ({"tokens": 2}, "with players = 1 nobody hears them"),
        ({"second_weapon": "lanse"}, "did you mean lance"),
        ({"weapons": "lance", "second_weapon": "lance"}, "it is the first one too"),
    ],
)
def test_what_one_player_cannot_play_is_refused(fields: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        Worlds(1, make_env_config(fields))


def test_two_hunters_from_two_sides_kill_a_golem() -> None:
    worlds = Worlds(1, make_env_config({"level": "random:train:1", "monsters": "golems", "players": 2}))
    worlds.seed([0])
    worlds.reset()
    golem = [kind for kind, _, _ in worlds.level.monsters].index("golem")
    worlds.monsters["hp"][0, np.arange(14) != golem] = 0
    for _ in range(20):
        x, y = (float(worlds.monsters[axis][0, golem]) for axis in "xy")
        worlds.players["x"], worlds.players["y"] = (x - 54, x + 54), y
        worlds.players["facing"] = (RIGHT, LEFT)
        worlds.observe()
        worlds.step(np.array([[ATTACK, ATTACK]]))
    assert worlds.worlds["monsters_left"][0] == 0
