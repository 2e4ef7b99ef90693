"""Speed of the engines: the compiled one over Stable-Baselines3, and two workers over one.

All train runs without evaluation on one thread each, in rounds that alternate; compiling is done before.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from pneuma.config import BASES, Run, make_run
from pneuma.study.executors.local import one_thread_environment

SIZES: dict[str, dict[str, object]] = {"small": {}, "mid": {"actor": [512], "critic": [2048, 2048]}}
"""Networks of the thesis (section 6.1): [128] / [256], and mid."""

CASES: tuple[tuple[str, int, int, int, int], ...] = (
    ("small", 1, 10_240, 3_072, 5),
    ("small", 10, 5_120, 3_072, 5),
    ("small", 30, 5_120, 3_072, 3),
    ("mid", 1, 1_024, 512, 3),
)
"""Size, runs of the compiled engine, its steps for each, steps of Stable-Baselines3's one run, rounds."""

WORKERS = "two workers over one"
WORKER_STEPS = 25_600
WORKER_ROUNDS = 5


def bench_engines() -> dict[str, Any]:
    """Return what `measure` does, from a process of its own that is pinned to one thread."""
    command = [sys.executable, "-m", "pneuma.bench.engines"]
    done = subprocess.run(command, env=one_thread_environment(), stdout=subprocess.PIPE, check=True)
    report: dict[str, Any] = json.loads(done.stdout)
    return report


def measure() -> dict[str, Any]:
    """Measure in this process; see `bench_engines`."""
    cases: list[dict[str, Any]] = []
    ratios = {}
    for size, runs, steps, reference_steps, rounds in CASES:
        own = [engine_run(size, "batched", seed, steps) for seed in range(runs)]
        ours, theirs = engine_rates(own, engine_run(size, "sb3", 0, reference_steps), rounds)
        name = f"{size} network, {runs} {'run' if runs == 1 else 'runs'}"
        cases += [_case(name, "batched", runs, ours), _case(name, "sb3", 1, theirs)]
        ratios[name] = _ratio(ours, theirs)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    one, two = worker_rates()
    cases += [_case(WORKERS, "batched", 1, one), _case(WORKERS, "batched", 2, two)]
    return {"cases": cases, "ratios": {**ratios, WORKERS: _ratio(two, one)}, "peak_megabytes": peak}


def engine_run(size: str, engine: str, seed: int, steps: int) -> Run:
    """Return a run of one of `SIZES`."""
    return make_run({**BASES["table-6-2"], **SIZES[size], "engine": engine, "seed": seed, "steps": steps})


def engine_rates(own: Sequence[Run], reference: Run, rounds: int) -> tuple[list[float], list[float]]:
    """Return the steps a second of both engines, round by round."""
    from pneuma.engines import batched, sb3

    def ours(run: Run) -> None:
        batched.train_one(run, lambda progress: True, evaluated=False)

    def theirs(run: Run) -> None:
        sb3.train_one(run, lambda progress: True, env=sb3.make_env(run))

    ours(own[0])  # compiles
    rates: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        for rate, train, runs in zip(rates, (ours, theirs), (own, [reference]), strict=True):
            begun = time.perf_counter()
            for run in runs:
                train(run)
            rate.append(sum(run.steps for run in runs) / (time.perf_counter() - begun))
    return rates


def worker_rates() -> tuple[list[float], list[float]]:
    """Return the steps a second of one worker process and of two, round by round."""
    one, two = list[float](), list[float]()
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        list(pool.map(_train, [512] * 4))  # both compile
        for _ in range(WORKER_ROUNDS):
            for count, rates in ((1, one), (2, two)):
                begun = time.perf_counter()
                list(pool.map(_train, [WORKER_STEPS] * count))
                rates.append(count * WORKER_STEPS / (time.perf_counter() - begun))
    return one, two


def _train(steps: int) -> None:
    from pneuma.engines import batched

    batched.train_one(engine_run("small", "batched", 0, steps), lambda progress: True, evaluated=False)


def _ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    return statistics.median(a / b for a, b in zip(ours, theirs, strict=True))


def _case(name: str, engine: str, runs: int, rates: Sequence[float]) -> dict[str, Any]:
    return {"case": name, "engine": engine, "runs": runs, "steps_per_second": statistics.median(rates)}


if __name__ == "__main__":
    print(json.dumps(measure()))
