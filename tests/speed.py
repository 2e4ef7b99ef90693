"""How fast rules, engines and start are, beside plain Stable-Baselines3: `python -m tests.speed [--json]`.

Ratios are medians over rounds in which both sides take turns, of processor time, so that other programs
disturb them little. `docs/engines.md` has the table of one processor.
"""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

from pneuma.config import Run, make_run
from pneuma.engines import mlp
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.loop import Progress, train_run
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.worlds import Worlds
from pneuma.presets import BASES
from pneuma.store.provenance import machine
from pneuma.training.executors.local import XLA_FLAGS, worker_environment

ARENA, TEXT = "pneuma/PneumaArena-v0", "pneuma/Pneuma-v0"
ROUNDS = 5
KERNEL_STEPS, STEPS, SB3_STEPS = 12_800, 50_000, 2_048
SEEDS, ENVIRONMENTS = (10, 30), (1, 4)
SETTINGS: dict[str, Any] = {**BASES["table-6-2"], "env": TEXT, "betas": (0.9, 0.9), "steps": STEPS}
"""Of the study `optimizer`, condition `non-stationary`, at its quick preset."""
FIRST_EVALUATION = f"""
from pneuma.config import make_run
from pneuma.engines.loop import train_run
train_run(make_run({SETTINGS | {"slots": 4}}), lambda told: not told.records.evaluations)
"""
FIRST_STEP = (
    "import gymnasium, pneuma; env = gymnasium.make('pneuma/Pneuma-v0'); env.reset(seed=0); env.step(0)"
)
Row = dict[str, object]


def main() -> None:
    """Measure all cases and print them as a table, or as JSON."""
    torch.set_num_threads(1)
    cores = Path("/proc/cpuinfo")
    wide = cores.exists() and "avx512f" in cores.read_text()
    processor = f"{machine()['cpu']}, with{'' if wide else 'out'} AVX-512"
    rows = [*rules(), *training(), *update(), *starts()]
    lines = [processor, *(f"{row['case']:58} {row['value']:12,.2f} {row['unit']}" for row in rows)]
    print(
        json.dumps({"processor": processor, "rows": rows}, indent=2)
        if "--json" in sys.argv
        else "\n".join(lines)
    )


def alternated(*works: Callable[[], object]) -> list[list[float]]:
    """Return the processor seconds of each work in each round; a round before compiles and fills caches."""
    for work in works:
        work()
    rounds = [[_seconds(work) for work in works] for _ in range(ROUNDS)]
    return [list(each) for each in zip(*rounds, strict=True)]


def _seconds(work: Callable[[], object]) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun


# --- Rules and Gymnasium ---------------------------------------------------------------------------


def rules() -> Iterator[Row]:
    names = ("rules, one world", "rules, 64 worlds", "Gymnasium, one world", "Gymnasium, CartPole-v1")
    for name, seconds in zip(
        names, alternated(kernel(1), kernel(64), single(ARENA), single("CartPole-v1")), strict=True
    ):
        yield {"case": name, "value": KERNEL_STEPS / median(seconds), "unit": "agent steps a second"}


def kernel(count: int) -> Callable[[], None]:
    """Return a function that plays worlds at random, `KERNEL_STEPS` in all."""
    worlds = Worlds(count)
    worlds.seed(range(count))
    worlds.reset()
    actions = np.random.default_rng(0).integers(5, size=(KERNEL_STEPS // count, count, 1))

    def play() -> None:
        for row in actions:
            if worlds.advance(row):
                worlds.reset(worlds.worlds["ending"] != 0)

    return play


def single(name: str) -> Callable[[], None]:
    """Return a function that plays an environment of Gymnasium's at random."""
    env = gymnasium.make(name)
    env.reset(seed=0)
    count = int(env.action_space.n)  # type: ignore[attr-defined]
    actions = np.random.default_rng(0).integers(count, size=KERNEL_STEPS)

    def play() -> None:
        for action in actions:
            *_, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()

    return play


# --- Training beside Stable-Baselines3 alone -------------------------------------------------------


def training() -> Iterator[Row]:
    """Compare whole runs, with their evaluations and a worker's start, with `learn` alone."""
    loaded = median(cold_seconds(FIRST_EVALUATION, Path(tempfile.gettempdir()) / "pneuma-speed", 3)[1:])
    yield {"case": "start of a worker up to the first evaluation", "value": loaded, "unit": "seconds"}
    for slots in ENVIRONMENTS:
        shares: list[float] = []
        run = make_run({**SETTINGS, "slots": slots})
        own, plain = alternated(partial(whole_run, run, shares), stable_baselines3(run))
        pace = [seconds * STEPS / SB3_STEPS for seconds in plain]
        where = f"{slots} environment{'s' * (slots > 1)}"
        yield {"case": f"run of {STEPS:,} steps, {where}", "value": median(own), "unit": "seconds"}
        yield {"case": f"its evaluations, {where}", "value": 100 * median(shares), "unit": "% of it"}
        yield {
            "case": f"Stable-Baselines3, {where}",
            "value": 1e6 * median(plain) / SB3_STEPS,
            "unit": "us a step",
        }
        for seeds in SEEDS:
            ratios = [
                seeds * theirs / (seeds * ours + loaded) for ours, theirs in zip(own, pace, strict=True)
            ]
            case = f"batched against Stable-Baselines3, {where}, {seeds} seeds"
            yield {"case": case, "value": median(ratios), "unit": "times"}


def whole_run(run: Run, shares: list[float]) -> None:
    begun, told = time.perf_counter(), 0.0

    def note(progress: Progress) -> bool:
        nonlocal told
        told = progress.evaluation_seconds
        return True

    train_run(run, note)
    shares.append(told / (time.perf_counter() - begun))


def stable_baselines3(run: Run) -> Callable[[], object]:
    networks = {"pi": [*run.actor], "vf": [*run.critic]}
    policy: Any = {"net_arch": networks, "optimizer_kwargs": {"betas": run.betas, "eps": run.epsilon}}
    learner = PPO(
        "MlpPolicy", PneumaVecEnv(run.slots, seed=0, env_id=run.env), n_steps=run.horizon, device="cpu",
        policy_kwargs=policy, batch_size=run.minibatch, n_epochs=run.epochs, learning_rate=run.learning_rate,
    )  # fmt: skip
    return lambda: learner.learn(SB3_STEPS)


# --- An update and its floor -----------------------------------------------------------------------


def update() -> Iterator[Row]:
    """Compare an update with its products, tanh and Adam alone, done on the same core by NumPy and `mlp`."""
    run = make_run({**SETTINGS, "slots": 4})
    trainer = BatchedTrainer(run)
    actor, learner = trainer.policy().actor, trainer.learners[0]
    rollout = trainer.collector.collect(actor)
    whole, floor = alternated(lambda: learner.learn_from(rollout), bare_update(run, trainer))
    plays, _ = alternated(lambda: trainer.collector.collect(actor), lambda: trainer.evaluate(0))
    size = run.steps_per_update
    yield {"case": f"rollout of {size:,} steps", "value": 1e3 * median(plays), "unit": "ms"}
    yield {"case": f"update of {size:,} steps", "value": 1e3 * median(whole), "unit": "ms"}
    yield {"case": "its products, tanh and Adam alone", "value": 1e3 * median(floor), "unit": "ms"}
    ratios = [ours / least for ours, least in zip(whole, floor, strict=True)]
    yield {"case": "update against this floor", "value": median(ratios), "unit": "times"}


def bare_update(run: Run, trainer: BatchedTrainer) -> Callable[[], None]:
    rows, policy = run.minibatch, trainer.policy()
    generator = np.random.default_rng(0)

    def some(*shape: int) -> np.ndarray:
        return generator.standard_normal(shape, np.float32)

    layers = [
        (some(rows, weight.shape[0]), weight, some(rows, weight.shape[1]), place > 0)
        for network in (policy.actor, policy.critic)
        for place, (weight, _) in enumerate(network)
    ]
    hidden = [some(rows * size) for size in (*run.actor, *run.critic)]
    count = sum(weight.size for _, weight, *_ in layers)
    moved, gradient, mean, square = some(count), some(count), some(count), some(count) ** 2

    def work() -> None:
        for _ in range(run.epochs * run.steps_per_update // rows):
            for x, weight, y, is_deep in layers:
                x @ weight
                x.T @ y
                if is_deep:
                    y @ weight.T
            for units in hidden:
                mlp.activate(mlp.ACTIVATION_CODES["tanh"], units)
            for factor in (mean, square):
                np.multiply(gradient, factor, out=moved)
                np.add(moved, factor, out=moved)
            np.sqrt(square, out=moved)
            np.divide(mean, moved, out=moved)

    return work


# --- Starting --------------------------------------------------------------------------------------


def starts() -> Iterator[Row]:
    for case, code in (("first step of an environment", FIRST_STEP), ("first evaluation", FIRST_EVALUATION)):
        with tempfile.TemporaryDirectory() as caches:
            (cold,) = cold_seconds(code, Path(caches), 1)
        yield {"case": f"empty caches: {case}", "value": cold, "unit": "seconds"}
    for words in ("-c pass", "-c 'import pneuma'", "-m pneuma --help", "-m pneuma study list"):
        seconds = [child_seconds([sys.executable, *shlex.split(words)], {}) for _ in range(ROUNDS)]
        yield {"case": f"python {words}", "value": median(seconds), "unit": "seconds"}


def cold_seconds(code: str, caches: Path, times: int) -> list[float]:
    """Return the processor seconds of a program, run some times with caches of compiled programs there."""
    where = {"NUMBA_CACHE_DIR": str(caches / "numba"), "JAX_COMPILATION_CACHE_DIR": str(caches / "jax")}
    return [child_seconds([sys.executable, "-c", code], where) for _ in range(times)]


def child_seconds(command: list[str], variables: dict[str, str]) -> float:
    before = os.times()
    subprocess.run(command, capture_output=True, check=True, env={**worker_environment(), **variables})
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


if __name__ == "__main__":
    if os.environ.get("XLA_FLAGS") != XLA_FLAGS:  # as a worker, on one thread
        os.execve(sys.executable, [sys.executable, "-m", "tests.speed", *sys.argv[1:]], worker_environment())
    main()
