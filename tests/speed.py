"""How fast rules, engines and start are beside CartPole and plain SB3: `python -m tests.speed [--json]`."""

from __future__ import annotations

import json
import shlex
import statistics
import subprocess
import sys
import timeit
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO

from pneuma.config import make_run
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.records import Records
from pneuma.engines.sb3 import Sb3Trainer
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.worlds import Worlds

ARENA = "pneuma/PneumaArena-v0"
ROUNDS = 3
KERNEL_STEPS, TRAINED_STEPS, HORIZON = 6_400, 2_048, 256
NETWORKS = {"pi": [128], "vf": [256]}


def main() -> None:
    """Measure all cases and print them as a table, or as JSON."""
    torch.set_num_threads(1)
    rows = [*steps_per_second(), *seconds_to_start()]
    lines = [f"{row['case']:36} {row['value']:12,.2f} {row['unit']}" for row in rows]
    print(json.dumps(rows, indent=2) if "--json" in sys.argv else "\n".join(lines))


def steps_per_second() -> Iterator[dict[str, object]]:
    cases: list[tuple[str, int, Callable[[], object]]] = [
        ("rules, one world", KERNEL_STEPS, kernel(1)),
        ("rules, 64 worlds", KERNEL_STEPS, kernel(64)),
        ("Gymnasium, one world", KERNEL_STEPS, single(ARENA)),
        ("Gymnasium, CartPole-v1", KERNEL_STEPS, single("CartPole-v1")),
        ("PPO, engine batched", TRAINED_STEPS, engine("batched")),
        ("PPO, engine sb3", TRAINED_STEPS, engine("sb3")),
        ("PPO, Stable-Baselines3 alone", TRAINED_STEPS, plain()),
    ]
    for case, steps, work in cases:
        work()  # compiles, and fills caches
        yield {"case": case, "value": steps / seconds(work), "unit": "agent steps a second"}


def seconds_to_start() -> Iterator[dict[str, object]]:
    for words in ("-c pass", "-c 'import pneuma'", "-m pneuma --help", "-m pneuma study list"):
        command = [sys.executable, *shlex.split(words)]
        start = partial(subprocess.run, command, capture_output=True, check=True)
        yield {"case": f"start: python {words}", "value": seconds(start), "unit": "seconds"}


def seconds(work: Callable[[], object]) -> float:
    """Return how long some work takes, the median of some rounds."""
    return statistics.median(timeit.repeat(work, number=1, repeat=ROUNDS))


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


def engine(name: str) -> Callable[[], None]:
    """Return a function that trains on by an engine, without the evaluations of a run."""
    learner = {"horizon": HORIZON, "slots": 1, "actor": NETWORKS["pi"], "critic": NETWORKS["vf"]}
    run = make_run({"env": ARENA, "engine": name, **learner})
    trainer = {"batched": BatchedTrainer, "sb3": Sb3Trainer}[name](run)

    def train() -> None:
        for step in range(0, TRAINED_STEPS, HORIZON):
            trainer.update(step, step + HORIZON, Records())

    return train


def plain() -> Callable[[], object]:
    settings: Any = {"n_steps": HORIZON, "policy_kwargs": {"net_arch": NETWORKS}, "device": "cpu"}
    learner = PPO("MlpPolicy", PneumaVecEnv(1, seed=0, env_id=ARENA), **settings)
    return lambda: learner.learn(TRAINED_STEPS)


if __name__ == "__main__":
    main()
