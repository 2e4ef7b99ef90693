"""The compiled engine: PPO with Stable-Baselines3's arithmetic, many times as fast.

A rollout is one compiled call (`rollout.py`) and an update two (`learner.py`, `update.py`); Python only
passes arrays from one to the other. A group's runs are trained one after another by the same programs,
which are compiled once: on a processor's core nothing is gained by computing them side by side, and
this way no run can depend on its neighbours.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

from pneuma.config import Run
from pneuma.engines.base import OnUpdate, Result
from pneuma.engines.batched.state import begin_fork, restore_checkpoint, take_checkpoint
from pneuma.engines.batched.training import Training, learner_rows, mean_metrics
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.loop import begins_fork, train_run
from pneuma.engines.policy import Policy
from pneuma.engines.records import Records, Row
from pneuma.engines.team import Team


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


class BatchedTrainer:
    """Trains one run by compiled programs; see `pneuma.engines.loop.Trainer`."""

    def __init__(self, run: Run) -> None:
        self.run = run
        self._training = Training(run)

    @cached_property
    def _evaluation(self) -> Evaluation:
        return Evaluation(self.run)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint, or begin as the fork of a parent's."""
        begin = begin_fork if begins_fork(self.run, checkpoint) else restore_checkpoint
        begin(self._training, checkpoint)

    def update(self, before: int, after: int, records: Records) -> bool:
        """Collect one horizon, and learn from it."""
        told, episodes = self._training.update(before)
        records.metrics.append({"step": after, **mean_metrics(told)})
        records.learners.extend(learner_rows(after, told))
        records.episodes.extend(episodes)
        if not self._training.is_finite(told):
            return False
        is_last = after == self.run.updates * self.run.steps_per_update  # what overflows shows in the next
        return not (is_last and self._training.overflows())

    def evaluate(self, step: int) -> Row:
        """Let the policy play where it was not trained."""
        return self._evaluation.evaluate(self.policy(), step)

    def policy(self) -> Policy | Team:
        """Return the policy, or the players'."""
        return self._training.policy()

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        """Copy networks, optimizer, worlds and random streams."""
        return take_checkpoint(self._training, step, records)
