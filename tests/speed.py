"""How fast rules, engines and start are, compared with plain Stable-Baselines3: `python -m tests.speed`.

Ratios are medians over rounds in which both sides take turns, of processor time, so that other programs
disturb them little. `docs/engines.md` has the table of one processor.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from statistics import median
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

from pneuma.config import Run, make_run
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.loop import Progress, train_run
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.worlds import Worlds
from pneuma.presets import BASES
from pneuma.store.provenance import machine
from pneuma.training.executors.local import worker_environment

ARENA, TEXT = "pneuma/PneumaArena-v0", "pneuma/Pneuma-v0"
ROUNDS = 5
KERNEL_STEPS, STEPS, SB3_STEPS = 12_800, 50_000, 2_048
SETTINGS: dict[str, Any] = {**BASES["table-6-2"], "env": TEXT, "betas": (0.9, 0.9), "steps": STEPS}
"""Of the study `optimizer`, condition `non-stationary`, at its quick preset."""
FIRST_EVALUATION = f"""
from pneuma.config import make_run
from pneuma.engines.loop import train_run
train_run(make_run({SETTINGS | {"slots": 4}}), lambda progress: not progress.records.evaluations)
"""
FIRST_STEP = (
    "import gymnasium, pneuma; env = gymnasium.make('pneuma/Pneuma-v0'); env.reset(seed=0); env.step(0)"
)
Row = tuple[str, float, str]
"""What was measured, a number, and its unit."""


def main() -> None:
    """Measure all cases and print them as a table."""
    torch.set_num_threads(1)
    print(machine()["cpu"])
    for case, value, unit in chain(rules(), training(), update(), starts()):
        print(f"{case:58} {value:12,.2f} {unit}")


def alternated(*works: Callable[[], object]) -> list[list[float]]:
    """Return the processor seconds of each work in each round; a round before compiles and fills caches."""
    seconds: list[list[float]] = [[] for _ in works]
    for _ in range(ROUNDS + 1):
        for work, work_seconds in zip(works, seconds, strict=True):
            begin = time.process_time()
            work()
            work_seconds.append(time.process_time() - begin)
    return [work_seconds[1:] for work_seconds in seconds]


# --- Rules and Gymnasium ---------------------------------------------------------------------------


def rules() -> Iterator[Row]:
    works: dict[str, Callable[[], object]] = {
        "rules, one world": kernel(1), "rules, 64 worlds": kernel(64),
        "Gymnasium, one world": partial(single, gymnasium.make(ARENA)),
        "Gymnasium, CartPole-v1": partial(single, gymnasium.make("CartPole-v1")),
    }  # fmt: skip
    for name, seconds in zip(works, alternated(*works.values()), strict=True):
        yield name, KERNEL_STEPS / median(seconds), "agent steps a second"


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


def single(env: Any) -> None:
    """Play at random through Gymnasium."""
    env.reset(seed=0)
    for action in np.random.default_rng(0).integers(env.action_space.n, size=KERNEL_STEPS):
        *_, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()


# --- Training and Stable-Baselines3 alone ---------------------------------------------------------


def training() -> Iterator[Row]:
    """Compare whole runs, with their evaluations and a worker's start, with `learn` alone."""
    start = median(cold_seconds(FIRST_EVALUATION, Path(tempfile.gettempdir()) / "pneuma-speed", 3)[1:])
    yield "start of a worker up to the first evaluation", start, "seconds"
    for slots, where in ((1, "one environment"), (4, "four environments")):
        shares: list[float] = []
        run = make_run({**SETTINGS, "slots": slots})
        own, plain = alternated(partial(whole_run, run, shares), stable_baselines3(run))
        yield f"run of {STEPS:,} steps, {where}", median(own), "seconds"
        yield f"its evaluations, {where}", 100 * median(shares), "% of it"
        yield f"Stable-Baselines3, {where}", 1e6 * median(plain) / SB3_STEPS, "us a step"
        for seeds in (10, 30):
            ratios = []
            for ours, theirs in zip(own, plain, strict=True):
                ratios.append(seeds * theirs * STEPS / SB3_STEPS / (seeds * ours + start))
            yield f"batched against Stable-Baselines3, {where}, {seeds} seeds", median(ratios), "times"


def whole_run(run: Run, shares: list[float]) -> None:
    """Train a run, and note which share of its time its evaluations took."""
    begin, evaluating = time.perf_counter(), [0.0]

    def note(progress: Progress) -> bool:
        evaluating.append(progress.evaluation_seconds)
        return True

    train_run(run, note)
    shares.append(evaluating[-1] / (time.perf_counter() - begin))


def stable_baselines3(run: Run) -> Callable[[], object]:
    networks = {"pi": [*run.actor], "vf": [*run.critic]}
    policy: Any = {"net_arch": networks, "optimizer_kwargs": {"betas": run.betas, "eps": run.epsilon}}
    learner = PPO(
        "MlpPolicy", PneumaVecEnv(run.slots, seed=0, env_id=run.env), n_steps=run.horizon, device="cpu",
        policy_kwargs=policy, batch_size=run.minibatch, n_epochs=run.epochs, learning_rate=run.learning_rate,
    )  # fmt: skip
    return lambda: learner.learn(SB3_STEPS)


def update() -> Iterator[Row]:
    trainer = BatchedTrainer(make_run({**SETTINGS, "slots": 4}))
    actor, learner, size = trainer.actor, trainer.learners[0], trainer.run.steps_per_update
    rollout = trainer.collector.collect(actor)
    updates, plays = alternated(lambda: learner.learn_from(rollout), lambda: trainer.collector.collect(actor))
    yield f"rollout of {size:,} steps", 1e3 * median(plays), "ms"
    yield f"update of {size:,} steps", 1e3 * median(updates), "ms"


# --- Starting --------------------------------------------------------------------------------------


def starts() -> Iterator[Row]:
    for case, code in (("first step of an environment", FIRST_STEP), ("first evaluation", FIRST_EVALUATION)):
        with tempfile.TemporaryDirectory() as caches:
            (cold,) = cold_seconds(code, Path(caches), 1)
        yield f"empty caches: {case}", cold, "seconds"
    for words in (["-c", "import pneuma"], ["-m", "pneuma", "--help"], ["-m", "pneuma", "study", "list"]):
        seconds = [child_seconds([sys.executable, *words], {}) for _ in range(ROUNDS)]
        yield " ".join(["python", *words]), median(seconds), "seconds"


def cold_seconds(code: str, caches: Path, times: int) -> list[float]:
    """Return the processor seconds of a program, run some times with caches of compiled programs there."""
    where = {"NUMBA_CACHE_DIR": str(caches)}
    return [child_seconds([sys.executable, "-c", code], where) for _ in range(times)]


def child_seconds(command: list[str], variables: dict[str, str]) -> float:
    before = os.times()
    subprocess.run(command, capture_output=True, check=True, env={**worker_environment(), **variables})
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


if __name__ == "__main__":
    if os.environ.get("OMP_NUM_THREADS") != "1":  # as a worker, on one thread
        os.execve(sys.executable, [sys.executable, "-m", "tests.speed", *sys.argv[1:]], worker_environment())
    main()
