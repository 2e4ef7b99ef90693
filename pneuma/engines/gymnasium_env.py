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
from importlib.metadata import entry_points
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
        warnings.catch_warnings(action="ignore", category=RunWarning),  # told by the run itself
        closing(GymnasiumSlots(run, [0])) as slots,
    ):
        space = slots.action_space
        if isinstance(space, spaces.Box) and not space.is_bounded():
            raise UserError(f"{run.env}: its actions {space} have no bounds: wrap it to give them some")
        if not isinstance(space, spaces.Discrete):
            numbers = isinstance(space, spaces.Box)
            what = "its actions are numbers" if numbers else "an action is several choices"
            if run.algorithm in VALUE_BASED:
                raise UserError(f"{run.env}: {what}, which {run.algorithm} cannot: try ppo")
            if run.engine != "sb3":
                raise UserError(f'{run.env}: {what}, which engine = "sb3" alone trains')
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
        flat = spaces.flatten_space(space)
        assert isinstance(flat, spaces.Box)
        self._bounds: tuple[np.ndarray, np.ndarray] | None = flat.low, flat.high
        self._declared = space.dtype if isinstance(space, spaces.Box) else None
        self.observations = np.zeros((len(seeds), *flat.shape), np.float32)
        self.terminal = np.zeros_like(self.observations)
        self.returns = np.zeros(len(seeds))
        self.lengths, self.episodes = np.zeros((2, len(seeds)), np.int64)
        self.finished: list[dict[str, Any]] = []
        few = isinstance(self.action_space, spaces.Discrete) and self.action_space.n <= 256
        numbers = isinstance(self.action_space, spaces.Box)
        self._kind = np.dtype(np.uint8 if few else np.float32 if numbers else np.int64)
        self.begin(seeds)

    def begin(self, seeds: Sequence[int]) -> None:
        for array in (self.returns, self.lengths, self.episodes):
            array[:] = 0
        self.steps = 0
        self.finished.clear()
        self._log = bytearray()
        self._first_seeds = [seed % 2**31 for seed in seeds]  # all environments take these
        self._seeds: list[int | None] = [*self._first_seeds]
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
        self._log += actions.astype(self._kind).tobytes()
        rewards = np.zeros(len(self.envs))
        terminated, truncated = np.zeros((2, len(self.envs)), np.bool_)
        self.steps += 1
        for slot, action in enumerate(self.actions(actions)):
            rewards[slot], ended, cut, info = self.step_one(slot, action)
            self.returns[slot] += rewards[slot]
            if ended or cut:
                terminated[slot], truncated[slot] = ended, not ended
                self._end(slot, "terminated" if ended else "truncated")
        if self._normalization:
            over = terminated | truncated
            rewards = self._normalization.step(self.observations, rewards, over, self.terminal)
        return rewards, terminated, truncated

    def actions(self, actions: np.ndarray) -> Sequence[Any]:
        return actions_in(self.action_space, actions)

    def any_action(self) -> Any:
        """Draw an action from the space's own generator; discrete ones count from 0."""
        return self.action_space.sample() - getattr(self.action_space, "start", 0)

    def step_one(self, slot: int, action: Any) -> tuple[float, bool, bool, Mapping[str, Any]]:
        with blamed(f"{self.run.env} in step {self.lengths[slot] + 1} of episode {self.episodes[slot]}"):
            observation, reward, ended, cut, info = self.envs[slot].step(action)
            self._see(slot, observation)
            if not math.isfinite(reward := float(reward)):
                raise ValueError(f"its reward is {reward}")
        self.lengths[slot] += 1
        return reward, bool(ended), bool(cut), info

    def _see(self, slot: int, observation: Any) -> None:
        seen, room = np.asarray(self._flatten(observation)), self.observations[slot]
        if seen.shape != room.shape:
            raise ValueError(f"its observation is of shape {seen.shape}, where its space says {room.shape}")
        room[:] = seen
        if not math.isfinite(room.sum()):
            raise ValueError("its observation is not finite")
        if self._bounds and (unlike := self._unlike_its_space(seen, *self._bounds)):
            self._bounds = None  # once is enough
            text = f"{self.run.env}: an observation is not of its declared space: {unlike}"
            warnings.warn(text, RunWarning, stacklevel=2)

    def _unlike_its_space(self, seen: np.ndarray, low: np.ndarray, high: np.ndarray) -> str:
        if self._declared and not np.can_cast(seen.dtype, self._declared):
            return f"{seen.dtype} in place of {self._declared}"
        outside = (seen < low) | (seen > high)
        if not outside.any():
            return ""
        place = int(outside.argmax())
        return f"number {place} is {seen[place]:g}, and not from {low[place]:g} to {high[place]:g}"

    def _end(self, slot: int, ending: str) -> None:
        self.terminal[slot] = self.observations[slot]
        episode, returned, length = (
            each[slot].item() for each in (self.episodes, self.returns, self.lengths)
        )
        self.finished.append(
            episode_row(slot, episode, self.steps * len(self.envs), returned, length, ending)
        )
        self.episodes[slot] += 1
        self.returns[slot], self.lengths[slot] = 0.0, 0
        self._reset(slot)

    def _reset(self, slot: int) -> None:
        seed, self._seeds[slot] = self._seeds[slot], None
        with blamed(f"{self.run.env} when it is reset"):
            self._see(slot, self.envs[slot].reset(seed=seed)[0])

    def close(self) -> None:
        for env in self.envs:
            with blamed(f"{self.run.env} when it is closed"):
                env.close()

    # --- Where it stands ---------------------------------------------------------------------------

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return everything that the next step depends on, and what identifies the state: arrays by name."""
        space = self.action_space
        shape = () if isinstance(space, spaces.Discrete) else (math.prod(space.shape),)
        log = np.frombuffer(bytes(self._log), self._kind).reshape(self.steps, len(self.envs), *shape)
        names = ("observations", "returns", "lengths", "episodes")
        known = {name: getattr(self, name).copy() for name in names}
        statistics = self._normalization.saved_state() if self._normalization else {}
        return {"actions": log, "seeds": np.array(self._first_seeds), **known, **statistics}

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
        if not all(np.array_equal(array, saved[name]) for name, array in self.saved_state().items()):
            raise ValueError(f"{self.run.env} does not come to the same state by the same seed and actions")


def actions_in(space: spaces.Space[Any], actions: np.ndarray) -> Sequence[Any]:
    """Return a policy's actions, (N,) or (N, dimensions), as an environment's space has them."""
    if isinstance(space, spaces.Discrete):
        first = int(space.start)
        return [first + action for action in actions.tolist()] if first else actions.tolist()
    made = [np.asarray(action, space.dtype).reshape(space.shape) for action in actions]
    return [each + space.start for each in made] if isinstance(space, spaces.MultiDiscrete) else made


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
    kinds = "Discrete, MultiDiscrete, MultiBinary or Box"
    raise UserError(f"{run.env}: actions in {space} cannot be learned: wrap it to have {kinds} ones")


def flattening(run: Run, space: spaces.Space[Any]) -> Callable[[Any], Any]:
    """Return a function that makes an observation a row of numbers."""
    if part := _not_flat(space):
        fix = "name a wrapper that leaves that out"
        raise UserError(f"{run.env}: observations in {part} cannot be flattened to numbers: {fix}")
    refuse_flat_pictures(run, space)
    if isinstance(space, spaces.Box):
        shape = space.shape
        return (lambda seen: seen) if len(shape) == 1 else (lambda seen: np.reshape(seen, -1))
    return lambda seen: spaces.flatten(space, seen)


def refuse_flat_pictures(run: Run, space: spaces.Space[Any]) -> None:
    """Refuse a run whose policy would flatten pictures: a multilayer perceptron, as is the default."""
    if run.policy and not run.policy.startswith("Mlp"):
        return
    several = isinstance(space, spaces.Dict)
    parts = list(space.spaces.values()) if isinstance(space, spaces.Dict) else [space]
    pictures = [part for part in parts if _is_picture(part)]
    if not pictures:
        return
    fix = 'wrappers = ["FlattenObservation"]'
    if all(len(picture.shape or ()) == 3 for picture in pictures):
        policy = "MultiInputPolicy" if several else "CnnPolicy"
        fix = f'set policy = "{policy}", or {fix}'
    raise UserError(f"{run.env}: its observations are pictures, which MlpPolicy would flatten: {fix}")


def _is_picture(space: spaces.Space[Any]) -> bool:
    """Return whether a space is of pictures, by Stable-Baselines3's rule; of one channel also without it."""
    if not isinstance(space, spaces.Box) or space.dtype != np.uint8 or len(space.shape) not in (2, 3):
        return False
    return bool((space.low == 0).all() and (space.high == 255).all())


def _not_flat(space: spaces.Space[Any], name: str = "") -> str:
    """Return what of a space is no array of one size, such as text; empty if all can be flattened."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        parts = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        return next(filter(None, (_not_flat(part, f" ({key})") for key, part in parts)), "")
    if isinstance(space, spaces.Text) or (space.dtype is not None and space.dtype.kind == "U"):
        return f"text{name}"
    with suppress(NotImplementedError):  # of a space of another package
        if space.is_np_flattenable:
            return ""
    return f"{type(space).__name__}{name}"


# --- Making one ------------------------------------------------------------------------------------


def make_env(run: Run, render_mode: str = "") -> gymnasium.Env[Any, Any]:
    arguments = json.loads(run.env_kwargs or "{}")
    if render_mode:
        arguments["render_mode"] = render_mode
    try:
        if run.env_module:
            _load(run.env_module)
        with blamed(f"env = {run.env}"):
            if run.env not in gymnasium.registry:
                _register_installed(run.env.partition("/")[0])
            env = gymnasium.make(run.env, disable_env_checker=True, **arguments)
    except UserError as error:
        raise UserError(f"{error}{_how_to_register(run)}") from None
    for name in run.wrappers:
        kind, brace, rest = name.partition("{")
        with blamed(f"wrappers = {name}"):
            env = load_class(kind)(env, **json.loads(brace + rest or "{}"))
    return env


def load_class(name: str) -> Any:
    """Return what module:Class names."""
    module, _, kind = name.rpartition(":")
    return getattr(_load(module), kind)


def _how_to_register(run: Run) -> str:
    """Return what is to be done for an environment that is not registered; empty if it is."""
    if run.env in gymnasium.registry:
        return ""
    extra = next((name for name in EXTRAS if run.env.lower().startswith(name)), None)
    package = install_extra(extra) if extra else "install its package"
    return f"; {package}, or name the module that registers it as env_module"


@contextmanager
def blamed(what: str) -> Iterator[None]:
    """Turn any exception of a user's own code into a one-line error that names its source, and its cause."""
    try:
        yield
    except UserError:
        raise
    except (Exception, SystemExit) as error:
        said = ": ".join([type(error).__name__, *str(error).strip().splitlines()[:1]])
        raise OwnCodeError(f"{what}: {said}") from error


def _register_installed(namespace: str) -> None:
    """Let an installed package register its environments by Gymnasium's former entry point."""
    for entry in entry_points(group="gymnasium.envs"):
        if entry.name in (namespace, "__root__"):
            entry.load()()


def _load(name: str) -> Any:
    with blamed(f"module {name} cannot be imported"):
        return load_module(name)
