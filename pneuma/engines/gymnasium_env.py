"""Environments registered with Gymnasium, in parallel slots, with what engines need.

    run → modules imported, environment made, wrapped → GymnasiumSlots → collector, vec_env, evaluation

Observations are flattened to one row of numbers, by Gymnasium's rules. When an episode ends, its slot begins
the next one at once, as in a `SyncVectorEnv` that resets in the same step.

A slot is seeded once, at its first episode. So its state follows from the seed and all actions since, and
these are what a checkpoint contains. Nothing is unpickled, and an environment that draws only from its seed
returns to the same state.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from pneuma.algorithms import VALUE_BASED
from pneuma.config import Run
from pneuma.engines.normalization import Normalization, Scaling
from pneuma.engines.records import episode_row
from pneuma.errors import OwnCodeError, RunWarning, UserError, install_extra
from pneuma.own_modules import load_module

EXTRAS = ("minatar", "minigrid")
"""Extras that install environments, whose ids begin with their names."""


def check_spaces(run: Run) -> None:
    """Make an environment, take a step, and refuse spaces in which the run cannot be trained."""
    with (
        warnings.catch_warnings(action="ignore", category=RunWarning),  # the run itself warns
        closing(GymnasiumSlots(run, [0])) as slots,
    ):
        space = slots.action_space
        if isinstance(space, spaces.Box) and not space.is_bounded():
            raise UserError(f"{run.env}: its actions {space} are unbounded: wrap it to give them bounds")
        if not isinstance(space, spaces.Discrete):
            problem = "an action is several choices"
            if isinstance(space, spaces.Box):
                problem = "its actions are numbers"
            if run.algorithm in VALUE_BASED:
                raise UserError(f"{run.env}: {problem}, which {run.algorithm} cannot handle: try ppo")
            if run.engine != "sb3":
                raise UserError(f'{run.env}: {problem}, which only engine = "sb3" trains')
        slots.step(np.array([slots.any_action()]))


# --- Slots -----------------------------------------------------------------------------------------


class GymnasiumSlots:
    """Environments in parallel; each is reset as soon as its episode ends.

    Attributes:
        observations: (S, features) float32, the current ones.
        seen: the same as the learner sees them, normalised if the run says so.
        terminal: (S, features), the last one of each slot's last finished episode, likewise.
        returns, lengths, episodes: (S,) of the episodes so far.
        steps: number of steps taken in each slot.
        finished: episodes that ended since the list was last emptied.
    """

    def __init__(self, run: Run, seeds: Sequence[int], training: bool = False) -> None:
        self.run = run
        self._normalizes = training and (run.normalize_observations or run.normalize_rewards)
        self.envs = [make_env(run) for _ in seeds]
        space = self.envs[0].observation_space
        self.action_space = _action_space(run, self.envs[0].action_space)
        self._flatten = flattening(run, space)
        flat_space = spaces.flatten_space(space)
        assert isinstance(flat_space, spaces.Box)
        self._flat_space: spaces.Box | None = flat_space  # None once an observation was not of it
        self._declared_type = space.dtype if isinstance(space, spaces.Box) else None
        self.observations = np.zeros((len(seeds), *flat_space.shape), np.float32)
        self.terminal = np.zeros_like(self.observations)
        self.returns = np.zeros(len(seeds))
        self.lengths, self.episodes = np.zeros((2, len(seeds)), np.int64)
        self.finished: list[dict[str, Any]] = []
        self._log_type = _smallest_type(self.action_space)
        self.begin(seeds)

    def begin(self, seeds: Sequence[int]) -> None:
        """Reset all environments with fresh seeds, and forget what was."""
        for array in (self.returns, self.lengths, self.episodes):
            array[:] = 0
        self.steps = 0
        self.finished.clear()
        self._action_log = bytearray()
        self._first_seeds = [seed % 2**31 for seed in seeds]  # all environments take these
        self._next_seeds: list[int | None] = [*self._first_seeds]
        for slot in range(len(self.envs)):
            self._reset(slot)
        self._normalization = Normalization(self.run, self.observations) if self._normalizes else None

    @property
    def seen(self) -> np.ndarray:
        return self._normalization.seen if self._normalization else self.observations

    @property
    def scaling(self) -> Scaling | None:
        """How a policy has to normalise observations now."""
        return self._normalization.scaling if self._normalization else None

    def step(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Apply (S,) or (S, dimensions) actions; return rewards, float64, and ended episodes: (S,) each.

        `terminated` and `truncated` are never both set. Rewards are normalised if the run says so, records
        are not.
        """
        self._action_log += actions.astype(self._log_type).tobytes()
        rewards = np.zeros(len(self.envs))
        terminated, truncated = np.zeros((2, len(self.envs)), np.bool_)
        self.steps += 1
        for slot, action in enumerate(self.actions(actions)):
            reward, is_terminated, is_truncated, _ = self.step_one(slot, action)
            rewards[slot] = reward
            self.returns[slot] += reward
            if is_terminated or is_truncated:
                terminated[slot], truncated[slot] = is_terminated, not is_terminated
                self._end(slot, "terminated" if is_terminated else "truncated")
        if self._normalization:
            ended = terminated | truncated
            rewards = self._normalization.step(self.observations, rewards, ended, self.terminal)
        return rewards, terminated, truncated

    def actions(self, actions: np.ndarray) -> Sequence[Any]:
        """Return a policy's actions as the environments take them."""
        return actions_in(self.action_space, actions)

    def any_action(self) -> Any:
        """Draw an action from the space's own generator; discrete ones count from 0."""
        return self.action_space.sample() - getattr(self.action_space, "start", 0)

    def step_one(self, slot: int, action: Any) -> tuple[float, bool, bool, Mapping[str, Any]]:
        """Step one environment; return its reward, whether it terminated or was truncated, and its info."""
        with blamed(f"{self.run.env} in step {self.lengths[slot] + 1} of episode {self.episodes[slot]}"):
            observation, reward, terminated, truncated, info = self.envs[slot].step(action)
            self._observe(slot, observation)
            reward = float(reward)
            if not math.isfinite(reward):
                raise ValueError(f"its reward is {reward}")
        self.lengths[slot] += 1
        return reward, bool(terminated), bool(truncated), info

    def _observe(self, slot: int, observation: Any) -> None:
        row = np.asarray(self._flatten(observation))
        current = self.observations[slot]
        if row.shape != current.shape:
            raise ValueError(f"its observation is of shape {row.shape}, where its space says {current.shape}")
        current[:] = row
        if not math.isfinite(current.sum()):
            raise ValueError("its observation is not finite")
        if self._flat_space is not None:
            difference = self._difference_from_space(row, self._flat_space)
            if difference:
                self._flat_space = None  # one warning is enough
                text = f"{self.run.env}: an observation is not of its declared space: {difference}"
                warnings.warn(text, RunWarning, stacklevel=2)

    def _difference_from_space(self, row: np.ndarray, space: spaces.Box) -> str:
        if self._declared_type and not np.can_cast(row.dtype, self._declared_type):
            return f"{row.dtype} in place of {self._declared_type}"
        outside = (row < space.low) | (row > space.high)
        if not outside.any():
            return ""
        index = int(outside.argmax())
        low, high = space.low[index], space.high[index]
        return f"number {index} is {row[index]:g}, and not from {low:g} to {high:g}"

    def _end(self, slot: int, ending: str) -> None:
        self.terminal[slot] = self.observations[slot]
        row = episode_row(
            slot=slot,
            episode=self.episodes[slot].item(),
            step=self.steps * len(self.envs),
            returned=self.returns[slot].item(),
            length=self.lengths[slot].item(),
            ending=ending,
        )
        self.finished.append(row)
        self.episodes[slot] += 1
        self.returns[slot], self.lengths[slot] = 0.0, 0
        self._reset(slot)

    def _reset(self, slot: int) -> None:
        seed = self._next_seeds[slot]
        self._next_seeds[slot] = None
        with blamed(f"{self.run.env} when it is reset"):
            observation, _ = self.envs[slot].reset(seed=seed)
            self._observe(slot, observation)

    def close(self) -> None:
        for env in self.envs:
            with blamed(f"{self.run.env} when it is closed"):
                env.close()

    # --- Where it stands ---------------------------------------------------------------------------

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return everything that the next step depends on, and what identifies the state: arrays by name."""
        shape = [self.steps, len(self.envs)]
        if not isinstance(self.action_space, spaces.Discrete):
            shape.append(math.prod(self.action_space.shape))
        actions = np.frombuffer(bytes(self._action_log), self._log_type).reshape(shape)
        state = {"actions": actions, "seeds": np.array(self._first_seeds)}
        for name in ("observations", "returns", "lengths", "episodes"):
            state[name] = getattr(self, name).copy()
        if self._normalization:
            state |= self._normalization.saved_state()
        return state

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        """Play all actions again from the first seeds, in new environments, as wrappers may count resets.

        Raises ValueError if it leads to another state: the randomness does not come from the seed alone.
        """
        self.close()
        self.envs = [make_env(self.run) for _ in self.envs]
        self.begin(saved["seeds"].tolist())
        for actions in saved["actions"]:
            self.step(actions)
        self.finished.clear()
        for name, array in self.saved_state().items():
            if not np.array_equal(array, saved[name]):
                raise ValueError(
                    f"{self.run.env} does not come to the same state by the same seed and actions"
                )


def _smallest_type(space: spaces.Space[Any]) -> np.dtype[Any]:
    """Return the type in which a log of actions is kept."""
    if isinstance(space, spaces.Box):
        return np.dtype(np.float32)
    if isinstance(space, spaces.Discrete) and space.n <= 256:
        return np.dtype(np.uint8)
    return np.dtype(np.int64)


def actions_in(space: spaces.Space[Any], actions: np.ndarray) -> Sequence[Any]:
    """Return a policy's actions, (N,) or (N, dimensions), as an environment's space has them."""
    if isinstance(space, spaces.Discrete):
        first = int(space.start)
        return [first + action for action in actions.tolist()]
    shaped = [np.asarray(action, space.dtype).reshape(space.shape) for action in actions]
    if isinstance(space, spaces.MultiDiscrete):
        return [action + space.start for action in shaped]
    return shaped


def choices_of(space: spaces.Space[Any]) -> np.ndarray:
    """Return among how many each of an action's choices is."""
    if isinstance(space, spaces.MultiDiscrete):
        return np.asarray(space.nvec, np.int64)
    return np.full(space.shape or (), 2)


def _action_space(
    run: Run, space: spaces.Space[Any]
) -> spaces.Discrete | spaces.Box | spaces.MultiDiscrete | spaces.MultiBinary:
    if isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary):
        return space
    if isinstance(space, spaces.Box) and space.dtype is not None and space.dtype.kind == "f":
        return space
    allowed = "Discrete, MultiDiscrete, MultiBinary or Box"
    raise UserError(f"{run.env}: actions in {space} are not supported: wrap it to have {allowed} actions")


def flattening(run: Run, space: spaces.Space[Any]) -> Callable[[Any], Any]:
    """Return a function that makes an observation a row of numbers."""
    for part in _parts(space):
        problem = _not_flat(part)
        if problem:
            fix = "name a wrapper that leaves that out"
            raise UserError(f"{run.env}: observations in {problem} cannot be flattened to numbers: {fix}")
    refuse_flat_pictures(run, space)
    if isinstance(space, spaces.Box):
        if len(space.shape) == 1:
            return lambda observation: observation
        return lambda observation: np.reshape(observation, -1)
    return lambda observation: spaces.flatten(space, observation)


def _parts(space: spaces.Space[Any]) -> list[spaces.Space[Any]]:
    """Return the spaces within a dictionary or tuple, or the space itself."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        subspaces = space.spaces.values() if isinstance(space, spaces.Dict) else space.spaces
        return [part for subspace in subspaces for part in _parts(subspace)]
    return [space]


def _not_flat(space: spaces.Space[Any]) -> str:
    """Return what a space is of, if not of arrays of one size; empty if it can be flattened."""
    if isinstance(space, spaces.Text) or (space.dtype is not None and space.dtype.kind == "U"):
        return "text"
    with suppress(NotImplementedError):  # of a space of another package
        if space.is_np_flattenable:
            return ""
    return type(space).__name__


def refuse_flat_pictures(run: Run, space: spaces.Space[Any]) -> None:
    """Refuse a run whose policy would flatten pictures: a multilayer perceptron, as is the default."""
    if run.policy and not run.policy.startswith("Mlp"):
        return
    dimensions = [len(part.shape or ()) for part in _parts(space) if _is_picture(part)]
    if not dimensions:
        return
    policy = "MultiInputPolicy" if isinstance(space, spaces.Dict) else "CnnPolicy"
    fix = 'wrappers = ["FlattenObservation"]'
    if min(dimensions) == 3:  # a picture without channels is none to Stable-Baselines3
        fix = f'set policy = "{policy}", or {fix}'
    raise UserError(f"{run.env}: its observations are pictures, which MlpPolicy would flatten: {fix}")


def _is_picture(space: spaces.Space[Any]) -> bool:
    """Return whether a space is of pictures, by Stable-Baselines3's rule; of one channel also without it."""
    if not isinstance(space, spaces.Box) or space.dtype != np.uint8 or len(space.shape) not in (2, 3):
        return False
    return bool((space.low == 0).all() and (space.high == 255).all())


# --- Making one ------------------------------------------------------------------------------------


def make_env(run: Run, render_mode: str = "") -> gymnasium.Env[Any, Any]:
    arguments = json.loads(run.env_kwargs or "{}")
    if render_mode:
        arguments["render_mode"] = render_mode
    try:
        if run.env_module:
            _load(run.env_module)
        with blamed(f"env = {run.env}"):
            env = gymnasium.make(run.env, disable_env_checker=True, **arguments)
    except UserError as error:
        raise UserError(f"{error}{_how_to_register(run)}") from None
    for wrapper in run.wrappers:
        name, brace, rest = wrapper.partition("{")
        with blamed(f"wrappers = {wrapper}"):
            env = load_class(name)(env, **json.loads(brace + rest or "{}"))
    return env


def load_class(name: str) -> Any:
    """Return what module:Class names."""
    module, _, class_name = name.rpartition(":")
    return getattr(_load(module), class_name)


def _how_to_register(run: Run) -> str:
    """Return what is to be done for an environment that is not registered; empty if it is."""
    if run.env in gymnasium.registry:
        return ""
    package = "install its package"
    for extra in EXTRAS:
        if run.env.lower().startswith(extra):
            package = install_extra(extra)
    return f"; {package}, or name the module that registers it as env_module"


@contextmanager
def blamed(source: str) -> Iterator[None]:
    """Turn any exception of a user's own code into a one-line error that names its source, and its cause."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        text = type(error).__name__
        if str(error).strip():
            text += f": {str(error).strip().splitlines()[0]}"
        raise OwnCodeError(f"{source}: {text}") from error


def _load(name: str) -> Any:
    with blamed(f"module {name} cannot be imported"):
        return load_module(name)
