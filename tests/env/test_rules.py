"""The rules by hand: what facts and text say of numbers, worked out as short sums; the oracle plays along.

`test_oracle.py` compares the compiled rules with the oracle in everything else.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.players import Hunter
from pneuma.env.rules import ATTACK, DOWN, FLAME, LEFT, RIGHT, UP
from pneuma.env.worlds import Worlds

from .arena import GODOT, begin, characters_file, play, stage
from .oracle import Pair as Place


def test_an_attack_lasts_three_steps_in_which_walking_does_nothing(arena: str) -> None:
    pair = stage(arena, facing=UP)
    pair.play(ATTACK, LEFT, DOWN)  # 0.4 s = 24 ticks = 3 steps
    assert (pair.player("x"), pair.player("y"), pair.player("facing")) == ([0], [0], [UP])
    pair.play(LEFT)
    assert (pair.player("x"), pair.player("y"), pair.player("facing")) == ([-40], [0], [LEFT])


def test_a_blow_knocks_back_60_px_away_from_the_hilt(arena: str) -> None:
    # The monster at (84, -26) is (30, -40) = 50 x (0.6, -0.8) from the hilt. 2 px a tick for 30 ticks:
    # 60 x (0.6, -0.8) = (36, -48), so it lands at (120, -74).
    pair = stage(arena, (84.0, -26.0), ticks=1)
    for ticks, position in ((1, (85.2, -27.6)), (29, (120.0, -74.0)), (1, (117.5, -71.5))):  # it comes back
        pair.play(*[ATTACK] * ticks)
        assert pair.monster("x", "y") == pytest.approx(position)


def test_a_monster_enters_the_swords_box_again_after_a_flame(arena: str, tmp_path: Path) -> None:
    # Left of the hilt, it is knocked back against the player and stays in the box. All strikes last one tick.
    short = characters_file(tmp_path, "[spells.flame]\ncast = 0.017\n")
    swings: dict[str, Any] = {"blow": "entry", "attack_ticks": 1, "magic": True, "characters": short}
    pair = stage(arena, (40.0, 14.0), still=True, ticks=1, **swings)
    hits = []
    for action in (ATTACK, ATTACK, FLAME, ATTACK):
        pair.play(action)
        hits += pair.player("hits")
    assert hits == [1, 0, 1, 1]


@pytest.mark.parametrize(
    ("event", "facing", "last", "outwards"),
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
    arena: str, event: str, facing: int, last: Place, outwards: Place
) -> None:
    for further in (0.0, 0.25):
        bamboo = last[0] + further * outwards[0], last[1] + further * outwards[1]
        pair = stage(arena, bamboo, facing=facing, still=True)
        pair.play(ATTACK)
        assert pair.player(event) == [further == 0]


def test_the_first_bite_comes_at_once_and_the_next_60_ticks_later(arena: str) -> None:
    pair = stage(arena, (-40.0, 0.0), ticks=1)
    hp = []
    for _ in range(121):
        pair.play(ATTACK)
        hp += pair.player("hp")
    assert hp == [93] * 60 + [86] * 60 + [79]


@pytest.mark.parametrize("action", [LEFT, RIGHT])
def test_who_walks_one_way_for_ever_is_bitten_to_death_as_the_collapsed_logs_are(action: int) -> None:
    """Six of the published logs end with episodes of 93 to 115 steps in the mean."""
    worlds = begin(1, env_id=GODOT)
    while worlds.ending(0) == "running":
        play(worlds, action)
    assert (worlds.ending(0), worlds.worlds["steps"][0]) == ("killed", 111)


@pytest.mark.parametrize("players", [1, 2])
@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, players: int) -> None:
    worlds = Worlds(6, make_env_config({"players": players, "end_on_clear": True, "start": "random"}, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    hunter = Hunter(worlds)
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(hunter.act(worlds))
    assert [worlds.ending(index) for index in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()
