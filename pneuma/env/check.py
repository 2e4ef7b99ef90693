"""Conformance: does an environment keep the promises of the libraries it meets?

Runs the checkers of Gymnasium, Stable-Baselines3 and PettingZoo, and Pneuma's own: same seed same bits,
observations inside their space, faces that agree, worlds that go on when put back. Meant for levels,
character files and rewards of a user's own as well.

To compare the faces each plays the same actions in the same worlds, over several short episodes. What it
says is brought into one form, a list of entries a world, each what the players who were playing saw and
got, their last observations among it, or what they saw after a reset. The lists must be equal.
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
from gymnasium.vector import AutoresetMode

from pneuma.algorithms import MAILMAN
from pneuma.config import EnvConfig, make_env_config
from pneuma.env import MO_ENVIRONMENTS, REGISTERED
from pneuma.env.blame import blame_reward
from pneuma.env.parallel import PneumaParallelEnv, parallel_env
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.single import PneumaEnv, PneumaMOEnv, refuse_reward
from pneuma.env.vector import PneumaVectorEnv
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, unknown_name

STEPS = 400
SEED = 5
WORLDS = 3
STORY_STEPS = 150
EPISODE_STEPS = 20
"""At most, in stories; so that endings and resets are met often."""
MAILMAN_SETTINGS = ("slip", "noise")

UNSEEN = {"SDL_VIDEODRIVER": "dummy", "SDL_AUDIODRIVER": "dummy", "XDG_RUNTIME_DIR": tempfile.gettempdir()}
"""Checkers ask for every render mode, and import pygame: without a window, a sound card or a complaint."""

Settings = Mapping[str, object]
Step = Callable[[np.ndarray], tuple[np.ndarray, ...]]
"""Plays actions of all slots: what they see, what those saw last that ended, rewards, endings, cuts."""
Entry = dict[int, tuple[Any, ...]]
"""What one step, or a reset, told each player who was playing."""


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
    if env_id not in REGISTERED:
        raise unknown_name("environment", env_id, REGISTERED)
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
    return env_id.replace("/mo-", "/")


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
    first, again = (_play(_make(env_id, settings)) for _ in range(2))
    if first != again:
        raise UserError("two plays of one seed differ")


def _play(env: Any) -> list[bytes]:
    """Return everything that a random player sees in some steps from a seed."""
    seen: list[bytes] = [np.asarray(env.reset(seed=1)[0]).tobytes()]
    for action in np.random.default_rng(1).integers(env.action_space.n, size=STEPS):
        *told, _ = env.step(action)
        seen += [np.asarray(each).tobytes() for each in told]
        if told[2] or told[3]:
            seen.append(np.asarray(env.reset()[0]).tobytes())
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test
    several = {"players": 3, **settings}
    parallel_api_test(parallel_env(env_id=env_id, **several), num_cycles=STEPS)
    config = make_env_config(several, env_id)
    first, again = (list(_parallel(env_id, several, config, 0)) for _ in range(2))
    _compare("two plays of one seed", [first], [again])


# --- Worlds that are put back --------------------------------------------------------------------


def check_restore(env_id: str, settings: Settings) -> None:
    """Put a world back in another slot and another object, and compare how each goes on, bit by bit."""
    config = make_env_config(settings, _world_id(env_id))
    worlds = Worlds(2, config)
    worlds.seed([SEED, SEED + 1])
    worlds.reset()
    before, after = _actions(0, config)[:120].reshape(2, 60, -1)
    _step_all(worlds, before)
    saved = worlds.save(0)
    worlds.restore(1, saved)
    _step_all(worlds, after)
    expected = _bits(worlds, 0)
    other = Worlds(1, config)
    other.restore(0, saved)
    _step_all(other, after)
    for where, bits in (("slot", _bits(worlds, 1)), ("object", _bits(other, 0))):
        if bits != expected:
            raise UserError(f"a world that was put back into another {where} went another way")


def _step_all(worlds: Worlds, actions: np.ndarray) -> None:
    """Play actions (steps, players), the same in every world, into new episodes where they end."""
    for chosen in actions:
        worlds.step(np.stack([chosen] * len(worlds)))
        worlds.reset(worlds.worlds["ending"] != 0)


def _bits(worlds: Worlds, world: int) -> list[bytes]:
    """Return every bit of one world's state and of what its last step told."""
    state = (worlds.worlds, worlds.players, worlds.monsters, worlds.events)
    fields = [array[world][name] for array in state for name in array.dtype.names or ()]
    return [np.ascontiguousarray(each).tobytes() for each in (*fields, worlds.observations[world])]


# --- Faces that agree ----------------------------------------------------------------------------


def check_faces(env_id: str, settings: Settings) -> None:
    """Compare every face with PettingZoo's, world by world.

    Raises:
        UserError: naming the face, the world and the step that differ.
    """
    config = make_env_config(settings, env_id)
    settings = {**settings, "episode_steps": min(config.episode_steps, EPISODE_STEPS)}
    worlds = range(WORLDS)
    told = [list(_parallel(env_id, settings, config, world)) for world in worlds]
    if config.players == 1:
        _compare("the single face", [list(_single(env_id, settings, world)) for world in worlds], told)
    _compare("the vector face", _vector(env_id, settings, config), told)
    _compare("the Stable-Baselines3 face", _learner(env_id, settings, config), told)


def _actions(world: int, config: EnvConfig) -> np.ndarray:
    """Return what the players of a world do in its first steps, (steps, players)."""
    count = 7 if config.magic else 5
    return np.random.default_rng(world).integers(count, size=(STORY_STEPS, config.players))


def _compare(face: str, told: list[list[Entry]], expected: list[list[Entry]]) -> None:
    """Raise an error at the first entry of a world's story that is not as expected."""
    for world, (story, other) in enumerate(zip(told, expected, strict=True)):
        if len(story) < len(other) // 2:
            raise UserError(f"{face}: world {world} got stuck after {len(story)} steps")
        for step, (entry, right) in enumerate(zip(story, other, strict=False)):
            what = _difference(entry, right)
            if what:
                raise UserError(f"{face}: world {world}, step {step}: {what} differ")


def _difference(entry: Entry, right: Entry) -> str:
    """Name what differs between two entries, if anything does."""
    if entry.keys() != right.keys():
        return "the players in play"
    for player, own in entry.items():
        if len(own) != len(right[player]):
            return "endings and resets"
        for what, one, other in zip(("observations", "rewards", "endings"), own, right[player], strict=False):
            if not np.array_equal(np.asarray(one), np.asarray(other)):
                return what
    return ""


# --- The story that each face tells --------------------------------------------------------------


def _single(env_id: str, settings: Settings, world: int) -> Iterator[Entry]:
    """Yield the story of one world as the single face tells it."""
    env = PneumaEnv(env_id, None, "map", **settings)
    yield {0: (env.reset(seed=SEED + world)[0],)}
    for action in _actions(world, env.state.config)[:, 0]:
        observation, reward, terminated, truncated, _ = env.step(action)
        yield {0: (observation, np.float32(reward), (terminated, truncated))}
        if terminated or truncated:
            yield {0: (env.reset()[0],)}


def _parallel(env_id: str, settings: Settings, config: EnvConfig, world: int) -> Iterator[Entry]:
    """Yield the story of one world as PettingZoo's face tells it."""
    env = PneumaParallelEnv(env_id, **{**settings, "players": config.players})  # type: ignore[arg-type]
    seen = env.reset(seed=SEED + world)[0]
    names = env.possible_agents
    yield {i: (seen[name],) for i, name in enumerate(names)}
    for actions in _actions(world, config):
        acting = list(env.agents)
        chosen = {name: actions[names.index(name)] for name in acting}
        seen, rewards, terminated, truncated, _ = env.step(chosen)
        yield {
            names.index(name): (seen[name], np.float32(rewards[name]), (terminated[name], truncated[name]))
            for name in acting
        }
        if not env.agents:
            seen = env.reset()[0]
            yield {i: (seen[name],) for i, name in enumerate(names)}


def _slots(config: EnvConfig, first: np.ndarray, step: Step) -> list[list[Entry]]:
    """Bring what a face tells of all slots, which begin again at once, into stories of worlds."""
    players = config.players
    slots = [range(world * players, (world + 1) * players) for world in range(WORLDS)]
    stories: list[list[Entry]] = [[{i: (first[slot],) for i, slot in enumerate(own)}] for own in slots]
    actions = np.concatenate([_actions(world, config) for world in range(WORLDS)], axis=1)
    playing = np.ones(len(first), bool)
    for chosen in actions:
        seen, last, rewards, ended, cut = step(chosen)
        for story, own in zip(stories, slots, strict=True):
            entry: Entry = {}
            for i, slot in enumerate(own):
                if playing[slot]:
                    endings = bool(ended[slot]), bool(cut[slot])
                    entry[i] = last[slot], np.float32(rewards[slot]), endings
                    playing[slot] = not any(endings)
            story.append(entry)
            if not playing[own].any():
                playing[own] = True
                story.append({i: (seen[slot],) for i, slot in enumerate(own)})
    return stories


def _vector(env_id: str, settings: Settings, config: EnvConfig) -> list[list[Entry]]:
    """Return the stories of all worlds as the vector face tells them."""
    mode = AutoresetMode.SAME_STEP
    env = PneumaVectorEnv(WORLDS * config.players, env_id, mode, **settings)  # type: ignore[arg-type]

    def step(actions: np.ndarray) -> tuple[np.ndarray, ...]:
        seen, rewards, ended, cut, infos = env.step(actions)
        last = seen.copy()
        for slot in np.flatnonzero(ended | cut):
            last[slot] = infos["final_obs"][slot]
        return seen, last, rewards, ended, cut

    return _slots(config, env.reset(seed=SEED)[0], step)


def _learner(env_id: str, settings: Settings, config: EnvConfig) -> list[list[Entry]]:
    """Return the stories of all worlds as the face of Stable-Baselines3 tells them."""
    env = PneumaVecEnv(range(SEED, SEED + WORLDS), make_env_config(settings, env_id))

    def step(actions: np.ndarray) -> tuple[np.ndarray, ...]:
        seen, rewards, dones, infos = env.step(actions)
        last = np.array(seen)
        for slot in np.flatnonzero(dones):
            if "terminal_observation" not in infos[slot]:
                raise UserError("the Stable-Baselines3 face: an ended slot has no terminal observation")
            last[slot] = infos[slot]["terminal_observation"]
        cut = np.array([bool(info.get("TimeLimit.truncated")) for info in infos])
        return np.array(seen), last, rewards, dones & ~cut, cut

    return _slots(config, np.array(env.reset()), step)
