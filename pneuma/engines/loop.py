"""The training loop that all engines share, and the contract between engines and studies.

    run → trainer (its engine's) → update, evaluate, report → result

An engine is a `Trainer`. Evaluation, divergence, stopping and the end of a run are the same for all engines.

`train_run` trains a run by its engine and returns a `Result`. After every update it calls `on_update` with a
`Progress`; if that returns false, the training stops there. A run's result depends on the run alone, not on
runs that the same process trained before.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pneuma.config import Run, is_gymnasium_id, is_resumable
from pneuma.engines.records import Checkpoint, CheckpointError, Records, Row
from pneuma.engines.shared_generators import evaluation_generators, seed_shared_generators
from pneuma.engines.stopping import IsStopping, Stopped, never

if TYPE_CHECKING:
    from pneuma.engines.policy import SavedPolicy  # commands that read runs compile no networks

TRAINERS = {
    "batched": "pneuma.engines.batched.training:BatchedTrainer",
    "sb3": "pneuma.engines.sb3:Sb3Trainer",
}
"""The trainer of each of `pneuma.config.ENGINES`, imported when it trains, as most are heavy."""
OPEN_TRAINER = "pneuma.engines.sb3_open:OpenTrainer"

EVALUATIONS, EPISODES = 20, 50
"""Evaluations per run, and the default number of episodes of each."""
SHORT_STEPS, SHORT_STEPS_ELSEWHERE = 100_000, 1_000_000
"""A run of fewer steps, in Pneuma's worlds and in others, is short: see `_most_evaluations`."""
EVALUATE_EVERY, EVALUATE_EVERY_ELSEWHERE = 8_000, 20_000
SHORT_EPISODES, LEAST_STEPS = 10, 5_000


@dataclass(frozen=True)
class Progress:
    """The state of one run after an update, at an agent step counted over all slots.

    The engine continues to add to the records. `checkpoint` takes one; call it before the next update. It is
    None if the run cannot be resumed.
    """

    step: int
    records: Records
    checkpoint: Callable[[], Checkpoint] | None
    evaluation_seconds: float = 0.0  # so far, of this call of `train_run`


@dataclass(frozen=True)
class Result:
    """The end of a run, at an agent step counted over all slots."""

    status: str
    """done; diverged, if a loss, gradient, parameter or logit was not finite; or stopped by `on_update`."""
    step: int
    records: Records
    policy: SavedPolicy | None  # the last one; None when it is not finite


OnUpdate = Callable[[Progress], bool]


class Trainer(ABC):
    """An engine's part in training one run, from which it is made."""

    def __init__(self, run: Run, is_stopping: IsStopping = never) -> None:
        self.run, self.is_stopping = run, is_stopping

    @cached_property
    def _evaluation(self) -> Any:
        run = replace(self.run, evaluation_episodes=evaluation_episodes(self.run))
        if is_gymnasium_id(run.env):  # each is imported only when it is needed
            from pneuma.engines.gymnasium_evaluation import Evaluation as EvaluationInGymnasium

            return EvaluationInGymnasium(run, _most_steps(self.run), self.is_stopping)
        from pneuma.engines.evaluation import Evaluation

        return Evaluation(run, self.is_stopping)

    @abstractmethod
    def evaluate(self, step: int) -> Row:
        """Return one row of `EVALUATION_COLUMNS` for the current policy, whose evaluation is at `step`."""

    @abstractmethod
    def update(self, before: int, after: int, records: Records) -> bool:
        """Do the update between two agent steps and record it; return whether all numbers are finite."""

    @abstractmethod
    def policy(self) -> SavedPolicy:
        """Return the current policy."""


class ResumableTrainer(Trainer):
    """A trainer that can save and restore the complete state of its run, in Pneuma's worlds or others."""

    def evaluate(self, step: int) -> Row:
        if self.run.xp_scope == "forever":  # which other environments do not have
            return self._evaluation.evaluate(self.policy(), step, self.training_xp())
        return self._evaluation.evaluate(self.policy(), step)

    @abstractmethod
    def training_xp(self) -> np.ndarray:
        """Return the XP of each player of each of Pneuma's worlds in which it trains, (N, P)."""

    @abstractmethod
    def restore(self, checkpoint: Checkpoint) -> None:
        """Resume from a checkpoint of the run.

        Raises:
            Exception: if another version of Pneuma wrote it, or the environment reaches another state.
        """

    @abstractmethod
    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        """Copy everything that the next update depends on."""


def train_run(
    run: Run, on_update: OnUpdate, checkpoint: Checkpoint | None = None, is_stopping: IsStopping = never
) -> Result:
    """Train a run, from its start or from a checkpoint of it.

    Args:
        run: the run.
        on_update: called after each update; training stops if it returns false.
        checkpoint: where to resume.
        is_stopping: whether `on_update` will return false; it ends an evaluation, which the checkpoint of its
            update then lacks, and the whole run if it cannot be resumed.

    Raises:
        CheckpointError: if training cannot resume from the checkpoint.
    """
    module_name, class_name = (TRAINERS[run.engine] if is_resumable(run) else OPEN_TRAINER).split(":")
    trainer_class = getattr(import_module(module_name), class_name)
    seed_shared_generators(run)  # after an import, which may draw
    trainer: Trainer = trainer_class(run, is_stopping)
    records = Records()
    step = 0
    if checkpoint and isinstance(trainer, ResumableTrainer):
        step = checkpoint.step
        try:
            trainer.restore(checkpoint)
        except (KeyError, ValueError, TypeError, RuntimeError) as error:
            raise CheckpointError(f"cannot go on from step {step:,}: {error}") from None
        records = checkpoint.records.copy()
    evaluation_steps = {evaluation.updates: evaluation.step for evaluation in planned_evaluations(run)}
    evaluation_seconds = 0.0
    update, has_trained = step // run.steps_per_update, False
    while True:
        is_evaluated = True
        if update in evaluation_steps and not _has_evaluation(records, evaluation_steps[update]):
            started = time.perf_counter()
            try:
                with evaluation_generators(run):
                    records.evaluations.append(trainer.evaluate(evaluation_steps[update]))
            except Stopped:
                is_evaluated = False
            evaluation_seconds += time.perf_counter() - started
        if has_trained or not is_evaluated:
            checkpoint_now = None
            if isinstance(trainer, ResumableTrainer):
                checkpoint_now = partial(trainer.checkpoint, step, records)
            if not on_update(Progress(step, records, checkpoint_now, evaluation_seconds)):
                status = "done" if update == run.updates and is_evaluated else "stopped"
                return Result(status, step, records, trainer.policy())
        if update == run.updates:
            return Result("done", step, records, trainer.policy())
        update, has_trained = update + 1, True
        previous_step, step = step, update * run.steps_per_update
        try:
            if not trainer.update(previous_step, step, records):
                return Result("diverged", step, records, None)
        except Stopped:
            return Result("stopped", previous_step, records, None)


def _has_evaluation(records: Records, step: int) -> bool:
    """Return whether records that a run resumes with have the evaluation at this step; see `Stopped`."""
    return bool(records.evaluations) and records.evaluations[-1]["step"] == step


class PlannedEvaluation(NamedTuple):
    """An evaluation that a run will have.

    Attributes:
        number: of `EVALUATIONS`, the last one's.
        step: the agent step at which it is.
        updates: the number of updates of the policy that is evaluated.
    """

    number: int
    step: int
    updates: int


def planned_evaluations(run: Run) -> list[PlannedEvaluation]:
    """Return a run's evaluations in order, at even steps up to its budget, whatever an update's length.

    At each is evaluated the policy that acts at that step: the one after all updates that have ended by then.
    So two of them have different policies. A run of a single update is evaluated once, after it.
    """
    count = min(_most_evaluations(run), run.updates)
    evaluations = []
    for k in range(1, count + 1):
        step = run.steps * k // count
        updates = step // run.steps_per_update
        if run.updates == 1:
            updates = 1
        evaluations.append(PlannedEvaluation(EVALUATIONS * k // count, step, updates))
    return evaluations


def evaluation_episodes(run: Run) -> int:
    """Return how many episodes an evaluation plays with sampled actions."""
    if _is_short(run) and run.evaluation_episodes == EPISODES and run.updates > _most_evaluations(run):
        return SHORT_EPISODES
    return run.evaluation_episodes


def _most_evaluations(run: Run) -> int:
    """Return how many evaluations a run has if it has as many updates: 20, unless it is short.

    A short run has one, and one more for each 8,000 steps (20,000 in others' environments), so that they
    take little of its time. One of under 5,000 steps in Pneuma's worlds, which takes a second in
    any case, has ten.
    """
    if not _is_short(run):
        return EVALUATIONS
    steps_between = EVALUATE_EVERY_ELSEWHERE
    if not is_gymnasium_id(run.env):
        steps_between = EVALUATE_EVERY
        if run.steps < LEAST_STEPS:
            return EVALUATIONS // 2
    return min(1 + run.steps // steps_between, EVALUATIONS)


def _most_steps(run: Run) -> float:
    """Return how many steps one evaluation may take where the length of episodes is not known.

    All of them take at most a fifth of a run's steps if its episodes remain as long as the random player's,
    unless a study sets their episodes. Of its time they take less, because nothing is learned in them.
    """
    if not has_limited_evaluations(run):
        return math.inf
    return run.steps / 4 / (1 + _most_evaluations(run))  # one more for the random player


def has_limited_evaluations(run: Run) -> bool:
    return is_gymnasium_id(run.env) and run.evaluation_episodes == EPISODES


def _is_short(run: Run) -> bool:
    if is_gymnasium_id(run.env):  # where each step of an episode is Python
        return run.steps < SHORT_STEPS_ELSEWHERE and run.evaluation_episodes == EPISODES
    return run.steps < SHORT_STEPS
