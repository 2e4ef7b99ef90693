"""The training loop that all engines share: update, evaluate, report, and stop.

    run → trainer (its engine's) → update, judge, tell → result

An engine is a `Trainer`. Evaluation, divergence, stopping and the end of a run are the same for all engines.
"""

from __future__ import annotations

from functools import partial
from importlib import import_module
from typing import Protocol

from pneuma.config import Run
from pneuma.engines.base import OnUpdate, Progress, Result, evaluation_updates
from pneuma.engines.policy import Policy
from pneuma.engines.records import Checkpoint, Records, Row

TRAINERS = {
    "batched": "pneuma.engines.batched.training:BatchedTrainer",
    "sb3": "pneuma.engines.sb3:Sb3Trainer",
    "tabular": "pneuma.engines.tabular:TableTrainer",
}
"""The trainer of each of `pneuma.config.ENGINES`, imported when it trains, as most are heavy."""


class Trainer(Protocol):
    """An engine's part in training one run, from which it is made."""

    def restore(self, checkpoint: Checkpoint) -> None:
        """Resume from the run's own checkpoint, or start from its parent's if `begins_fork`.

        Raises:
            CheckpointError: for a checkpoint that does not fit.
        """
        ...

    def update(self, before: int, after: int, records: Records) -> bool:
        """Do the update between two agent steps and record it.

        Returns:
            Whether all numbers are still finite.
        """
        ...

    def evaluate(self, step: int) -> Row:
        """Evaluate the current policy; return a row of evaluations."""
        ...

    def policy(self) -> Policy:
        """Return the current policy."""
        ...

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        """Copy everything that the next update depends on."""
        ...


def train_run(run: Run, on_update: OnUpdate, checkpoint: Checkpoint | None = None) -> Result:
    """Train a run, from its start or from a checkpoint.

    Raises:
        CheckpointError: for a checkpoint from which the engine cannot resume.
    """
    trainer, records, step = _make_trainer(run), Records(), 0
    if checkpoint:
        trainer.restore(checkpoint)
        step = checkpoint.step
        if not begins_fork(run, checkpoint):
            records = checkpoint.records.copy()
    judged = evaluation_updates(run)
    for update in range(step // run.steps_per_update + 1, run.updates + 1):
        before, step = step, update * run.steps_per_update
        if not trainer.update(before, step, records):
            return Result("diverged", step, records, None)
        if update in judged:
            records.evaluations.append(trainer.evaluate(step))
        if not on_update(Progress(step, records, partial(trainer.checkpoint, step, records))):
            status = "done" if update == run.updates else "stopped"
            return Result(status, step, records, trainer.policy())
    return Result("done", step, records, trainer.policy())


def _make_trainer(run: Run) -> Trainer:
    module, name = TRAINERS[run.engine].split(":")
    trainer: Trainer = getattr(import_module(module), name)(run)
    return trainer


def begins_fork(run: Run, checkpoint: Checkpoint) -> bool:
    """Return whether a checkpoint is the parent's, from which the run begins as a fork."""
    return bool(run.parent) and checkpoint.step == run.fork_step
