"""Environments registered with Gymnasium, in parallel slots, with what engines need.

    run → make_env → GymnasiumSlots → collector, vector environment, evaluation

Observations are flattened to one row of numbers, by Gymnasium's rules. When an episode ends, its slot begins
the next one at once, as in a `SyncVectorEnv` that resets in the same step.

A slot is seeded once, at its first episode. So its state follows from the seed and all actions since, and a
checkpoint contains these. An environment whose random numbers come from its seed alone returns to the same
state.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from importlib import import_module
from importlib.util import find_spec
from typing import Any, Protocol, TypeVar

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import DeprecatedEnv, VersionNotFound

from pneuma.algorithms import VALUE_BASED, is_masked
from pneuma.config import Run
from pneuma.engines.normalization import Normalization, Scaling
from pneuma.engines.records import episode_row
from pneuma.errors import OwnCodeError, RunWarning, UserError, install_command
from pneuma.own_modules import load_module

EXTRAS = ("minatar", "minigrid")
"""Extras that install environments, whose ids begin with their names."""
MINATAR = "MinAtar/"
FLAT_SPACES = (spaces.Box, spaces.Discrete, spaces.MultiBinary, spaces.MultiDiscrete)
"""Spaces of observations that can be made rows of numbers."""


def check_spaces(run: Run) -> None:
    """Make an environment, take a step, and refuse spaces in which the run cannot be trained."""
    with closing(GymnasiumSlots(run, [0])) as slots:
        problem = _action_problem(run, slots.action_space)
        if problem and run.algorithm in VALUE_BASED:
            raise UserError(f"{run.env}: {problem}, which {run.algorithm} cannot handle: try ppo")
        if problem and run.engine != "sb3":
            raise UserError(f'{run.env}: {problem}, which only engine = "sb3" trains')
        slots.step(np.array([slots.random_action()]))
        check_others(run)


def check_others(run: Run) -> None:
    """Open an environment a slot beside another one, as a run does, and refuse one that allows fewer."""
    with ExitStack() as opened:
        try:
            for _ in range(run.slots):
                env = opened.enter_context(closed_after(run, make_env(run)))
                with errors_from(f"{run.env} when it is reset"):
                    env.reset(seed=1)
        except UserError as error:
            reason = f"a run opens at least {run.slots + 1} at once, in slots and for evaluations"
            raise UserError(f"another environment beside the first fails ({reason}): {error}") from None


def _action_problem(run: Run, space: spaces.Space[Any]) -> str:
    """Return what some learners cannot handle in an action space; refuse one that none of them handles."""
    if isinstance(space, spaces.Discrete):
        return ""
    if isinstance(space, spaces.MultiDiscrete | spaces.MultiBinary):
        return "an action is several choices"
    if not isinstance(space, spaces.Box) or not np.issubdtype(space.dtype, np.floating):
        remedy = "wrap it to have Discrete, MultiDiscrete, MultiBinary or Box actions"
        raise UserError(f"{run.env}: actions in {space} are not supported: {remedy}")
    if not space.is_bounded():
        raise UserError(f"{run.env}: its actions {space} are unbounded: wrap it to give them bounds")
    return "its actions are numbers"


# --- Slots -----------------------------------------------------------------------------------------


class GymnasiumSlots:
    """Environments in parallel, as `LearnerSlots`; each is reset as soon as its episode ends.

    Attributes:
        raw_observations: (S, features) float32, the current ones.
        terminal: (S, features), the last observation of each slot's last finished episode, as the learner
            sees it.
        returns, lengths: (S,) of the current episodes.
        episodes: (S,), the number of finished ones.
        steps: number of steps taken in each slot.
        finished: episodes that ended since the list was last emptied.
    """

    rewards: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray

    def __init__(self, run: Run, seeds: Sequence[int], training: bool = False) -> None:
        self.run = run
        self.envs = [make_env(run) for _ in seeds]
        self._space = self.envs[0].observation_space
        self.action_space: Any = self.envs[0].action_space
        self._flatten = flattening(run, self._space)
        self._may_warn = training  # once, and not in evaluations, too
        self.raw_observations = np.zeros((len(seeds), spaces.flatdim(self._space)), np.float32)
        self.terminal = np.zeros_like(self.raw_observations)
        self.returns = np.zeros(len(seeds))
        self.lengths, self.episodes = np.zeros((2, len(seeds)), np.int64)
        self.steps = 0
        self._begin_step()
        self.finished: list[dict[str, Any]] = []
        self._log_type = np.float32 if isinstance(self.action_space, spaces.Box) else np.int32
        self._action_log = bytearray()
        self._seeds = [seed % 2**31 for seed in seeds]  # the range that all environments accept
        for slot, seed in enumerate(self._seeds):
            self._reset(slot, seed)
        self._training = training
        self._normalization: Normalization | None = None
        if training and (run.normalize_observations or run.normalize_rewards):
            self._normalization = Normalization(run, self.raw_observations)

    @property
    def observations(self) -> np.ndarray:
        """The current observations as the learner sees them: normalised if the run asks for it."""
        return self._normalization.seen if self._normalization else self.raw_observations

    @property
    def begins(self) -> np.ndarray:
        """Whether each slot's next step begins an episode, (S,)."""
        return self.lengths == 0

    @property
    def scaling(self) -> Scaling | None:
        """How a policy has to normalise observations now."""
        return self._normalization.scaling if self._normalization else None

    def step(self, actions: np.ndarray) -> np.ndarray:
        """Apply (S,) or (S, dimensions) actions; return which episodes ended, (S,).

        `rewards` are normalised if the run asks for it, but not in `finished`.
        """
        self._actions_shape = actions.shape
        self._action_log += actions.astype(self._log_type).tobytes()
        self._begin_step()
        self.steps += 1
        for slot, action in enumerate(actions_in_space(self.action_space, actions)):
            reward, is_terminated, is_truncated, _ = self.step_one(slot, action)
            self.rewards[slot] = reward
            self.returns[slot] += reward
            if is_terminated or is_truncated:
                self.terminated[slot], self.truncated[slot] = is_terminated, not is_terminated
                self._end(slot, "terminated" if is_terminated else "truncated")
        ended = self.terminated | self.truncated
        if self._normalization:
            observations, rewards = self.raw_observations, self.rewards
            self.rewards = self._normalization.step(observations, rewards, ended, self.terminal)
        return ended

    def _begin_step(self) -> None:
        self.rewards = np.zeros(len(self.envs))
        self.terminated, self.truncated = np.zeros((2, len(self.envs)), np.bool_)

    def random_action(self, slot: int = 0) -> Any:
        """Sample an action by the space's own generator; discrete ones count from 0."""
        mask: Any = None
        with errors_from(f"{self.run.env} in its action masks"):
            if is_masked(self.run.algorithm):
                allowed = np.ravel(self.envs[slot].get_wrapper_attr("action_masks")()).astype(np.bool_)
                mask = _mask_of_space(self.action_space, allowed.astype(np.int8))
            return self.action_space.sample(mask) - getattr(self.action_space, "start", 0)

    def step_one(self, slot: int, action: Any) -> tuple[float, bool, bool, Mapping[str, Any]]:
        """Step one environment; return its reward, whether it terminated or was truncated, and its info."""
        with errors_from(f"{self.run.env} in step {self.lengths[slot] + 1} of episode {self.episodes[slot]}"):
            observation, reward, terminated, truncated, info = self.envs[slot].step(action)
            self._observe(slot, observation)
            reward = float(reward)
            if not math.isfinite(reward):
                raise ValueError(f"its reward is {reward}")
            if terminated not in (False, True) or truncated not in (False, True):
                raise ValueError(f"not True or False: terminated = {terminated!r}, truncated = {truncated!r}")
        self.lengths[slot] += 1
        return reward, bool(terminated), bool(truncated), info

    def _observe(self, slot: int, observation: Any) -> None:
        flat_observation = np.asarray(self._flatten(observation))
        row = self.raw_observations[slot]
        if flat_observation.shape != row.shape:
            raise ValueError(f"its observation has shape {flat_observation.shape}, its space {row.shape}")
        row[:] = flat_observation
        if not math.isfinite(row.sum()):
            raise ValueError("its observation is not finite")
        difference = self._may_warn and _difference_from_space(flat_observation, self._space)
        if difference:
            self._may_warn = False
            message = f"{self.run.env}: an observation is not of its declared space: {difference}"
            warnings.warn(message, RunWarning, stacklevel=2)

    def _end(self, slot: int, ending: str) -> None:
        self.terminal[slot] = self.raw_observations[slot]
        finished_row = episode_row(
            slot=slot,
            episode=self.episodes[slot].item(),
            step=self.steps * len(self.envs),
            returned=self.returns[slot].item(),
            length=self.lengths[slot].item(),
            ending=ending,
        )
        self.finished.append(finished_row)
        self.episodes[slot] += 1
        self.returns[slot], self.lengths[slot] = 0.0, 0
        self._reset(slot)

    def _reset(self, slot: int, seed: int | None = None) -> None:
        with errors_from(f"{self.run.env} when it is reset"):
            observation, _ = self.envs[slot].reset(seed=seed)
            self._observe(slot, observation)

    def close(self) -> None:
        for env in self.envs:
            with errors_from(f"{self.run.env} when it is closed"):
                env.close()

    # --- Where it stands ---------------------------------------------------------------------------

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return all seeds and actions so far, and arrays that identify the state to which they lead."""
        actions = np.frombuffer(bytes(self._action_log), self._log_type)
        saved = {"actions": actions.reshape(self.steps, *self._actions_shape), "seeds": np.array(self._seeds)}
        for attribute in ("raw_observations", "returns", "lengths", "episodes"):
            saved[attribute] = getattr(self, attribute).copy()
        if self._normalization:
            saved |= self._normalization.saved_state()
        return saved

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        """Play all actions again from the first seeds, in new environments, as wrappers may count resets.

        Raises:
            ValueError: if it leads to another state, because random numbers do not come from the seed alone.
        """
        self.close()
        replayed = GymnasiumSlots(self.run, saved["seeds"].tolist(), self._training)
        for actions in saved["actions"]:
            replayed.step(actions)
        replayed.finished.clear()
        vars(self).update(vars(replayed))
        for array_name, array in self.saved_state().items():
            if not np.array_equal(array, saved[array_name]):
                raise ValueError(f"{self.run.env} reaches another state by the same seed and actions")


def _difference_from_space(flat_observation: np.ndarray, space: spaces.Space[Any]) -> str:
    """Return how an observation differs from its space, if that is a `Box`; else empty."""
    if not isinstance(space, spaces.Box):
        return ""
    if not np.can_cast(flat_observation.dtype, space.dtype):
        return f"{flat_observation.dtype} in place of {space.dtype}"
    low, high = space.low.reshape(-1), space.high.reshape(-1)
    outside = (flat_observation < low) | (flat_observation > high)
    if not outside.any():
        return ""
    index = int(outside.argmax())
    return f"number {index} is {flat_observation[index]:g}, and not from {low[index]:g} to {high[index]:g}"


def actions_in_space(space: spaces.Space[Any], actions: np.ndarray) -> Sequence[Any]:
    """Return a policy's actions, (N,) or (N, dimensions), as elements of an environment's space."""
    if isinstance(space, spaces.Discrete):
        first_action = int(space.start)
        return [first_action + action for action in actions.tolist()]
    shaped_actions = [np.asarray(action, space.dtype).reshape(space.shape) for action in actions]
    if isinstance(space, spaces.MultiDiscrete):
        return [action + space.start for action in shaped_actions]
    return shaped_actions


def _mask_of_space(space: spaces.Space[Any], allowed: np.ndarray) -> Any:
    """Return a mask as `space.sample` takes it, of a row with a 1 for each allowed value of each choice."""
    if isinstance(space, spaces.MultiDiscrete):
        return tuple(np.split(allowed, np.cumsum(choice_counts(space))[:-1]))
    if isinstance(space, spaces.MultiBinary):  # 2 where both values are allowed
        may_be_off, may_be_on = allowed.reshape(-1, 2).T
        return may_be_on * (1 + may_be_off)
    return allowed


def choice_counts(space: spaces.Space[Any]) -> np.ndarray:
    """Return how many values each of an action's choices has."""
    if isinstance(space, spaces.MultiDiscrete):
        return np.asarray(space.nvec, np.int64)
    return np.full(space.shape or (), 2)


def flattening(run: Run, space: spaces.Space[Any]) -> Callable[[Any], Any]:
    """Return a function that flattens an observation to a row of numbers."""
    check_observations(run, space)
    if isinstance(space, spaces.Box):
        return lambda observation: np.reshape(observation, -1)
    return lambda observation: spaces.flatten(space, observation)


def check_observations(run: Run, space: spaces.Space[Any]) -> None:
    """Refuse observations that are not numbers, and pictures that would be flattened."""
    for leaf_space in _leaf_spaces(space):
        if not isinstance(leaf_space, FLAT_SPACES):
            remedy = "name a wrapper that leaves that out"
            problem = f"{type(leaf_space).__name__} cannot be flattened to numbers"
            raise UserError(f"{run.env}: observations in {problem}: {remedy}")
    refuse_flat_pictures(run, space)


def _leaf_spaces(space: spaces.Space[Any]) -> list[spaces.Space[Any]]:
    """Return the spaces within a dictionary or tuple, or the space itself."""
    if not isinstance(space, spaces.Dict | spaces.Tuple):
        return [space]
    subspaces = space.spaces.values() if isinstance(space, spaces.Dict) else space.spaces
    return [leaf_space for subspace in subspaces for leaf_space in _leaf_spaces(subspace)]


def refuse_flat_pictures(run: Run, space: spaces.Space[Any]) -> None:
    """Refuse a run whose policy would flatten pictures: a multilayer perceptron, as is the default."""
    if run.policy and not run.policy.startswith("Mlp"):
        return
    dimensions = [len(leaf.shape or ()) for leaf in _leaf_spaces(space) if _is_picture(leaf)]
    if dimensions:
        policy_name = "MultiInputPolicy" if isinstance(space, spaces.Dict) else "CnnPolicy"
        remedy = 'wrappers = ["FlattenObservation"]'
        if min(dimensions) == 3:  # to Stable-Baselines3, a picture has channels
            remedy = f'set policy = "{policy_name}", or {remedy}'
        raise UserError(f"{run.env}: its observations are pictures, which MlpPolicy would flatten: {remedy}")


def _is_picture(space: spaces.Space[Any]) -> bool:
    """Return whether a space is of pictures, by Stable-Baselines3's rule, with or without channels."""
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
        if run.env.startswith(MINATAR) and run.env not in gymnasium.registry:
            _register_minatar()
        with errors_from(f"env = {run.env}"):
            env = gymnasium.make(run.env, disable_env_checker=True, **arguments)
    except UserError as error:
        if isinstance(error.__cause__, VersionNotFound | DeprecatedEnv):  # which name other versions
            raise
        raise UserError(f"{error}{_registration_hint(run)}") from None
    for wrapper in run.wrappers:
        class_name, brace, arguments_text = wrapper.partition("{")
        with errors_from(f"wrappers = {wrapper}"):
            env = load_class(class_name)(env, **json.loads(brace + arguments_text or "{}"))
    return env


class _Closes(Protocol):
    def close(self) -> object: ...


Closable = TypeVar("Closable", bound=_Closes)


@contextmanager
def closed_after(run: Run, env: Closable) -> Iterator[Closable]:
    """Close a run's environment at the end of a `with` block; an error in it is a user's mistake."""
    try:
        yield env
    except BaseException:
        with suppress(Exception):  # the first error is the one to mend
            env.close()
        raise
    with errors_from(f"{run.env} when it is closed"):
        env.close()


def _register_minatar() -> None:
    """Register MinAtar's games, if they are installed: an import does not, and Gymnasium loads no plugins."""
    if find_spec("minatar"):
        with errors_from("MinAtar's games cannot be registered"):
            import_module("minatar.gym").register_envs()


def load_class(class_path: str) -> Any:
    """Return what module:Class names."""
    module_name, _, class_name = class_path.rpartition(":")
    return getattr(_load(module_name), class_name)


def _registration_hint(run: Run) -> str:
    """Return how to register an environment; empty if it is registered."""
    if run.env in gymnasium.registry:
        return ""
    package = "install its package"
    for extra in EXTRAS:
        if run.env.lower().startswith(extra):
            package = install_command(extra)
    return f"; {package}, or name the module that registers it as env_module"


@contextmanager
def errors_from(source: str) -> Iterator[None]:
    """Turn any exception of a user's own code into a one-line error that names the source and the cause."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        cause = type(error).__name__
        if str(error).strip():
            cause += f": {str(error).strip().splitlines()[0]}"
        raise OwnCodeError(f"{source}: {cause}") from error


def _load(module_name: str) -> Any:
    with errors_from(f"module {module_name} cannot be imported"):
        return load_module(module_name)
