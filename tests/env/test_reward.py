"""Rewards: every formula by hand, and functions of a user's own."""

from __future__ import annotations

import itertools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.env.fields import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import ATTACK, stage
from .oracle import Pair as Place
from .oracle_arrays import Pair

_NUMBERS = itertools.count()

PREY, BITER, FAR = (80.0, 0.0), (-40.0, 0.0), (400.0, 400.0)


def fight(arena: str, reward: str, *monsters: Place) -> Pair:
    """Set up a player with 3 XP and 50 HP, facing right, and monsters that stay where they are.

    The first dies of a blow: 1 XP and 7 HP. A bite costs 7.
    """
    pair = stage(arena, *monsters, still=True, reward=reward)
    pair.put(monsters=True, hp=[20])
    pair.put(xp=3, hp=50)
    return pair


@pytest.mark.parametrize(
    ("reward", "monsters", "expected"),
    [
        ("thesis", [PREY, BITER], 4 - 0.5),
        ("thesis", [BITER], 3 - 0.43),
        ("pygame", [PREY], 4 + 0.57),
        ("kills", [PREY, BITER], 1 - 0.07),  # HP gained do not count
        ("distance-sigmoid", [(-150.0, 0.0), FAR], 0.5),
        ("distance-sigmoid", [(-25.0, 0.0), FAR], 0.5 + 2.5 / 2 / math.sqrt(7.25)),  # z = 2.5
        ("distance-sigmoid", [(-250.0, 0.0), FAR], 0.5 - 2 / 2 / math.sqrt(5)),  # z = -2
    ],
)
def test_formulas_by_hand(arena: str, reward: str, monsters: list[Place], expected: float) -> None:
    pair = fight(arena, reward, *monsters)
    pair.play(ATTACK)
    assert pair.player("reward") == [pytest.approx(expected, abs=1e-12)]


def test_godot_sets_the_reward_to_the_xp_at_a_kill(arena: str) -> None:
    # Tick 1: both monsters notice, +2. Tick 5: the first has flown from 96.5 to 88.5, within the sword's 90,
    # and dies: the reward is set to 3 + 1 XP. Tick 6: the other comes within 40 px, +1.
    pair = fight(arena, "godot", (96.5, 0.0), (-73.5, 0.0))
    pair.put(monsters=True, knocked=[30, 30], knock_x=[-2.0, 2.0])
    pair.play(ATTACK)
    assert [pair.player(name) for name in ("notices", "kills", "contacts", "reward")] == [[2], [1], [1], [5]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder, in which modules are looked for."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder: Path, body: str) -> str:
    """Write a module with one reward, under a name that no other test has; return the reward's name."""
    module = f"own_reward_{next(_NUMBERS)}"
    lines = "\n".join("    " + line for line in body.splitlines())
    text = f"import numpy as np\n\n\ndef pay(events, players, stats):\n{lines}\n"
    (folder / f"{module}.py").write_text(text)
    return f"{module}:pay"


def test_it_is_computed_from_events_players_and_stats_and_may_be_shared(folder: Path, arena: str) -> None:
    body = (
        "assert events.shape == players.shape == (1, 2) and stats.shape == (2,)\n"
        'return 10 * events["hits"] - events["hp_lost"] / stats["hp"] + players["xp"]'
    )
    for shared, expected in ((False, [10 - 0.07 + 3, 1]), (True, [13.93 / 2] * 2)):
        settings: dict[str, Any] = {"reward": [write(folder, body), "thesis"], "shared_reward": shared}
        worlds = stage(arena, PREY, BITER, still=True, players=2, **settings).worlds
        worlds.players["xp"][0], worlds.players["x"][0, 1] = (3, 2), 500
        worlds.step(np.full((1, 2), ATTACK))
        assert worlds.events["reward"][0] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("x = 1\nreturn events['kilss']", "{file}, line 6: ValueError: no field of name kilss"),
        ("players['hp'][:] = 99", "{file}, line 5: ValueError: .* is read-only"),
        ("events['kills'] = 99", "{file}, line 5: ValueError: .* is read-only"),
        ("stats['hp'] = 99", "{file}, line 5: ValueError: .* is read-only"),
        ("return np.ones(2)", r"returned shape \(2,\), not \(2, 1\)"),
        (
            "return -events['distance']",
            r"returned a number that is not finite; events\['distance'\] is infinite",
        ),
    ],
)
def test_a_mistake_in_an_own_reward_is_one_line(folder: Path, body: str, message: str) -> None:
    name = write(folder, body)
    file = re.escape(str(folder / f"{name.partition(':')[0]}.py"))
    with pytest.raises(UserError, match=f"^reward '{name}': {message.format(file=file)}"):
        Worlds(2, make_env_config({"reward": name}))
