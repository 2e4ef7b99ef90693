"""Rewards: every formula by hand, one for each player, functions of a user's own, vectors."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.env import MO_ENVIRONMENTS
from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.gym import PneumaEnv
from pneuma.env.mo import PneumaMOEnv
from pneuma.env.reward import PARTS
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError
from pneuma.own_modules import module_files

from .arena import ATTACK, STAND, Place, play, stage

_NUMBERS = itertools.count()


def rewards(worlds: Worlds) -> list[float]:
    """Return the rewards of the first world's players for the last step."""
    return [float(reward) for reward in worlds.events["reward"][0]]


def fight(arena: str, reward: str | Sequence[str], *monsters: Place, **settings: object) -> Worlds:
    """Set up a player with 3 XP and 50 HP, facing right, and monsters that stay where they are.

    The first dies of a blow: 1 XP and 7 HP.
    """
    worlds = stage(arena, *monsters, still=True, settings={"reward": reward, **settings})
    worlds.players["xp"], worlds.players["hp"], worlds.monsters["hp"][0, 0] = 3, 50, 20
    return worlds


# --- Formulas ------------------------------------------------------------------------------------

PREY, BITER = (80.0, 0.0), (-40.0, 0.0)  # a bite of 7
FAR = (400.0, 400.0)


@pytest.mark.parametrize(
    ("reward", "monsters", "expected"),
    [
        ("thesis", [], 3 - 0.5),
        ("thesis", [BITER], 3 - 0.43),
        ("thesis", [PREY], 4 - 0.57),
        ("pygame", [], 3 + 0.5),
        ("pygame", [BITER], 3 + 0.43),
        ("pygame", [PREY], 4 + 0.57),
        ("kills", [], 0.0),
        ("kills", [PREY, BITER], 1 - 0.07),  # HP gained do not count
        ("distance-sigmoid", [(-150.0, 0.0), FAR], 0.5),
        ("distance-sigmoid", [(-100.0, 0.0), FAR], 0.5 + 0.5 / math.sqrt(2)),  # z = 1
        ("distance-sigmoid", [(-25.0, 0.0), FAR], 0.5 + 2.5 / 2 / math.sqrt(7.25)),  # z = 2.5
        ("distance-sigmoid", [(-250.0, 0.0), FAR], 0.5 - 2 / 2 / math.sqrt(5)),  # z = -2
    ],
)
def test_formulas_by_hand(arena: str, reward: str, monsters: list[Place], expected: float) -> None:
    worlds = fight(arena, reward, *monsters)
    play(worlds, ATTACK)
    assert rewards(worlds) == [pytest.approx(expected, abs=1e-12)]


def test_godot_sets_the_reward_to_the_xp_at_a_kill(arena: str) -> None:
    # Tick 1: both monsters notice, +2. Tick 5: the first has flown from 96.5 to 88.5, within the sword's 90,
    # and dies: the reward is set to 3 + 1 XP. Tick 6: the other comes within 40 px, +1.
    worlds = fight(arena, "godot", (96.5, 0.0), (-73.5, 0.0))
    flying = worlds.monsters[0, :2]
    flying["knocked"], flying["knock_x"] = 30, (-2.0, 2.0)
    play(worlds, ATTACK)
    event = worlds.events[0, 0]
    assert (event["notices"], event["kills"], event["contacts"]) == (2, 1, 1)
    assert rewards(worlds) == [5.0]


@pytest.mark.parametrize(("cost", "paid"), [(0.0, 2.0), (1.0, 2.0), (2.0, 1.0)])
def test_godot_sets_the_reward_to_the_xp_at_a_death_that_costs(arena: str, cost: float, paid: float) -> None:
    # A notice and a contact, +2, and the death by the bite: the reward is set to 3 XP less the cost.
    worlds = fight(arena, "godot", BITER, ending_cost=cost)
    worlds.players["hp"] = 7
    play(worlds, STAND)
    assert worlds.ending(0) == "killed"
    assert (rewards(worlds), worlds.players["xp"][0, 0]) == ([paid], 3 - cost)
    assert worlds.events["xp_gained"][0, 0] == -cost


# --- Functions of one's own ----------------------------------------------------------------------


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
    for body in ('players["hp"][:] = 0', 'events["kills"] += 1', 'stats["speed"] = 99'):
        assert re.search(r"line 5: ValueError: .* is read-only", told_of(write(folder, body)))


def told_of(reward: str) -> str:
    """Return what is said of a reward when a world is made with it."""
    with pytest.raises(UserError) as caught:
        Worlds(2, make_env_config({"reward": reward}))
    return str(caught.value)


@pytest.mark.parametrize(
    ("body", "line", "told"),
    [
        ("x = 1\nreturn events['kilss']", 6, "ValueError: no field of name kilss"),
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


# --- Vector rewards -------------------------------------------------------------------------------


def make(name: str, **settings: Any) -> PneumaMOEnv:
    env = gymnasium.make(name, disable_env_checker=True, **settings).unwrapped
    assert isinstance(env, PneumaMOEnv)
    return env


def test_the_parts_are_what_they_are_called(arena: str) -> None:
    env = make(MO_ENVIRONMENTS[0], level=arena)
    env.reset(seed=0)
    players, monsters = env.state.players, env.state.monsters
    players["xp"], players["hp"], players["facing"] = 3, 50, 3
    for index, (x, y) in enumerate([(80.0, 0.0), (-40.0, 0.0), (-200.0, 0.0)]):
        monsters["x"][0, index], monsters["y"][0, index] = x, y
    monsters["hp"][0, 0] = 20
    # A kill (1 XP and 7 HP) before it is noticed, a bite of 7, two notices and one contact.
    assert env.step(np.int64(ATTACK))[1].tolist() == pytest.approx([4, 0.5, 1, 0.07, 2, 1])


@pytest.mark.parametrize(
    ("formula", "plus", "minus"), [("thesis", "xp", "hp"), ("kills", "xp_gained", "hp_lost")]
)
@pytest.mark.parametrize(("name", "world"), list(zip(MO_ENVIRONMENTS, ENVIRONMENTS, strict=True))[:3])
def test_two_parts_make_a_formula_and_none_leaves_its_space(
    name: str, world: str, formula: str, plus: str, minus: str, pit: str
) -> None:
    """In the pit a player is bitten by five monsters and dies, or kills some of them first."""
    settings: dict[str, Any] = {"level": pit, "episode_steps": 40}
    env = make(name, **settings)
    assert env.reward_dim == len(PARTS) == 6
    scalar = PneumaEnv(world, reward=formula, **settings)
    generator = np.random.default_rng(1)
    env.reset(seed=3)
    scalar.reset(seed=3)
    endings = set()
    for _ in range(600):
        action = np.int64(generator.choice([0, 1, 2, 3, ATTACK, ATTACK]))
        _, parts, *over, info = env.step(action)
        _, reward, *_ = scalar.step(action)
        assert isinstance(parts, np.ndarray) and env.reward_space.contains(parts)
        share = parts[PARTS.index(plus)] - parts[PARTS.index(minus)]
        assert share == pytest.approx(reward, abs=1e-5)
        if any(over):
            endings.add(info["ending"])
            env.reset()
            scalar.reset()
    assert "killed" in endings


# --- Files of one's own reward, which are part of a run's id --------------------------------------


def test_a_module_is_its_file_and_a_package_all_of_its_files(tmp_path: Path) -> None:
    names = ("mine.py", "own/__init__.py", "own/deep/inner.py", "own/other.py")
    paths = [tmp_path / name for name in names]
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("import os\n")
    assert module_files(str(paths[0])) == paths[:1]
    assert module_files(str(paths[1])) == paths[1:]
    assert module_files(str(paths[3])) == paths[3:]
