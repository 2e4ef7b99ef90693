"""The compiled engine: PPO with Stable-Baselines3's arithmetic, many times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`learner.py`, `update.py`); Python only
passes arrays from one to the other. The runs of a group are trained one after another by the same programs,
which are compiled once. Computing them at the same time would not be faster on one core, and this way no run
can depend on another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from pneuma.config import Run
from pneuma.engines.base import OnUpdate, Result
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.loop import train_run
from pneuma.engines.records import Checkpoint


def train(
    runs: Sequence[Run], checkpoints: Mapping[int, Checkpoint], on_update: OnUpdate
) -> Iterator[Result]:
    """Train every run, one after the other; see `pneuma.engines.base`."""
    for index, run in enumerate(runs):
        yield train_one(run, on_update, checkpoints.get(index))


def train_one(
    run: Run, on_update: OnUpdate, checkpoint: Checkpoint | None = None, evaluated: bool = True
) -> Result:
    """Train one run; see `pneuma.engines.loop`."""
    return train_run(run, BatchedTrainer(run), on_update, checkpoint, evaluated)
