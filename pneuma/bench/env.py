"""Speed of the environment's interfaces, and of tasks of other packages, on one core."""

from __future__ import annotations

import importlib
import statistics
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np

import pneuma  # noqa: F401 (registers the environments)
from pneuma.env.worlds import Worlds
from pneuma.env_fields import ENVIRONMENTS

ROUNDS = 7
SECONDS_PER_ROUND = 0.4

Step = Callable[[int], None]


def bench_env() -> list[dict[str, Any]]:
    """Return the agent steps per second of each case: the median of alternating rounds.

    Actions are uniformly random. Resets at the end of episodes are included in the time.
    """
    cases: list[tuple[str, str, int, Step]] = [
        ("kernel", "kernel", 1, _kernel(1)),
        ("kernel", "kernel", 64, _kernel(64)),
        ("kernel, all engaged", "kernel", 1, _kernel(1, engaged=True)),
        ("Gymnasium single", "single", 1, _single(ENVIRONMENTS[0])),
        ("Gymnasium vector", "vector", 64, _vector(gymnasium.make_vec(ENVIRONMENTS[0], num_envs=64))),
        ("CartPole-v1, single", "single", 1, _single("CartPole-v1")),
        *_others(),
    ]
    rates: list[list[float]] = [[] for _ in cases]
    for _ in range(ROUNDS):
        for case_rates, (_, _, worlds, step) in zip(rates, cases, strict=True):
            case_rates.append(rate_of(step) * worlds)
    return [
        {"case": case, "face": face, "worlds": worlds, "agent_steps_per_second": statistics.median(rate)}
        for (case, face, worlds, _), rate in zip(cases, rates, strict=True)
    ]


def _others() -> Iterator[tuple[str, str, int, Step]]:
    """Yield tasks of other packages, of those that are installed."""
    if find_spec("minatar"):
        importlib.import_module("minatar.gym").register_envs()
        yield "MinAtar Breakout, single", "single", 1, _single("MinAtar/Breakout-v1")
    if find_spec("minigrid"):
        yield "MiniGrid Empty 8x8, single", "single", 1, _single("minigrid:MiniGrid-Empty-8x8-v0")
    if find_spec("envpool"):
        envs = importlib.import_module("envpool").make_gymnasium("CartPole-v1", num_envs=64)
        yield "EnvPool CartPole-v1, vector", "vector", 64, _vector(envs)


def rate_of(step: Step) -> float:
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < SECONDS_PER_ROUND or not count:
        for i in range(200):
            step(i)
        count += 200
    return count / elapsed


def engage(worlds: Worlds) -> None:
    """Bring every monster within reach of its player and make nobody die: the worst case."""
    angles = np.random.default_rng(1).random(worlds.monsters.shape) * 6.283
    worlds.monsters["x"] = worlds.players["x"] + 30 * np.cos(angles)
    worlds.monsters["y"] = worlds.players["y"] + 30 * np.sin(angles)
    worlds.players["hp"] = worlds.player_stats["hp"] = 1e12
    worlds.player_stats["damage"] = 0.0
    worlds.settings["step_limit"] = 10**12


def _kernel(count: int, engaged: bool = False) -> Step:
    worlds = Worlds(count)
    worlds.seed(range(count))
    worlds.reset()
    if engaged:
        engage(worlds)
    actions = np.random.default_rng(0).integers(5, size=(200, count, 1))

    def step(i: int) -> None:
        if worlds.advance(actions[i]):
            worlds.reset(worlds.worlds["ending"] != 0)

    step(0)
    return step


def _single(name: str) -> Step:
    env = gymnasium.make(name)
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(int(env.action_space.n), size=200)  # type: ignore[attr-defined]

    def step(i: int) -> None:
        _, _, terminated, truncated, _ = env.step(actions[i])
        if terminated or truncated:
            env.reset()

    step(0)
    return step


def _vector(envs: Any) -> Step:
    envs.reset()
    most = int(getattr(envs, "single_action_space", envs.action_space).n)
    actions = np.random.default_rng(0).integers(most, size=(200, 64))

    def step(i: int) -> None:
        envs.step(actions[i])

    step(0)
    return step
