"""Trainings in this process, whatever the engine, and the bits that they end with."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import torch

from pneuma.config import Run
from pneuma.engines.loop import Progress, Result, train_run
from pneuma.engines.records import Checkpoint
from pneuma.study.checkpoints import TABLES, decode, encode
from pneuma.study.tables import to_parquet

SMALL: dict[str, Any] = {
    "actor": (8,), "critic": (12,), "horizon": 64, "minibatch": 32, "epochs": 2, "steps": 384,
    "evaluation_episodes": 2, "episode_steps": 60,
}  # fmt: skip
"""A run as short as can be. The engine `batched` compiles a program for each optimizer, shape and number of
steps an update, which takes longer than all that it trains here: tests of other slots or players take a
shorter horizon, so that an update has 64 steps all the same."""


def train(run: Run, checkpoint: Checkpoint | None = None) -> tuple[Result, list[Checkpoint]]:
    """Train a run; return its end and a checkpoint of every update."""
    taken: list[Checkpoint] = []

    def keep(progress: Progress) -> bool:
        assert progress.checkpoint
        taken.append(progress.checkpoint())
        return True

    return train_run(run, keep, checkpoint), taken


@lru_cache(maxsize=32)
def train_once(run: Run) -> tuple[Result, list[Checkpoint]]:
    """Train a run for all tests that only look at what it gave, which none of them may change."""
    return train(run)


def bits(result: Result) -> tuple[object, ...]:
    """Return all that a run ends with; as Parquet, where NaN equals NaN."""
    assert result.policy is not None
    tables = [to_parquet(getattr(result.records, name), columns) for name, columns in TABLES.items()]
    return result.status, result.step, tables, result.policy.to_bytes()


def check_that_it_goes_on(run: Run, *places: int) -> None:
    """Check that a run that goes on from a checkpoint, as a file, ends as if it had never stopped."""
    whole, taken = train_once(run)
    assert whole.status == "done"
    for checkpoint in (taken[place] for place in places):
        np.random.seed(1)
        torch.manual_seed(1)  # whatever other runs drew meanwhile
        resumed, _ = train(run, decode(encode(checkpoint, {}, ""))[0])
        assert bits(resumed) == bits(whole), checkpoint.step
