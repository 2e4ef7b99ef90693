"""The contract between engines and studies.

`loop.train_run` trains a run by its engine and returns a `Result`. After every update it calls `on_update`
with a `Progress`; if that returns false, the training stops there. A run's result depends on the run alone,
not on runs that the same process trained before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pneuma.config import Run
from pneuma.engines.policy import Policy
from pneuma.engines.records import Checkpoint, Records

EVALUATIONS = 20
"""Evaluations per run."""


@dataclass(frozen=True)
class Progress:
    """The state of one run after an update.

    Attributes:
        step: agent steps trained, over all slots.
        records: all records so far; the engine continues to add to them.
        checkpoint: a function that takes a checkpoint; call it before the next update.
    """

    step: int
    records: Records
    checkpoint: Callable[[], Checkpoint]


@dataclass(frozen=True)
class Result:
    """The end of a run.

    Attributes:
        status: 'done'; 'diverged' if a loss, gradient, parameter or logit was not finite; or 'stopped' by
            `on_update`.
        step: agent steps trained, over all slots.
        records: all records of the run.
        policy: the last policy; None when it is not finite.
    """

    status: str
    step: int
    records: Records
    policy: Policy | None


OnUpdate = Callable[[Progress], bool]


def evaluation_updates(run: Run) -> set[int]:
    """Return the updates, counted from 1, after which a run is evaluated.

    They are evenly spread and include the last update. A run of fewer than `EVALUATIONS` updates has fewer.
    """
    return _spread(run.updates, EVALUATIONS)


def checkpoint_steps(run: Run, count: int) -> set[int]:
    """Return the agent steps at which a run's checkpoints are kept; none if `count` is 0.

    That is after `count` evenly spread updates with the last one, and after the first one, so that a run can
    be forked even if it collapses early.
    """
    first = {1} if count else set()
    return {update * run.steps_per_update for update in first | _spread(run.updates, count)}


def _spread(updates: int, count: int) -> set[int]:
    """Return `count` evenly spread numbers from 1 to `updates`, including the last."""
    return {-(-updates * k // count) for k in range(1, count + 1)}
