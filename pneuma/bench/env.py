"""Speed of the environment's faces beside Gymnasium's CartPole, and of starting, on one core."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np

import pneuma  # noqa: F401 (registers the environments)
from pneuma.config import ENVIRONMENTS
from pneuma.env.worlds import Worlds

ROUNDS = 7
SECONDS_PER_ROUND = 0.4

IMPORT = "import pneuma"
FIRST_STEP = """
import gymnasium, pneuma
env = gymnasium.make("pneuma/Pneuma-v0")
env.reset(seed=0)
env.step(0)
"""
TIMED = "from time import perf_counter; start = perf_counter()\n{}\nprint(perf_counter() - start)"

Step = Callable[[int], None]


def bench_env(rounds: int = ROUNDS, seconds: float = SECONDS_PER_ROUND) -> dict[str, Any]:
    """Return what `pneuma bench env --json` prints: the speed of every face, and of starting.

    Args:
        rounds: of which the median is told.
        seconds: that each case gets in a round.
    """
    return {"cases": face_rates(rounds, seconds), **start_seconds()}


def face_rates(rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Return agent steps a second of every case: the median of rounds that alternate between cases.

    Actions are uniformly random; an ended episode is reset within the measured time.
    """
    cases: list[tuple[str, str, int, Step]] = [
        ("kernel", "kernel", 1, _kernel(1)),
        ("kernel", "kernel", 64, _kernel(64)),
        ("kernel, all engaged", "kernel", 1, _kernel(1, engaged=True)),
        ("Gymnasium single", "single", 1, _single(ENVIRONMENTS[0])),
        ("Gymnasium vector", "vector", 64, _vector(64)),
        ("CartPole-v1, single", "cartpole", 1, _single("CartPole-v1")),
    ]
    rates: list[list[float]] = [[] for _ in cases]
    for _ in range(rounds):
        for own, (_, _, worlds, step) in zip(rates, cases, strict=True):
            own.append(rate_of(step, seconds) * worlds)
    return [
        {"case": case, "face": face, "worlds": worlds, "agent_steps_per_second": statistics.median(rate)}
        for (case, face, worlds, _), rate in zip(cases, rates, strict=True)
    ]


def rate_of(step: Step, seconds: float) -> float:
    """Return how often a second a step can be taken, tried for some seconds."""
    count, start = 0, time.perf_counter()
    while (elapsed := time.perf_counter() - start) < seconds or not count:
        for i in range(200):
            step(i)
        count += 200
    return count / elapsed


def engage(worlds: Worlds) -> None:
    """Bring every monster within reach of its player, and let nobody ever die: the worst case."""
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


def _vector(count: int) -> Step:
    env = gymnasium.make_vec(ENVIRONMENTS[0], num_envs=count)
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(5, size=(200, count))

    def step(i: int) -> None:
        env.step(actions[i])

    step(0)
    return step


def start_seconds(rounds: int = 3) -> dict[str, float]:
    """Return seconds until `pneuma` is imported, and until an environment's first step, cold and warm.

    Cold is with an empty compile cache, once; the others are medians of some rounds.
    """
    with tempfile.TemporaryDirectory() as cache:
        cold = _started(FIRST_STEP, NUMBA_CACHE_DIR=cache)
        warm = statistics.median(_started(FIRST_STEP, NUMBA_CACHE_DIR=cache) for _ in range(rounds))
    imported = statistics.median(_started(IMPORT) for _ in range(rounds))
    return {
        "import_seconds": imported,
        "first_step_cold_seconds": cold,
        "first_step_warm_seconds": warm,
    }


def _started(code: str, **environment: str) -> float:
    """Run code in another process; return its seconds, without those of starting Python."""
    path = {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", TIMED.format(code)]
    done = subprocess.run(
        command, env={**os.environ, **path, **environment}, capture_output=True, text=True, check=True
    )
    return float(done.stdout)
