"""Conformance: does an environment keep the promises of the libraries it meets?

Runs the checkers of Gymnasium, Stable-Baselines3 and PettingZoo, and Pneuma's own: same seed same
bits over whole episodes, faces that agree, observations inside their space, states that can be put
back. Meant for levels, character files and rewards of a user's own as well.
"""

from __future__ import annotations

import contextlib
import io
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from pneuma.config import ENVIRONMENTS, make_env_config
from pneuma.env import MAILMAN, MO_ENVIRONMENTS
from pneuma.env.single import PneumaMOEnv
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

STEPS = 400


@dataclass(frozen=True)
class Verdict:
    """What one check of one environment found; an empty `problem` is a pass."""

    env: str
    check: str
    problem: str = ""


def check_environment(env_id: str, settings: Mapping[str, object]) -> Iterator[Verdict]:
    """Run every check that applies to an environment, and yield a verdict for each.

    Raises:
        UserError: when the environment cannot be made at all.
    """
    _make(env_id, settings).close()
    yield _verdict(env_id, "Gymnasium", lambda: _check_gymnasium(env_id, settings))
    yield _verdict(env_id, "same seed, same bits", lambda: _check_seeds(env_id, settings))
    if env_id == MAILMAN:
        return
    world_id = ENVIRONMENTS[MO_ENVIRONMENTS.index(env_id)] if env_id in MO_ENVIRONMENTS else env_id
    yield _verdict(env_id, "observations inside", lambda: _check_bounds(world_id, settings))
    yield _verdict(env_id, "saved and put back", lambda: _check_restore(world_id, settings))
    if env_id in MO_ENVIRONMENTS:
        return
    yield _verdict(env_id, "single = vector", lambda: _check_vector(env_id, settings))
    yield _verdict(env_id, "Stable-Baselines3", lambda: _check_sb3(env_id, settings))
    yield _verdict(env_id, "PettingZoo", lambda: _check_pettingzoo(env_id, settings))


def _verdict(env_id: str, name: str, check: Callable[[], None]) -> Verdict:
    """Run a check; whatever it raises, a warning among it, is its problem."""
    os.environ.setdefault("XDG_RUNTIME_DIR", "/tmp")  # PettingZoo's tests import pygame
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("error")
        try:
            check()
        except (Exception, Warning) as problem:
            return Verdict(env_id, name, " ".join(str(problem).split()) or type(problem).__name__)
    return Verdict(env_id, name)


def _check_gymnasium(env_id: str, settings: Mapping[str, object]) -> None:
    from gymnasium.utils.env_checker import check_env

    env = _make(env_id, settings)
    if isinstance(env, PneumaMOEnv):
        _check_vector_reward(env)
        env._reward = lambda: 0.0  # type: ignore[method-assign]  # Gymnasium's checker knows no vectors
    check_env(env, skip_render_check=env_id == MAILMAN)


def _make(env_id: str, settings: Mapping[str, object]) -> Any:
    """Make an environment without Gymnasium's wrappers."""
    return gymnasium.make(env_id, disable_env_checker=True, **dict(settings)).unwrapped  # type: ignore[arg-type]


def _check_vector_reward(env: PneumaMOEnv) -> None:
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(STEPS):
        _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        if not env.reward_space.contains(reward):
            raise UserError(f"the vector reward {reward} is outside {env.reward_space}")
        if terminated or truncated:
            env.reset()


def _play(env_id: str, settings: Mapping[str, object], seed: int) -> list[Any]:
    """Return everything that a random player sees in some episodes from a seed."""
    env = _make(env_id, settings)
    actions = np.random.default_rng(seed)
    seen: list[Any] = [env.reset(seed=seed)[0]]
    for _ in range(STEPS):
        observation, reward, terminated, truncated, _ = env.step(actions.integers(env.action_space.n))
        seen += [observation, np.asarray(reward), terminated, truncated]
        if terminated or truncated:
            seen.append(env.reset()[0])
    env.close()
    return seen


def _check_seeds(env_id: str, settings: Mapping[str, object]) -> None:
    first, again = _play(env_id, settings, 1), _play(env_id, settings, 1)
    if len(first) != len(again) or not all(np.array_equal(a, b) for a, b in zip(first, again, strict=True)):
        raise UserError("two plays of one seed differ")


def _check_bounds(env_id: str, settings: Mapping[str, object]) -> None:
    worlds = Worlds(8, make_env_config(settings, env_id))
    worlds.seed(range(8))
    worlds.reset()
    actions = np.random.default_rng(0)
    for _ in range(STEPS):
        worlds.step(actions.integers(int(worlds.action_space.n), size=worlds.players.shape))
        for world, player in np.ndindex(*worlds.players.shape):
            if not worlds.spaces[player].contains(worlds.observations[world, player]):
                raise UserError(f"an observation is outside its space: {worlds.observations[world, player]}")
        worlds.reset(worlds.worlds["ending"] != 0)


def _check_restore(env_id: str, settings: Mapping[str, object]) -> None:
    worlds = Worlds(2, make_env_config(settings, env_id))
    worlds.seed([3, 4])
    worlds.reset()
    actions = np.random.default_rng(0).integers(5, size=(2, 60, *worlds.players.shape[1:]))
    for step in range(60):
        worlds.step(np.stack([actions[0, step], actions[0, step]]))
    worlds.restore(1, worlds.save(0))
    for step in range(60):
        worlds.step(np.stack([actions[1, step], actions[1, step]]))
    if worlds.observations[0].tobytes() != worlds.observations[1].tobytes():
        raise UserError("a world that was put back went another way")


def _check_vector(env_id: str, settings: Mapping[str, object]) -> None:
    from gymnasium.vector import AutoresetMode

    from pneuma.env.vector import PneumaVectorEnv

    vector = PneumaVectorEnv(2, env_id, AutoresetMode.DISABLED, **dict(settings))  # type: ignore[arg-type]
    singles = [_make(env_id, settings) for _ in range(2)]
    start, _ = vector.reset(seed=5)
    seen = [env.reset(seed=5 + i)[0] for i, env in enumerate(singles)]
    if not np.array_equal(start, np.stack(seen)):
        raise UserError("the first observations differ")
    actions = np.random.default_rng(0)
    for _ in range(60):
        chosen = actions.integers(5, size=2)
        batch = vector.step(chosen)
        alone = [env.step(action) for env, action in zip(singles, chosen, strict=True)]
        if not np.array_equal(batch[0], np.stack([step[0] for step in alone])):
            raise UserError("observations differ")
        if not np.array_equal(batch[1], np.array([step[1] for step in alone])):
            raise UserError("rewards differ")
        if (batch[2] | batch[3]).any():
            return


def _check_sb3(env_id: str, settings: Mapping[str, object]) -> None:
    from stable_baselines3.common.env_checker import check_env

    from pneuma.env.sb3 import PneumaVecEnv

    check_env(_make(env_id, settings), warn=env_id != "pneuma/PneumaGodot-v0")
    envs = PneumaVecEnv([1, 2], make_env_config({"episode_steps": 5, **settings}, env_id))
    envs.reset()
    for _ in range(5):
        _, _, dones, infos = envs.step(np.zeros(2, np.int64))
    if not all("terminal_observation" in info for done, info in zip(dones, infos, strict=True) if done):
        raise UserError("an ended world has no terminal observation")


def _check_pettingzoo(env_id: str, settings: Mapping[str, object]) -> None:
    from pneuma.env.parallel import parallel_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test
    parallel_api_test(parallel_env(**{"env_id": env_id, "players": 3, **settings}), num_cycles=STEPS)
    plays = []
    for _ in range(2):
        env = parallel_env(**{"env_id": env_id, "players": 3, **settings})
        generator = np.random.default_rng(0)
        seen: list[Any] = [env.reset(seed=9)[0]]
        while env.agents:
            actions = {agent: np.int64(generator.integers(5)) for agent in env.agents}
            seen.append(env.step(actions)[:4])
        plays.append(repr(seen))
    if plays[0] != plays[1]:
        raise UserError("two plays of one seed differ")
