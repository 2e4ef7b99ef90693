"""Rewards of a user's own, and vector rewards of the same parts."""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pneuma.config import ENVIRONMENTS, make_env_config
from pneuma.env import MO_ENVIRONMENTS
from pneuma.env.reward import PARTS
from pneuma.env.single import PneumaEnv, PneumaMOEnv
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import ATTACK, GODOT, HEAL, STAND, THESIS, move_monster, play, stage

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


def refused(reward: str, **settings: object) -> str:
    """Return what is said of a reward when a world is made with it and played for a step."""
    with pytest.raises(UserError) as caught:
        worlds = Worlds(2, make_env_config({"reward": reward, **settings}))
        worlds.seed([0, 1])
        worlds.reset()
        play(worlds, STAND)
    message = str(caught.value)
    assert message.startswith(f"reward '{reward}'") and "\n" not in message
    return message


# --- A reward of one's own -----------------------------------------------------------------------


def test_it_is_computed_from_events_players_and_stats(folder: Path, arena: str) -> None:
    body = (
        "assert events.shape == players.shape == (1, 1) and stats.shape == (1,)\n"
        'return 10 * events["hits"] - events["hp_lost"] / stats["hp"] + players["xp"]'
    )
    worlds = stage(arena, (54.0, 60.0), (-30.0, 0.0), still=True, settings={"reward": write(folder, body)})
    worlds.players["xp"] = 3
    play(worlds, ATTACK)
    assert rewards(worlds) == [10 - 0.07 + 3]


def test_it_sees_how_far_the_nearest_living_monster_is(folder: Path, arena: str) -> None:
    own = write(folder, 'return np.where(np.isinf(events["distance"]), -1.0, events["distance"])')
    worlds = stage(arena, (-300.0, 400.0), (0.0, 90.0), still=True, settings={"reward": own})
    worlds.monsters["hp"][0, 1:] = 0
    play(worlds, STAND)
    assert rewards(worlds) == [500.0]  # 300, 400, 500
    worlds.monsters["hp"] = 0
    play(worlds, STAND)
    assert rewards(worlds) == [-1.0]


def test_it_sees_for_how_long_each_player_lived(folder: Path, arena: str) -> None:
    own = write(folder, 'return events["present"] + 100 * events["died"]')
    worlds = stage(arena, players=[(0.0, 0.0), (400.0, -400.0)], settings={"reward": own})
    worlds.monsters["knocked"][0, 0], worlds.monsters["knock_x"][0, 0] = 30, 2.0
    move_monster(worlds, 0, -67.5, 0.0)  # 40 px off the body in tick 3
    worlds.players["hp"][0, 0] = 7
    play(worlds, STAND)
    assert rewards(worlds) == [103.0, 8.0]
    play(worlds, STAND)
    assert rewards(worlds) == [0.0, 8.0]


def test_what_it_imports_when_it_is_called_is_found_beside_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path not in ("", str(folder))])
    name = write(folder, "from own_bonus import BONUS\nreturn np.full(events.shape, BONUS)")
    (folder / "own_bonus.py").write_text("BONUS = 2.5\n")
    env = PneumaEnv(reward=name)
    env.reset(seed=0)
    assert env.step(np.int64(STAND))[1] == 2.5


def test_a_module_that_would_end_the_command_is_told(folder: Path) -> None:
    (folder / "own_exit.py").write_text("raise SystemExit(0)\n")
    with pytest.raises(UserError, match="reward 'own_exit:pay': SystemExit: 0"):
        PneumaEnv(reward="own_exit:pay")


def test_it_may_pay_one_player_while_another_has_a_formula(folder: Path, arena: str) -> None:
    own = write(folder, "return np.full(events.shape, 42.0)")
    worlds = stage(arena, players=[(0.0, 0.0), (100.0, 0.0)], settings={"reward": ["thesis", own]})
    play(worlds, STAND)
    assert rewards(worlds) == [-1.0, 42.0]


def test_two_players_may_have_two_of_them(folder: Path, arena: str) -> None:
    own = [write(folder, f"return np.full(events.shape, {value})") for value in (1.5, 2.5)]
    worlds = stage(arena, players=[(0.0, 0.0), (100.0, 0.0)], settings={"reward": own})
    play(worlds, STAND)
    assert rewards(worlds) == [1.5, 2.5]


def test_it_is_called_once_a_step_however_many_players_have_it(folder: Path, arena: str) -> None:
    own = write(folder, "pay.calls = getattr(pay, 'calls', 0) + 1\nreturn np.full(events.shape, pay.calls)")
    players = [(0.0, 0.0), (100.0, 0.0), (200.0, 0.0)]
    worlds = stage(arena, players=players, settings={"reward": [own, "thesis", own]})
    play(worlds, STAND)
    assert rewards(worlds) == [2.0, -1.0, 2.0]  # the first call tried it


def test_what_it_prints_stays_out_of_a_commands_document(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = write(folder, "print('called')\nreturn np.zeros(events.shape)")
    path = folder / f"{own.partition(':')[0]}.py"
    path.write_text(path.read_text() + "\n\nprint('imported')\n")
    Worlds(1, make_env_config({"reward": own}))
    told = capsys.readouterr()
    assert told.out == "" and told.err.split() == ["imported", "called"]


def test_what_it_pays_the_dead_is_not_used(folder: Path, arena: str) -> None:
    own = write(folder, 'return np.where(events["present"] > 0, 1.0, 99.0)')
    worlds = stage(arena, (-30.0, 0.0), players=[(0.0, 0.0), (400.0, -400.0)], settings={"reward": own})
    worlds.players["hp"][0, 0] = 7
    play(worlds, STAND)
    assert rewards(worlds) == [1.0, 1.0]
    play(worlds, STAND)
    assert rewards(worlds) == [0.0, 1.0]


def test_nor_need_it_be_a_number(folder: Path, arena: str) -> None:
    own = write(folder, 'return np.where(events["present"] > 0, 1.0, np.nan)')
    worlds = stage(arena, (-30.0, 0.0), players=[(0.0, 0.0), (400.0, -400.0)], settings={"reward": own})
    worlds.players["hp"][0, 0] = 7
    play(worlds, STAND, STAND)
    assert rewards(worlds) == [0.0, 1.0]


def test_every_face_pays_it(folder: Path) -> None:
    own = write(folder, 'return 0.5 + events["present"]')
    env = gymnasium.make(THESIS, reward=own)
    env.reset(seed=0)
    assert env.step(np.int64(0))[1] == 8.5
    vector = gymnasium.make_vec(THESIS, num_envs=3, reward=own)
    vector.reset(seed=0)
    assert vector.step(np.zeros(3, np.int64))[1].tolist() == [8.5] * 3


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


def test_when_it_is_tried_every_player_stands_at_a_start_with_full_hp(folder: Path) -> None:
    body = (
        "assert (events['present'] == 8).all() and np.isinf(events['distance']).all()\n"
        "assert (players['hp'] == stats['hp']).all() and players['x'][0].tolist() == [204, 389]\n"
        "return np.zeros(events.shape)"
    )
    settings = {"reward": write(folder, body), "players": 2, "classes": ["tank", "mage"]}
    worlds = Worlds(3, make_env_config(settings))
    assert not worlds.events["present"].any() and not worlds.players["hp"].any()  # nothing is left of it


def test_a_missing_module_or_function_is_told(folder: Path) -> None:
    assert "No module named 'no_such_module'" in refused("no_such_module:pay")
    module = write(folder, "return events").partition(":")[0]
    assert refused(f"{module}:pya").endswith(f"module {module} has no function pya")
    assert "has no function np2" in refused(f"{module}:np2")


@pytest.mark.parametrize("name", ["..rewards:pay", ".:pay", ".rewards:pay"])
def test_a_name_that_no_module_can_have_is_refused(folder: Path, name: str) -> None:
    with pytest.raises(UserError):
        Worlds(1, make_env_config({"reward": name}))


def test_a_module_that_cannot_be_read_is_told(folder: Path) -> None:
    (folder / "own_reward_broken.py").write_text("def pay(:\n")
    refused("own_reward_broken:pay")


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("return 1.0", "returned shape (), where (2, 1) was asked for"),
        ("return np.ones(2)", "returned shape (2,), where (2, 1) was asked for"),
        ("return np.ones((2, 1, 1))", "returned shape (2, 1, 1), where (2, 1)"),
        ("pass", "returned shape ()"),
        ("return np.full((2, 1), np.nan)", "returned a number that is not finite"),
        ("return np.array([[0.0], [np.inf]])", "returned a number that is not finite"),
    ],
)
def test_what_it_returns_is_checked_at_every_step(folder: Path, body: str, told: str) -> None:
    assert told in refused(write(folder, body))


@pytest.mark.parametrize("name", ["thessis", "my module:pay", "module:", ":pay", "module:pay:twice"])
def test_a_name_of_another_form_is_refused(name: str) -> None:
    with pytest.raises(UserError, match="is not allowed.*: one of thesis, .*or module:function"):
        make_env_config({"reward": name})


# --- Vector rewards ------------------------------------------------------------------------------


def make(name: str, **settings: Any) -> PneumaMOEnv:
    env = gymnasium.make(name, disable_env_checker=True, **settings).unwrapped
    assert isinstance(env, PneumaMOEnv)
    return env


@pytest.mark.parametrize("name", MO_ENVIRONMENTS)
def test_the_reward_is_an_array_in_its_space(name: str) -> None:
    env = make(name)
    assert env.reward_dim == len(PARTS) == 6
    assert env.reward_space.shape == (6,) and env.reward_space.dtype == np.float32
    env.reset(seed=0)
    reward = env.step(np.int64(STAND))[1]
    assert isinstance(reward, np.ndarray) and reward.shape == (6,) and reward.dtype == np.float32
    assert env.reward_space.contains(reward)


def test_the_parts_are_what_they_are_called(arena: str) -> None:
    env = make(MO_ENVIRONMENTS[0], level=arena)
    env.reset(seed=0)
    players, monsters = env.state.players, env.state.monsters
    players["xp"], players["hp"], players["facing"] = 3, 50, 3
    for index, (x, y) in enumerate([(54.0, 60.0), (-30.0, 0.0), (-200.0, 0.0)]):
        monsters["x"][0, index], monsters["y"][0, index] = x, y
    monsters["hp"][0, 0] = 20
    # A kill (1 XP and 7 HP) before it is noticed, a bite of 7, two notices and one contact.
    assert env.step(np.int64(ATTACK))[1].tolist() == pytest.approx([4, 0.5, 1, 0.07, 2, 1])


@pytest.mark.parametrize("name", MO_ENVIRONMENTS)
@pytest.mark.parametrize("policy", ["random", "fights"])
def test_no_reward_ever_leaves_the_space(name: str, policy: str, pit: str) -> None:
    """In the pit a player is bitten by five monsters and dies, or kills some of them first."""
    env = make(name, level=pit, episode_steps=40)
    generator = np.random.default_rng(0)
    env.reset(seed=0)
    endings = set()
    for _ in range(600):
        fights = policy == "fights" and generator.random() < 0.8
        action = np.int64(ATTACK if fights else generator.integers(5))
        _, reward, terminated, truncated, info = env.step(action)
        assert env.reward_space.contains(reward), (reward, env.reward_space)
        if terminated or truncated:
            endings.add(info["ending"])
            env.reset()
    assert "killed" in endings


def test_who_is_healed_between_two_bites_may_lose_more_than_full_hp(tmp_path: Path, arena: str) -> None:
    """99 HP in the first tick; 20 come back in the fourth, and all 21 go in the sixth: 120 of 100."""
    file = tmp_path / "fierce.toml"
    file.write_text("[monsters.bamboo]\ndamage = 99\n")
    env = make(MO_ENVIRONMENTS[0], level=arena, characters=str(file), magic=True)
    env.reset(seed=0)
    env.state.players["busy"] = 3
    monsters = env.state.monsters
    monsters["x"][0, :2], monsters["y"][0, :2] = [-30.0, -73.5], 0.0
    monsters["knocked"][0, 1], monsters["knock_x"][0, 1] = 30, 2.0  # within reach in the sixth tick
    _, reward, terminated, *_ = env.step(np.int64(HEAL))
    assert terminated
    assert reward[PARTS.index("hp_lost")] == pytest.approx(1.2)
    assert env.reward_space.contains(reward)


@pytest.mark.parametrize(
    ("formula", "plus", "minus"), [("thesis", "xp", "hp"), ("kills", "xp_gained", "hp_lost")]
)
@pytest.mark.parametrize(("name", "world"), list(zip(MO_ENVIRONMENTS, ENVIRONMENTS, strict=True)))
def test_two_parts_make_a_formula(
    name: str, world: str, formula: str, plus: str, minus: str, pit: str
) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 40}
    env = make(name, **settings)
    scalar = PneumaEnv(world, reward=formula, **settings)
    generator = np.random.default_rng(1)
    env.reset(seed=3)
    scalar.reset(seed=3)
    for _ in range(300):
        action = np.int64(generator.choice([0, 1, 2, 3, ATTACK, ATTACK]))
        _, parts, *over, _ = env.step(action)
        _, reward, *_ = scalar.step(action)
        share = parts[PARTS.index(plus)] - parts[PARTS.index(minus)]
        assert share == pytest.approx(reward, abs=1e-5)
        if any(over):
            env.reset()
            scalar.reset()


def test_gymnasium_makes_it_without_a_warning() -> None:
    env = gymnasium.make(MO_ENVIRONMENTS[0])  # a warning would be an error here
    env.reset(seed=0)
    env.step(0)


def test_a_reward_of_another_name_is_refused() -> None:
    for make_it in (make, lambda name, **settings: gymnasium.make_vec(name, num_envs=2, **settings)):
        with pytest.raises(UserError, match="reward = 'kills' is not allowed: vector rewards are always"):
            make_it(MO_ENVIRONMENTS[0], reward="kills")


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", MO_ENVIRONMENTS)
def test_worlds_side_by_side_pay_what_each_pays_alone(name: str, mode: AutoresetMode, pit: str) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 40, "start": "random"}
    envs = gymnasium.make_vec(name, num_envs=3, autoreset_mode=mode, **settings)
    singles = [make(name, **settings) for _ in range(3)]
    assert envs.unwrapped.reward_space == singles[0].reward_space  # type: ignore[attr-defined]
    envs.reset(seed=4)
    for i, env in enumerate(singles):
        env.reset(seed=4 + i)
    generator = np.random.default_rng(1)
    over = np.zeros(3, bool)
    ended = 0
    for _ in range(120):
        actions = generator.choice([0, 1, 2, 3, ATTACK, ATTACK], size=3)
        if mode == AutoresetMode.DISABLED and over.any():
            envs.reset(options={"reset_mask": over})
        rewards = envs.step(actions)[1]
        assert rewards.shape == (3, 6) and rewards.dtype == np.float32
        for i, env in enumerate(singles):
            if over[i]:
                env.reset()
                if mode == AutoresetMode.NEXT_STEP:
                    over[i] = False
                    assert not rewards[i].any()
                    continue
            _, expected, terminated, truncated, _ = env.step(actions[i])
            over[i] = terminated or truncated
            ended += int(over[i])
            assert np.array_equal(rewards[i], expected)
    assert ended > 3


def test_godots_xp_of_a_death_is_in_the_vector(pit: str) -> None:
    env = make(MO_ENVIRONMENTS[ENVIRONMENTS.index(GODOT)], level=pit)
    env.reset(seed=0)
    env.state.players["hp"] = 7
    _, reward, terminated, *_ = env.step(np.int64(STAND))
    assert terminated
    assert reward[:3].tolist() == [-1, 0, -1]  # XP -1, no HP, -1 XP gained
