"""A corridor, as a user's own module registers it: 1 steps right, to the goal, 0 left; it breaks if asked."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numba import njit

compiled: Any = njit


@compiled
def _draw() -> float:
    return np.random.random() + random.random()


CHANCES: dict[str, Callable[[], float]] = {
    "global": lambda: float(np.random.random()),
    "python": random.random,
    "numba": lambda: float(_draw()),
    "torch": lambda: float(torch.rand(())),
}
"""Generators that are not the environment's own, by the kind of corridor that draws from them."""


BOX = spaces.Box(-1, 5, (2,), np.float64)
OBSERVED: dict[str, spaces.Space[Any]] = {
    "dict": spaces.Dict({"b": BOX, "a": spaces.Discrete(6)}),
    "low": spaces.Box(-1, 3, (2,), np.float64),
    "double": spaces.Box(-1, 3, (2,), np.float32),
    "graph": spaces.Graph(BOX, None),
    "sequence": spaces.Sequence(BOX),
    "nested": spaces.Dict({"a": spaces.Dict({"b": BOX})}),
    "one of": spaces.OneOf([BOX, spaces.Discrete(6)]),
    "text": spaces.Dict({"a": BOX, "mission": spaces.Text(9)}),
    "picture": spaces.Box(0, 255, (36, 36, 3), np.uint8),
    "small picture": spaces.Box(0, 255, (8, 8, 3), np.uint8),
}


def action_space(kind: str, first: int) -> spaces.Space[Any]:
    match kind:
        case "pairs":  # the first of four decides, as where there is one
            return spaces.MultiDiscrete(np.array([[2, 3], [2, 2]]), start=np.array([[first, 0], [5, 1]]))
        case "row":
            return spaces.MultiDiscrete([2, 3], start=[first, first])
        case "bits":
            return spaces.MultiBinary(3)
        case "tuple":
            return spaces.Tuple([spaces.Discrete(2)])
        case "unbounded":
            return spaces.Box(-np.inf, np.inf, (1,))
        case "numbers":
            low, high = np.array([[[0, 10], [0, 0]], [[1, 12], [1, 1]]], np.float64)
            return spaces.Box(low, high, dtype=np.float64)
    return spaces.Discrete(2, start=first)


class Corridor(gymnasium.Env[Any, Any]):
    """Every step costs 0.1 and chance a little, at the fifth cell there is 1 and success."""

    def __init__(self, raises: int = 0, nan: int = 0, first: int = 0, kind: str = "box") -> None:
        self.raises, self.nan, self.first, self.kind = raises, nan, first, kind
        self.action_space, self.observation_space = action_space(kind, first), OBSERVED.get(kind, BOX)
        self.taken = 0

    def _seen(self) -> Any:
        if "picture" in self.kind:
            return np.full(self.observation_space.shape or (), 50 * self.cell, np.uint8)
        seen = np.array([self.cell, CHANCES.get(self.kind, self.np_random.random)()])
        if self.kind == "short" and self.taken == 3:
            return seen[:1]
        return {"b": seen, "a": self.cell} if self.kind == "dict" else seen

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.cell = 0
        return self._seen(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.taken += 1
        if self.taken == self.raises:
            raise ZeroDivisionError("by the corridor")
        assert self.action_space.contains(action)
        if self.kind == "words" and self.taken == 3:
            return self._seen(), 0.0, "no", False, {}  # type: ignore[return-value]
        if self.kind == "endless":
            return self._seen(), 0.0, False, False, {}
        if self.kind == "numbers":
            return self._seen(), float(action.sum()), False, self.taken % 10 == 0, {}
        right = np.ravel(action)[0] == self.first + 1
        self.cell = max(self.cell + (1 if right else -1), 0)
        paid = float("nan") if self.taken == self.nan else -0.1 - 0.01 * self.np_random.random()
        there = self.cell == 5
        return self._seen(), 1.0 if there else paid, there, False, {"is_success": there}


class Masked(Corridor):
    """It allows the actions of a mask, by default only the step to the right; any other is an error."""

    def __init__(self, kind: str = "box", mask: list[int] | None = None) -> None:
        super().__init__(kind=kind)
        self.mask = np.array([0, 1] if mask is None else mask, np.bool_)

    def action_masks(self) -> np.ndarray:
        return self.mask

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        choices = np.ravel(action - getattr(self.action_space, "start", 0))
        values = np.ravel(getattr(self.action_space, "nvec", np.full(len(choices), 2)))
        assert self.mask[np.cumsum(values) - values + choices].all(), "a masked action"
        return super().step(action)


class Alone(Corridor):
    """There can be few at a time, as where each opens one of a list of ports."""

    opened, largest = 0, 1

    def __init__(self) -> None:
        super().__init__()
        if Alone.opened == Alone.largest:
            raise OSError("Address already in use")
        Alone.opened += 1

    def close(self) -> None:
        Alone.opened -= 1


class Clinging(Corridor):
    """It cannot be closed."""

    def close(self) -> None:
        raise OSError("still in use")


class Counting(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Keeps something over episodes, as means of observations are kept: it pays the number of the episode."""

    count = 0

    def reset(self, **options: Any) -> Any:
        self.count += 1
        return self.env.reset(**options)

    def step(self, action: Any) -> Any:
        seen, _, *rest = self.env.step(action)
        return (seen, float(self.count), *rest)


class Doubled(gymnasium.RewardWrapper[Any, Any]):
    def reward(self, reward: Any) -> float:
        return 2 * float(reward)


if "Masked-v0" not in gymnasium.registry:  # tests import copies of this file
    gymnasium.register("Masked-v0", "tests.engines.own_envs:Masked", max_episode_steps=30)
gymnasium.register("Corridor-v0", "tests.engines.own_envs:Corridor", max_episode_steps=30)
