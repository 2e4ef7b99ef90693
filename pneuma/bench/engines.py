"""Speed of the engines: the compiled one against Stable-Baselines3.

Both train runs without evaluation, on one thread, in alternating rounds, after compiling.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

from pneuma.config import BASES, Run, make_run
from pneuma.engines.loop import train_run
from pneuma.study.executors.local import one_thread_environment

SIZES: dict[str, dict[str, object]] = {"small": {}, "mid": {"actor": [512], "critic": [2048, 2048]}}
"""Networks of the thesis (section 6.1): [128] / [256], and the medium ones."""

CASES: tuple[tuple[str, int, int, int, int], ...] = (
    ("small", 1, 10_240, 3_072, 5),
    ("small", 10, 5_120, 3_072, 5),
    ("small", 30, 5_120, 3_072, 3),
    ("mid", 1, 1_024, 512, 3),
)
"""Size, runs of the compiled engine, its steps for each, steps of Stable-Baselines3's one run, rounds."""


def bench_engines() -> dict[str, Any]:
    """Return the result of `measure` in a process with one thread."""
    command = [sys.executable, "-m", "pneuma.bench.engines"]
    done = subprocess.run(command, env=one_thread_environment(), stdout=subprocess.PIPE, check=True)
    report: dict[str, Any] = json.loads(done.stdout)
    return report


def measure() -> dict[str, Any]:
    """Return the steps per second of both engines and the median of their ratio, by case."""
    cases: list[dict[str, Any]] = []
    ratios = {}
    for size, runs, steps, reference_steps, rounds in CASES:
        compiled = [engine_run(size, "batched", seed, steps) for seed in range(runs)]
        ours, theirs = engine_rates(compiled, engine_run(size, "sb3", 0, reference_steps), rounds)
        case = f"{size} network, {runs} {'run' if runs == 1 else 'runs'}"
        for engine, count, rates in (("batched", runs, ours), ("sb3", 1, theirs)):
            rate = statistics.median(rates)
            cases.append({"case": case, "engine": engine, "runs": count, "steps_per_second": rate})
        ratios[case] = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    return {"cases": cases, "ratios": ratios}


def engine_run(size: str, engine: str, seed: int, steps: int) -> Run:
    """Return a run of one of `SIZES`."""
    return make_run({**BASES["table-6-2"], **SIZES[size], "engine": engine, "seed": seed, "steps": steps})


def engine_rates(compiled: Sequence[Run], reference: Run, rounds: int) -> tuple[list[float], list[float]]:
    """Return the steps per second of both engines in each round."""
    train(compiled[0])  # which compiles
    rates: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for rate, runs in zip(rates, (compiled, [reference]), strict=True):
            begun = time.perf_counter()
            for run in runs:
                train(run)
            rate.append(sum(run.steps for run in runs) / (time.perf_counter() - begun))
    return rates


def train(run: Run) -> None:
    """Train a run without evaluations."""
    train_run(run, lambda progress: True, evaluated=False)


if __name__ == "__main__":
    print(json.dumps(measure()))
