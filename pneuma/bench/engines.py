"""Speed of the engines: the compiled one over Stable-Baselines3, in one process on one thread.

Both train the same runs on the same worlds, without evaluation, in rounds that alternate; compiling is
done before. Beside it: how near the update comes to the core's own matrix product, and the memory.
"""

from __future__ import annotations

import json
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from pneuma.bench.workers import CASE, bench_workers
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

MATRIX_SIDE = 1024
UPDATES = {"small": 25, "mid": 3}
"""How many updates of each size are timed."""


def bench_engines() -> dict[str, Any]:
    """Return what `measure` does, from a process of its own that is pinned to one thread, and two workers."""
    command = [sys.executable, "-m", "pneuma.bench.engines"]
    done = subprocess.run(command, env=one_thread_environment(), stdout=subprocess.PIPE, check=True)
    report: dict[str, Any] = json.loads(done.stdout)
    workers = bench_workers()
    report["cases"] += workers["cases"]
    report["ratios"][CASE] = workers["ratio"]
    return report


def measure() -> dict[str, Any]:
    """Measure in this process; see `bench_engines`."""
    cases: list[dict[str, Any]] = []
    ratios = {}
    for size, runs, steps, reference_steps, rounds in CASES:
        own = [_run(size, "batched", seed, steps) for seed in range(runs)]
        reference = [_run(size, "sb3", 0, reference_steps)]
        ours, theirs = _alternate(own, reference, rounds)
        name = f"{size} network, {runs} {'run' if runs == 1 else 'runs'}"
        cases += [_case(name, "batched", runs, ours), _case(name, "sb3", 1, theirs)]
        ratios[name] = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
        if runs == 10:
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    shares, product = _update_shares()
    return {
        "cases": cases,
        "ratios": ratios,
        "update_over_matrix_product": shares,
        "matrix_product_gflops": product,
        "peak_megabytes_ten_small": peak,
    }


def _run(size: str, engine: str, seed: int, steps: int) -> Run:
    return make_run({**BASES["table-6-2"], **SIZES[size], "engine": engine, "seed": seed, "steps": steps})


def _alternate(own: Sequence[Run], reference: Sequence[Run], rounds: int) -> tuple[list[float], list[float]]:
    """Return the steps a second of both engines, round by round."""
    from pneuma.engines import batched, sb3

    def ours(run: Run) -> None:
        batched.train_one(run, lambda progress: True, evaluated=False)

    def theirs(run: Run) -> None:
        sb3.train_one(run, lambda progress: True, env=sb3.make_env(run))

    ours(make_run({"engine": "batched", **_shape(own[0]), "steps": 512}))  # compiles
    rates: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        rates[0].append(_rate(ours, own))
        rates[1].append(_rate(theirs, reference))
    return rates


def _shape(run: Run) -> dict[str, object]:
    return {name: getattr(run, name) for name in ("actor", "critic", "activation", "optimizer", "betas")}


def _rate(train: Callable[[Run], None], runs: Sequence[Run]) -> float:
    begun = time.perf_counter()
    for run in runs:
        train(run)
    return sum(run.steps for run in runs) / (time.perf_counter() - begun)


def _case(name: str, engine: str, runs: int, rates: Sequence[float]) -> dict[str, Any]:
    return {"case": name, "engine": engine, "runs": runs, "steps_per_second": statistics.median(rates)}


def _update_shares() -> tuple[dict[str, float], float]:
    """Return the update's rate of operations over that of a large float32 product, and the latter in GFLOP/s.

    By size of the networks; the median over pairs of measurements.
    """
    import jax
    import numpy as np

    square = np.ones((MATRIX_SIDE, MATRIX_SIDE), np.float32)
    product = jax.jit(lambda a: a @ a)
    product_rate, shares = [], {}
    for size in SIZES:
        update, operations = _update(size)
        update_rate = []
        for _ in range(UPDATES[size]):
            update_rate.append(operations / _seconds(update))
            product_rate.append(2 * MATRIX_SIDE**3 / _seconds(lambda: product(square).block_until_ready()))
        own = zip(update_rate, product_rate[-len(update_rate) :], strict=True)
        shares[size] = statistics.median(a / b for a, b in own)
    return shares, statistics.median(product_rate) / 1e9


def _update(size: str) -> tuple[Callable[[], object], int]:
    """Return a function that takes an update of one rollout, and its operations.

    A gradient step takes 6 for each weight and sample: 2 forward, 2 for the weight's gradient, 2 for that
    of the layer's input. The last are not needed where the input is the observation.
    """
    from pneuma.engines.batched.training import Training

    run = _run(size, "batched", 0, 512)
    training = Training(run)
    training.update(0)
    (learner,) = training.learners
    rollout = training.collector.collect([learner.networks["actor"]])
    weights = [[weight.size for weight, _ in part] for part in learner.networks.values()]
    operations = sum(4 * first + 6 * sum(others) for first, *others in weights)
    return lambda: learner.learn_from(rollout), operations * run.steps_per_update * run.epochs


def _seconds(call: Callable[[], object]) -> float:
    begun = time.perf_counter()
    call()
    return time.perf_counter() - begun


if __name__ == "__main__":
    print(json.dumps(measure()))
