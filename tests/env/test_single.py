"""The single environment: Gymnasium's contract."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_for_sb3

from pneuma.config import ENVIRONMENTS
from pneuma.env.single import PneumaEnv
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import ATTACK, DOWN, RIGHT, THESIS

STARTS = [(204, -105), (389, 348), (-239, -798), (-517, 897), (-918, -35), (-47, 201)]


def make(env_id: str = THESIS, **settings: Any) -> PneumaEnv:
    """Return the environment as `gymnasium.make` makes it, without its wrappers."""
    env = gymnasium.make(env_id, **settings).unwrapped
    assert isinstance(env, PneumaEnv)
    return env


def place(env: PneumaEnv) -> tuple[float, float]:
    return float(env.state.players["x"][0, 0]), float(env.state.players["y"][0, 0])


def unmasked(info: dict[str, Any]) -> dict[str, Any]:
    """Return an info without the action mask, which every one has."""
    assert info["action_mask"].shape == (5,)
    return {key: value for key, value in info.items() if key != "action_mask"}


def threatened(env: PneumaEnv, hp: float) -> None:
    """Give the player so many HP and put a monster beside it, out of the sword's way."""
    x, y = place(env)
    env.state.players["hp"], env.state.players["facing"] = hp, RIGHT
    env.state.monsters["x"][0, 0], env.state.monsters["y"][0, 0] = x - 30, y


# --- The contract --------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"magic": True, "observation": "pygame", "reward": "kills", "classes": "mage"},
        {"observation": "godot", "coast": "deadly", "ending_cost": 2, "characters": "pygame"},
        {
            "level": "random:test:0",
            "random_levels": 3,
            "scale": "map",
            "perceive": "nearest:3",
            "order": "fixed",
        },
    ],
    ids=["usual", "pygame", "godot", "random levels"],
)
def test_the_checkers_find_nothing_to_complain_of(env_id: str, settings: dict[str, Any]) -> None:
    for check in (check_env, check_for_sb3):
        check(make(env_id, **settings))  # its warnings would be errors here


def test_the_spaces_are_those_of_the_thesis() -> None:
    env = make()
    assert isinstance(env.action_space, gymnasium.spaces.Discrete)
    assert env.action_space.n == 5
    assert env.observation_space.shape == (60,)  # 4 + 4 x 14


def test_the_same_seed_and_actions_give_the_same_bits() -> None:
    one, two = make(), make()
    generator = np.random.default_rng(0)
    for episode in range(3):
        seed = 11 if episode == 0 else None
        assert np.array_equal(one.reset(seed=seed)[0], two.reset(seed=seed)[0])
        for action in generator.integers(5, size=200):
            (seen, *told), (seen_too, *told_too) = one.step(action), two.step(action)
            assert seen.tobytes() == seen_too.tobytes()
            for info in (told[-1], told_too[-1]):
                info["action_mask"] = info["action_mask"].tolist()
            assert told == told_too
            if told[1] or told[2]:
                break


def test_seeding_again_begins_the_same_world_again() -> None:
    env = make()
    first = [env.reset(seed=5)[0]] + [env.reset()[0] for _ in range(10)]
    again = [env.reset(seed=5)[0]] + [env.reset()[0] for _ in range(10)]
    assert np.array_equal(first, again)
    assert len({observation.tobytes() for observation in first}) > 1  # other starts, though


def test_the_single_environment_is_a_world_of_its_seed() -> None:
    env = make()
    worlds = Worlds(1)
    worlds.seed([9])
    worlds.reset()
    assert np.array_equal(env.reset(seed=9)[0], worlds.observations[0, 0])
    for action in (RIGHT, ATTACK, DOWN, DOWN, RIGHT) * 20:
        observation, reward, *_ = env.step(np.int64(action))
        worlds.step(np.array([[action]]))
        assert np.array_equal(observation, worlds.observations[0, 0])
        assert reward == worlds.events["reward"][0, 0]


def test_what_is_handed_out_is_not_overwritten() -> None:
    env = make()
    first, _ = env.reset(seed=0)
    kept = first.copy()
    second, *_ = env.step(np.int64(RIGHT))
    assert np.array_equal(first, kept)
    assert not np.array_equal(first, second)


# --- Starts --------------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [None, {}, {"start": None}])
def test_without_a_choice_the_start_is_random(options: dict[str, Any] | None) -> None:
    env = make()
    places = set()
    for seed in range(40):
        env.reset(seed=seed, options=options)
        places.add(place(env))
    assert places == set(STARTS)


# --- The end -------------------------------------------------------------------------------------


def test_death_terminates() -> None:
    env = make()
    env.reset(seed=0)
    threatened(env, hp=7)
    _, reward, terminated, truncated, info = env.step(np.int64(ATTACK))
    assert (terminated, truncated) == (True, False)
    assert unmasked(info) == {"ending": "killed", "kills": 0, "xp": 0.0, "hp": 0.0}
    assert reward == 0.0


def test_the_time_limit_truncates() -> None:
    env = make(episode_steps=3)
    env.reset(seed=0)
    told = [env.step(np.int64(ATTACK))[2:] for _ in range(3)]
    ends = [(terminated, truncated, unmasked(info)) for terminated, truncated, info in told]
    assert ends[:2] == [(False, False, {})] * 2
    assert ends[2] == (False, True, {"ending": "time-limit", "kills": 0, "xp": 0.0, "hp": 100.0})


@pytest.mark.parametrize("end_on_clear", [False, True])
def test_clearing_the_level_terminates_if_asked(end_on_clear: bool) -> None:
    env = make(end_on_clear=end_on_clear)
    env.reset(seed=0)
    x, y = place(env)
    env.state.players["facing"] = RIGHT
    env.state.monsters["hp"] = 0
    env.state.monsters[0, 0] = env.state.monsters[0, 1]
    env.state.monsters["hp"][0, 0] = 20
    env.state.monsters["x"][0, 0], env.state.monsters["y"][0, 0] = x + 54, y
    env.state.worlds["monsters_left"] = 1
    _, reward, terminated, truncated, info = env.step(np.int64(ATTACK))
    assert (terminated, truncated) == (end_on_clear, False)
    ending = {"ending": "cleared", "kills": 1, "xp": 1.0, "hp": 107.0}
    assert unmasked(info) == (ending if end_on_clear else {})
    assert reward == pytest.approx(-0.07)  # 1 XP - 107 / 100


# --- Mistakes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"episode_steps": 0}, "episode_steps = 0 is not allowed"),
        ({"episode_step": 10}, "unknown key 'episode_step' (did you mean episode_steps?)"),
        ({"end_on_clear": "yes"}, 'end_on_clear = "yes" is not allowed'),
        ({"level": "tesis"}, "unknown level 'tesis' (did you mean thesis?)"),
        ({"reward": "godo"}, 'reward = "godo" is not allowed'),
        ({"render_mode": "humane"}, "render_mode = 'humane' is not allowed"),
        ({"players": 2}, "players = 2: this face has one player"),
        ({"env_id": "pneuma/Pneuma-v1"}, "unknown environment 'pneuma/Pneuma-v1'"),
    ],
)
def test_a_wrong_argument_is_named(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(UserError) as caught:
        PneumaEnv(**settings)
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)
