"""Conformance: does an environment keep the promises of the libraries it meets?

Runs the checkers of Gymnasium, Stable-Baselines3 and PettingZoo, and Pneuma's own: same seed same
bits over whole episodes, observations inside their space, and what `agreement.py` has on faces that
agree and states that can be put back. Meant for levels, character files and rewards of a user's own
as well.
"""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np

from pneuma.algorithms import MAILMAN
from pneuma.config import ENVIRONMENTS, make_env_config
from pneuma.env import MO_ENVIRONMENTS
from pneuma.env.agreement import check_faces, check_restore
from pneuma.env.blame import blame_reward
from pneuma.env.single import PneumaMOEnv, refuse_reward
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, unknown_name

STEPS = 400
MOST_STEPS = 20_000
"""Of the plays that should hold two whole episodes."""

MAILMAN_SETTINGS = ("slip", "noise")

UNSEEN = {"SDL_VIDEODRIVER": "dummy", "SDL_AUDIODRIVER": "dummy", "XDG_RUNTIME_DIR": tempfile.gettempdir()}
"""Checkers ask for every render mode, and import pygame: without a window, a sound card or a complaint."""

Settings = Mapping[str, object]


@dataclass(frozen=True)
class Verdict:
    """What one check of one environment found; an empty `problem` is a pass."""

    env: str
    check: str
    problem: str = ""


def check_environment(env_id: str, settings: Settings) -> Iterator[Verdict]:
    """Run every check that applies to an environment, and yield a verdict for each.

    Worlds of several players have no single environment: the faces for several are checked.

    Raises:
        UserError: when the environment cannot be made at all.
    """
    rewards, players = _check_settings(env_id, settings)
    for name, check in _checks(env_id, players):
        yield _verdict(env_id, name, partial(check, env_id, settings), rewards)


def _check_settings(env_id: str, settings: Settings) -> tuple[tuple[str, ...], int]:
    """Make the environment once; return its rewards' names and its number of players."""
    if env_id == MAILMAN:
        for key, value in settings.items():
            if key not in MAILMAN_SETTINGS:
                raise unknown_name(f"key of {MAILMAN}", key, MAILMAN_SETTINGS)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise UserError(f"{key} = {value!r} is not allowed: a number")
        _make(env_id, settings).close()
        return (), 1
    config = make_env_config(settings, _world_id(env_id))
    if env_id in MO_ENVIRONMENTS:
        refuse_reward({**settings})
        if config.players > 1:
            raise UserError(f"players = {config.players} is not allowed: {env_id} has one player")
    try:
        Worlds(1, config)
    except UserError as error:
        raise blame_reward(error, config.reward) or error from None
    return config.reward, config.players


def _checks(env_id: str, players: int) -> Iterator[tuple[str, Callable[[str, Settings], None]]]:
    """Yield name and function of every check that applies."""
    if players == 1:
        yield "Gymnasium", _check_gymnasium
        yield "same seed, same bits", _check_seeds
    if env_id == MAILMAN:
        return
    yield "observations inside", _check_bounds
    yield "saved and put back", lambda name, settings: check_restore(_world_id(name), settings)
    if env_id in MO_ENVIRONMENTS:
        return
    yield "faces agree", check_faces
    if players == 1:
        yield "Stable-Baselines3", _check_sb3
    yield "PettingZoo", _check_pettingzoo


def _world_id(env_id: str) -> str:
    """Return the environment that has the same world, with a reward that is one number."""
    return ENVIRONMENTS[MO_ENVIRONMENTS.index(env_id)] if env_id in MO_ENVIRONMENTS else env_id


def _verdict(env_id: str, name: str, check: Callable[[], None], rewards: tuple[str, ...]) -> Verdict:
    """Run a check; whatever it raises, a warning among it, is its problem."""
    with _unseen(), warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("error")
        try:
            check()
        except Exception as error:
            problem = blame_reward(error, rewards) or error
            return Verdict(env_id, name, " ".join(str(problem).split()) or type(problem).__name__)
    return Verdict(env_id, name)


@contextlib.contextmanager
def _unseen() -> Iterator[None]:
    """Let nothing appear on the screen, unless the user has said where."""
    before = {name: os.environ.get(name) for name in UNSEEN}
    os.environ.update({name: value for name, value in UNSEEN.items() if before[name] is None})
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]


def _make(env_id: str, settings: Settings) -> Any:
    """Make an environment without Gymnasium's wrappers."""
    return gymnasium.make(env_id, disable_env_checker=True, **dict(settings)).unwrapped  # type: ignore[arg-type]


def _check_gymnasium(env_id: str, settings: Settings) -> None:
    from gymnasium.utils.env_checker import check_env

    env = _make(env_id, settings)
    if isinstance(env, PneumaMOEnv):
        _check_vector_reward(env)
        env._reward = lambda: 0.0  # type: ignore[method-assign]  # Gymnasium's checker knows no vectors
    if find_spec("pygame") is None and env_id != MAILMAN:  # its checker opens a window, which is an extra
        env.metadata = {**env.metadata, "render_modes": ["rgb_array"]}
    check_env(env, skip_render_check=env_id == MAILMAN)


def _check_vector_reward(env: PneumaMOEnv) -> None:
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(STEPS):
        _, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        if not env.reward_space.contains(reward):
            raise UserError(f"the vector reward {reward} is outside {env.reward_space}")
        if terminated or truncated:
            env.reset()


def _check_seeds(env_id: str, settings: Settings) -> None:
    first, again = _play(env_id, settings, 1), _play(env_id, settings, 1)
    if len(first) != len(again) or not all(np.array_equal(a, b) for a, b in zip(first, again, strict=True)):
        raise UserError("two plays of one seed differ")


def _play(env_id: str, settings: Settings, seed: int) -> list[Any]:
    """Return everything that a random player sees in two episodes from a seed."""
    env = _make(env_id, settings)
    actions = np.random.default_rng(seed).integers(env.action_space.n, size=MOST_STEPS)
    seen: list[Any] = [env.reset(seed=seed)[0]]
    episodes = 0
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        seen += [observation, np.asarray(reward), terminated, truncated]
        if terminated or truncated:
            episodes += 1
            if episodes == 2:
                break
            seen.append(env.reset()[0])
    env.close()
    return seen


def _check_bounds(env_id: str, settings: Settings) -> None:
    worlds = Worlds(8, make_env_config(settings, _world_id(env_id)))
    worlds.seed(range(8))
    worlds.reset()
    actions = np.random.default_rng(0)
    for _ in range(STEPS):
        worlds.step(actions.integers(int(worlds.action_space.n), size=worlds.players.shape))
        for world, player in np.ndindex(*worlds.players.shape):
            if not worlds.spaces[player].contains(worlds.observations[world, player]):
                raise UserError(f"an observation is outside its space: {worlds.observations[world, player]}")
        worlds.reset(worlds.worlds["ending"] != 0)


def _check_sb3(env_id: str, settings: Settings) -> None:
    from stable_baselines3.common.env_checker import check_env

    check_env(_make(env_id, settings))


def _check_pettingzoo(env_id: str, settings: Settings) -> None:
    from pneuma.env.parallel import parallel_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test
    several = {"players": 3, **settings}
    parallel_api_test(parallel_env(env_id=env_id, **several), num_cycles=STEPS)
    plays = []
    for _ in range(2):
        env = parallel_env(env_id=env_id, **several)
        generator = np.random.default_rng(0)
        seen: list[Any] = [_flat(env.reset(seed=9)[0])]
        for _ in range(MOST_STEPS):
            if not env.agents:
                break
            count = int(env.action_space(env.agents[0]).n)
            told = env.step({agent: generator.integers(count) for agent in env.agents})
            seen += [_flat(each) for each in told[:4]]
        plays.append(seen)
    if plays[0] != plays[1]:
        raise UserError("two plays of one seed differ")


def _flat(told: Mapping[str, object]) -> dict[str, bytes]:
    """Return what each player was told, bit by bit."""
    return {agent: np.asarray(value).tobytes() for agent, value in told.items()}
