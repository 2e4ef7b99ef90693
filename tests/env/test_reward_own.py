"""Rewards of a user's own."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from pneuma.config import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import ATTACK, play, stage

_NUMBERS = itertools.count()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the current folder, in which modules are looked for."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path


def write(folder: Path, body: str) -> str:
    """Write a module with one reward, under a name that no other test has; return the reward's name."""
    module = f"own_reward_{next(_NUMBERS)}"
    lines = "\n".join("    " + line for line in body.splitlines())
    text = f"import numpy as np\n\n\ndef pay(events, players, stats):\n{lines}\n"
    (folder / f"{module}.py").write_text(text)
    return f"{module}:pay"


def rewards(worlds: Worlds) -> list[float]:
    return [float(reward) for reward in worlds.events["reward"][0]]


# --- A reward of one's own -----------------------------------------------------------------------


def test_it_is_computed_from_events_players_and_stats(folder: Path, arena: str) -> None:
    body = (
        "assert events.shape == players.shape == (1, 1) and stats.shape == (1,)\n"
        'return 10 * events["hits"] - events["hp_lost"] / stats["hp"] + players["xp"]'
    )
    worlds = stage(arena, (80.0, 0.0), (-40.0, 0.0), still=True, settings={"reward": write(folder, body)})
    worlds.players["xp"] = 3
    play(worlds, ATTACK)
    assert rewards(worlds) == [10 - 0.07 + 3]


def test_it_cannot_change_the_world(folder: Path) -> None:
    for body in ('players["hp"][:] = 0', 'events["kills"] += 1', 'stats["damage"] = 99'):
        assert re.search(r"line 5: ValueError: .* is read-only", told_of(write(folder, body)))


# --- Mistakes in it ------------------------------------------------------------------------------


def told_of(reward: str) -> str:
    """Return what is said of a reward when a world is made with it."""
    with pytest.raises(UserError) as caught:
        Worlds(2, make_env_config({"reward": reward}))
    return str(caught.value)


@pytest.mark.parametrize(
    ("body", "line", "told"),
    [
        ("x = 1\nreturn events['kilss']", 6, "ValueError: no field of name kilss"),
        ("return 1 / 0", 5, "ZeroDivisionError: division by zero"),
        ("raise KeyError", 5, "KeyError"),
        ("raise SystemError('a\\nb')", 5, "SystemError: a b"),
        ("return 'much'", 4, "ValueError: could not convert string to float: 'much'"),
        ("return np.ones(2)", 4, "returned shape (2,), where (2, 1) was asked for"),
        ("return np.full((2, 1), np.nan)", 4, "returned a number that is not finite"),
        ("return -events['distance']", 4, "events['distance'] is infinite where no monster lives"),
    ],
)
def test_a_mistake_is_told_at_once_with_file_and_line(folder: Path, body: str, line: int, told: str) -> None:
    name = write(folder, body)
    message = told_of(name)
    file = folder / f"{name.partition(':')[0]}.py"
    assert message.startswith(f"reward '{name}': {file}, line {line}: ") and told in message
    assert "\n" not in message


def test_a_mistake_in_a_later_step_is_told_with_file_and_line(folder: Path, arena: str) -> None:
    body = 'assert not events["hits"].any(), "somebody was hit"\nreturn np.zeros(events.shape)'
    worlds = stage(arena, (54.0, 0.0), still=True, settings={"reward": (name := write(folder, body))})
    with pytest.raises(UserError) as caught:
        play(worlds, ATTACK)
    file = folder / f"{name.partition(':')[0]}.py"
    assert str(caught.value) == f"reward '{name}': {file}, line 5: AssertionError: somebody was hit"
