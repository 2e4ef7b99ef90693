"""The single environment: Gymnasium's contract."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.env.single import PneumaEnv
from pneuma.errors import UserError

from .arena import ATTACK, RIGHT, THESIS


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
