"""A search whose runs are a formula, so that its trials can be worked out without training."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import mkdtemp
from types import SimpleNamespace
from typing import Any

import pytest
from optuna.trial import FrozenTrial

from pneuma.search.record import STATES, Record, Task, begin_record
from pneuma.search.spec import Budget, load_search
from pneuma.search.trials import conduct
from pneuma.search.values import Outcomes
from pneuma.store.store import Store
from pneuma.study.plan import Cell, Plan

SPACE = """
title = "A formula"
base = "table-6-2"
generation = 4
{start}

[objectives.height]
outcome = "final-share-killed"
over_seeds = "mean"
{second}

[space.learning_rate]
low = 1e-5
high = 1e-2
log = true

[space.activation]
choices = ["tanh", "relu"]

{more}

[presets.quick]
trials = 8
seeds = 2
steps = 2048
"""


MakeTask = Callable[..., Task]
ReadOutcome = Callable[[Cell, str], float]


def height(cell: Cell, outcome: str) -> float:
    """Return 1 at a learning rate of 1e-3 with tanh, less elsewhere; a little more for odd seeds."""
    run = cell.run
    distance = abs(math.log10(run.learning_rate) + 3)
    return 1 - 0.2 * distance - 0.1 * (run.activation == "relu") + 0.01 * (run.seed % 2)


class Formula(Outcomes):
    """Outcomes of runs that nobody trained."""

    def __init__(self, read: ReadOutcome = height, diverged: bool = False) -> None:
        self._read, self._diverged = read, diverged

    def read(self, cell: Cell, name: str) -> float:
        """Return what the formula says."""
        return self._read(cell, name)

    def read_early(self, cell: Cell, name: str, steps: Sequence[int]) -> list[float]:
        """Return a curve that rises evenly to what the formula says at the end."""
        return [self._read(cell, name) * step / cell.run.steps for step in steps]

    def diverged(self, cell: Cell) -> bool:
        """Return the same of every run."""
        return self._diverged


def told_of(trials: Iterable[FrozenTrial]) -> list[Any]:
    """Return what a search comes to in each trial, without identities and times."""
    return [
        SimpleNamespace(
            number=trial.number,
            params=trial.params,
            state=STATES[trial.state],
            values=tuple(trial.values or ()),
            run_ids=tuple(trial.user_attrs["run_ids"]),
            reports=trial.intermediate_values,
            note=trial.user_attrs.get("note", ""),
        )
        for trial in trials
    ]


def task_of(found: Record) -> Task:
    return Task(found.search, found.budget)


def record(
    task: Task, outcomes: Formula | None = None, asked: list[Mapping[str, int]] | None = None
) -> Record:
    """Conduct a task on the formula in a new folder; a list gets how far runs are trained."""

    def train(plan: Plan, until: Mapping[str, int]) -> None:
        if asked is not None:
            asked.append(until)

    path = Path(mkdtemp()) / "formula.log"
    found = begin_record(path, task, Store(path.parent))
    for _ in conduct(found, train, outcomes or Formula(), lambda note: None):
        pass
    return found


def solve(task: Task, **how: Any) -> list[Any]:
    """Return the trials of a task on the formula; see `record`."""
    return told_of(record(task, **how).trials)


@pytest.fixture
def make_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> MakeTask:
    """Return a function that makes a task of the formula search, whose file is in the current folder."""
    monkeypatch.chdir(tmp_path)

    def make(trials: int = 8, more: str = "", second: str = "", start: str = "") -> Task:
        Path("formula.toml").write_text(SPACE.format(more=more, second=second, start=start))
        world = None if "env = " in more else "text"
        return Task(load_search("formula", world), Budget(trials=trials, seeds=(1000, 1001), steps=2048))

    return make
