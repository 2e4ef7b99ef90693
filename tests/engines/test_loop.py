"""A run from update to update, with a trainer that learns nothing and writes down what it was asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.base import EVALUATIONS, Progress
from pneuma.engines.loop import train_run
from pneuma.engines.policy import Policy
from pneuma.engines.records import Checkpoint, Records

UPDATES = 2 * EVALUATIONS
HORIZON = 64
POLICY = Policy("tanh", ((np.zeros((1, 1), np.float32), np.zeros(1, np.float32)),), ())


class Diary:
    """Takes updates, of which one may lose its numbers."""

    def __init__(self, diverges: int = 0) -> None:
        self.restored: list[int] = []
        self.judged: list[int] = []
        self._diverges = diverges

    def restore(self, checkpoint: Checkpoint) -> None:
        self.restored.append(checkpoint.step)

    def update(self, before: int, after: int, records: Records) -> bool:
        records.metrics.append({"step": after, "before": before})
        return after != self._diverges

    def evaluate(self, step: int) -> dict[str, Any]:
        self.judged.append(step)
        return {"step": step}

    def policy(self) -> Policy:
        return POLICY

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        return Checkpoint(step, {}, {}, records.copy())


def run_of(**settings: object) -> Run:
    return make_run({"horizon": HORIZON, "minibatch": HORIZON, "steps": UPDATES * HORIZON, **settings})


def until(stop: int = 0) -> tuple[list[Checkpoint], Any]:
    """Return checkpoints to come, and what takes one after every update until it stops the run."""
    taken: list[Checkpoint] = []

    def on_update(progress: Progress) -> bool:
        taken.append(progress.checkpoint())
        return progress.step != stop

    return taken, on_update


def test_a_run_is_judged_evenly_and_at_its_end() -> None:
    diary = Diary()
    taken, on_update = until()
    result = train_run(run_of(), diary, on_update)
    assert (result.status, result.step, result.policy) == ("done", UPDATES * HORIZON, POLICY)
    assert diary.judged == [2 * HORIZON * k for k in range(1, EVALUATIONS + 1)]
    assert [row["step"] for row in result.records.evaluations] == diary.judged
    assert [checkpoint.step for checkpoint in taken] == [HORIZON * k for k in range(1, UPDATES + 1)]
    assert [row["before"] for row in result.records.metrics] == [HORIZON * k for k in range(UPDATES)]
    assert not train_run(run_of(), Diary(), until()[1], evaluated=False).records.evaluations


@pytest.mark.parametrize(("at", "status"), [(3, "stopped"), (UPDATES, "done")])
def test_it_stops_where_it_is_asked_to(at: int, status: str) -> None:
    result = train_run(run_of(), Diary(), until(at * HORIZON)[1])
    assert (result.status, result.step, result.policy) == (status, at * HORIZON, POLICY)


def test_a_run_that_lost_its_numbers_ends_there_unjudged_and_without_a_policy() -> None:
    diary = Diary(diverges=2 * HORIZON)
    taken, on_update = until()
    result = train_run(run_of(), diary, on_update)
    assert (result.status, result.step, result.policy) == ("diverged", 2 * HORIZON, None)
    assert len(result.records.metrics) == 2 and len(taken) == 1 and not diary.judged
