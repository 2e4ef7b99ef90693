"""The compiled engine: PPO with Stable-Baselines3's arithmetic, many times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`learner.py`, `update.py`); Python only
passes arrays from one to the other. Runs of equal shapes use the same programs, which a process compiles
once. Computing several runs at the same time would not be faster on one core, and this way no run can depend
on another.
"""

from __future__ import annotations

from pneuma.config import Run
from pneuma.engines.base import OnUpdate, Result
from pneuma.engines.batched.training import BatchedTrainer
from pneuma.engines.loop import train_run
from pneuma.engines.records import Checkpoint


def train(
    run: Run, on_update: OnUpdate, checkpoint: Checkpoint | None = None, evaluated: bool = True
) -> Result:
    """Train a run; see `pneuma.engines.base.Engine`."""
    return train_run(run, BatchedTrainer(run), on_update, checkpoint, evaluated)
