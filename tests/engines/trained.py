"""Runs as short as can be, of every kind; trainings in this process, and the bits that they end with."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from pneuma.config import Run, make_run
from pneuma.engines.batched.rollout import Rollout
from pneuma.engines.loop import Progress, Result, train_run
from pneuma.engines.policy import Policy
from pneuma.engines.records import Checkpoint
from pneuma.store.checkpoints import TABLES
from pneuma.store.tables import to_parquet

SMALL: dict[str, Any] = {
    "actor": (8,), "critic": (12,), "horizon": 64, "minibatch": 32, "epochs": 2, "steps": 384,
    "evaluation_episodes": 2, "episode_steps": 60,
}  # fmt: skip
"""The engine `batched` compiles a program for each optimizer, shape and number of steps an update, which
takes longer than all that it trains here: tests of other slots or players take a shorter horizon, so that
an update has 64 steps all the same."""
TEAM: dict[str, Any] = {
    "players": 2, "slots": 2, "horizon": 32, "steps": 256, "episode_steps": 20, "learners": "independent",
}  # fmt: skip
CORRIDOR: dict[str, Any] = {"env": "Corridor-v0", "env_module": "tests.engines.own_envs"}
OTHERS: dict[str, Any] = {"slots": 2, "horizon": 32, "steps": 192}
NORMALIZED = {"normalize_observations": True, "normalize_rewards": True}
REPLAYED = {"learning_starts": 80, "target_every": 50, "buffer_size": 150, "gamma": 0.9}
LEARNERS: dict[str, dict[str, Any]] = {
    "ppo": {"engine": "sb3", "optimizer": "rmsprop", "momentum": 0.5, "weight_decay": 0.01},
    "a2c": {"algorithm": "a2c", "optimizer": "rmsprop"},
    "a2c-no-baseline": {"algorithm": "a2c", "value_baseline": False, "gae_lambda": 1},
    "trpo": {"algorithm": "trpo"},
    "dqn": {"algorithm": "dqn", **REPLAYED},
    "double-dqn": {"algorithm": "double-dqn", **REPLAYED, "slots": 2},
}
"""Of the engine `sb3` in Pneuma's worlds."""
CASES: dict[str, dict[str, Any]] = {
    "adam": {"betas": (0.9, 0.9)},
    "within an update": {"steps": 350, "slots": 2, "horizon": 32, "learning_rate_schedule": "linear"},
    "within an update sb3": {"steps": 350, "engine": "sb3", "learning_rate_schedule": "linear"},
    "momentum": {"optimizer": "sgd", "momentum": 0.9, "dampening": 0.9},
    "upgd": {"optimizer": "upgd", "noise": 0.1},
    "rmsprop": {"optimizer": "rmsprop", "momentum": 0.5, "weight_decay": 0.01},
    "slots": {"slots": 2, "horizon": 32, "env": "pneuma/PneumaGodot-v0", "episode_steps": 50},
    "players": {"players": 2, "horizon": 32, "episode_steps": 40, "clip": "separate"},
    "team": TEAM,
    "islands of mages": {
        "level": "random:train:0", "random_levels": 3, "magic": True, "classes": "mage", "episode_steps": 30,
    },
    **LEARNERS,
    "players sb3": {"players": 2, "horizon": 32, "episode_steps": 40, "clip": "separate", "engine": "sb3"},
    "cartpole": {"env": "CartPole-v1", **OTHERS},
    "cartpole sb3": {"env": "CartPole-v1", "engine": "sb3", **OTHERS},
    "normalized": {"env": "CartPole-v1", **OTHERS, **NORMALIZED, "learning_rate_schedule": "linear"},
    "normalized sb3": {
        "env": "Pendulum-v1", "engine": "sb3", **OTHERS, **NORMALIZED, "clip_range_schedule": "linear",
    },
    "corridor": {
        **CORRIDOR, **OTHERS, "env_kwargs": {"kind": "dict", "first": 3},
        "wrappers": "tests.engines.own_envs:Counting,tests.engines.own_envs:Doubled",
    },
    "pairs": {**CORRIDOR, **OTHERS, "env_kwargs": {"kind": "pairs", "first": 3}, "engine": "sb3"},
    "bits": {**CORRIDOR, **OTHERS, "env_kwargs": {"kind": "bits"}, "algorithm": "trpo"},
    "corridor dqn": {
        **CORRIDOR, **OTHERS, "algorithm": "dqn", "learning_starts": 30, "minibatch": 8, "buffer_size": 100,
    },
}  # fmt: skip


def run_of(case: str = "", /, **fields: Any) -> Run:
    return make_run({**SMALL, **CASES.get(case, {}), **fields})


def train(run: Run, checkpoint: Checkpoint | None = None) -> tuple[Result, list[Checkpoint]]:
    """Train a run; return its end and a checkpoint of every update."""
    checkpoints: list[Checkpoint] = []

    def keep(progress: Progress) -> bool:
        assert progress.checkpoint
        checkpoints.append(progress.checkpoint())
        return True

    return train_run(run, keep, checkpoint), checkpoints


@lru_cache(maxsize=64)
def train_once(run: Run) -> tuple[Result, list[Checkpoint]]:
    """Train a run for all tests that only look at what it gave, which none of them may change."""
    return train(run)


def rollouts_of(trainer: Any) -> list[Rollout]:
    """Return the list to which each rollout of the engine `batched` will be added."""
    rollouts: list[Rollout] = []
    collect = trainer.collector.collect

    def collecting(actor: Any) -> Rollout:
        rollouts.append(collect(actor))
        return rollouts[-1]

    trainer.collector.collect = collecting
    return rollouts


def bits(result: Result) -> tuple[object, ...]:
    """Return all that a run ends with; as Parquet, where NaN equals NaN."""
    assert result.policy is not None
    tables = [to_parquet(getattr(result.records, name), columns) for name, columns in TABLES.items()]
    return result.status, result.step, tables, result.policy.to_bytes()


def constant(outputs: Any, features: int, **parts: Any) -> Policy:
    """Return a policy that gives the same outputs whatever it observes; their first is its value."""
    bias = np.array(outputs, np.float32)
    actor = ((np.zeros((features, len(bias)), np.float32), bias),)
    critic = ((np.zeros((features, 1), np.float32), bias[:1]),)
    return Policy("tanh", actor, **{"critic": critic, **parts})


def random_layers(widths: tuple[int, ...], scale: float = 1.0, seed: int = 0) -> Any:
    """Return layers whose outputs vary by about `scale`, as a `Policy` has them."""
    generator = np.random.default_rng(seed)
    return tuple(
        (
            generator.normal(scale=scale * n**-0.5, size=(n, m)).astype("f4"),
            generator.normal(size=m).astype("f4"),
        )
        for n, m in zip(widths[:-1], widths[1:], strict=True)
    )
