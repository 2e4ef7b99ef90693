"""The vector environment of Stable-Baselines3, held against its own vector of single environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from pneuma.config import make_env_config
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.single import PneumaEnv
from pneuma.errors import UserError

from .arena import ATTACK, RIGHT

N = 4


def pit_actions(generator: np.random.Generator) -> np.ndarray:
    """Return actions under which about every second player stays in the pit and dies."""
    actions = generator.integers(5, size=N)
    return actions if generator.random() < 0.5 else np.full(N, ATTACK)


def noting(env: PneumaVecEnv) -> PneumaVecEnv:
    """Let an environment note every episode that ends."""
    env.keep_finished = True
    return env


# --- As Stable-Baselines3 does it ----------------------------------------------------------------


def test_it_steps_as_a_dummy_vec_env_of_single_environments(pit: str) -> None:
    config = make_env_config({"level": pit, "episode_steps": 20})
    ours = PneumaVecEnv(range(3, 3 + N), config)
    theirs = DummyVecEnv([lambda: PneumaEnv(level=pit, episode_steps=20) for _ in range(N)])
    theirs.seed(3)
    generator = np.random.default_rng(1)
    first = theirs.reset()
    assert isinstance(first, np.ndarray) and ours.reset().tobytes() == first.tobytes()
    terminated = truncated = 0
    for _ in range(300):
        actions = pit_actions(generator)
        observations, rewards, dones, infos = ours.step(actions)
        expected, their_rewards, their_dones, their_infos = theirs.step(actions)
        for our, their in ((observations, expected), (rewards, their_rewards), (dones, their_dones)):
            assert isinstance(our, np.ndarray) and isinstance(their, np.ndarray)
            assert (our.dtype, our.tobytes()) == (their.dtype, their.tobytes())
        for done, info, their_info in zip(dones, infos, their_infos, strict=True):
            if not done:
                assert info == {}
                continue
            assert np.array_equal(info["terminal_observation"], their_info["terminal_observation"])
            for key in ("TimeLimit.truncated", "ending", "kills", "xp", "hp"):
                assert info[key] == their_info[key], key
            truncated += info["TimeLimit.truncated"]
            terminated += not info["TimeLimit.truncated"]
    assert terminated > 10 and truncated > 10


def test_the_episodes_it_notes_are_those_of_vec_monitor(pit: str) -> None:
    env = noting(PneumaVecEnv(range(N), make_env_config({"level": pit, "episode_steps": 20})))
    monitor = VecMonitor(env)
    monitor.reset()
    generator = np.random.default_rng(2)
    theirs = []
    for step in range(1, 201):
        *_, infos = monitor.step(pit_actions(generator))
        theirs += [
            {"slot": slot, "step": N * step, "r": info["episode"]["r"], "l": info["episode"]["l"]}
            for slot, info in enumerate(infos)
            if "episode" in info
        ]
    ours = [
        {"slot": e["slot"], "step": e["step"], "r": round(e["return"], 4), "l": e["length"]}
        for e in env.finished
    ]
    assert len(ours) > 20
    for our, their in zip(ours, theirs, strict=True):
        assert our.pop("r") == pytest.approx(their.pop("r"), abs=1e-3)  # VecMonitor adds in float32
        assert our == their


# --- Endings -------------------------------------------------------------------------------------


def threatened(env: PneumaVecEnv, world: int, hp: float) -> None:
    """Give a world's player so many HP and put a monster beside it, out of the sword's way."""
    player, monster = env.state.players[world, 0], env.state.monsters[world, 0]
    player["hp"], player["facing"] = hp, RIGHT
    monster["x"], monster["y"] = player["x"] - 30, player["y"]


def test_finished_lists_every_episode_with_what_the_exported_table_needs() -> None:
    env = noting(PneumaVecEnv([0, 1], make_env_config({"episode_steps": 3})))
    env.reset()
    for _ in range(2):
        env.step(np.array([ATTACK, ATTACK]))
    threatened(env, 1, hp=7)
    for _ in range(4):
        env.step(np.array([ATTACK, ATTACK]))
    limit = {"ending": "time-limit", "kills": 0, "xp": 0.0, "hp": 100.0}
    # Steps count over both worlds. Each episode is 3 steps at -1; the last of world 1's first is at 0.
    assert env.finished == [
        {"slot": 0, "episode": 0, "step": 6, "return": -3.0, "length": 3, **limit},
        {"slot": 1, "episode": 0, "step": 6, "return": -2.0, "length": 3,
         "ending": "killed", "kills": 0, "xp": 0.0, "hp": 0.0},
        {"slot": 0, "episode": 1, "step": 12, "return": -3.0, "length": 3, **limit},
        {"slot": 1, "episode": 1, "step": 12, "return": -3.0, "length": 3, **limit},
    ]  # fmt: skip


@pytest.mark.parametrize("actions", [[0.0, np.nan], [3.7, 1.0], [1], [1, 2, 3], 1, [True, False]])
def test_what_is_no_action_for_each_slot_is_refused(actions: Any) -> None:
    env = PneumaVecEnv([0, 1])
    env.reset()
    with pytest.raises(ValueError, match="outside"):
        env.step(np.array(actions))


# --- Seeds, options and attributes ---------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "settings", "told"),
    [
        (([],), {}, "seeds is empty"),
        ((0,), {}, "0 slots are not allowed"),
        ((3,), {"players": 2}, "3 slots are not allowed: a multiple of the 2 players in a world"),
        (([1, 2],), {"seed": 3}, "not both"),
        (([1], make_env_config({})), {"episode_steps": 3}, "not both"),
        ((1,), {"episode_step": 3}, "did you mean episode_steps?"),
    ],
)
def test_worlds_that_cannot_be_made_are_told_in_one_line(
    arguments: tuple[Any, ...], settings: dict[str, Any], told: str
) -> None:
    with pytest.raises(UserError) as caught:
        PneumaVecEnv(*arguments, **settings)
    assert told in str(caught.value) and "\n" not in str(caught.value)
