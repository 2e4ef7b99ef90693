"""A search whose runs are a formula, so that its trials can be worked out without training."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial

from pneuma.search import spec, trials, values
from pneuma.search.log import STATES, Record
from pneuma.search.spec import Budget, Search, load_search
from pneuma.search.trials import Train, run_search
from pneuma.store.store import Store
from pneuma.study.plan import Cell, Plan
from pneuma.training.execute import CellResult

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


MEDIAN = '[pruner]\nname = "median"\nn_startup_trials = 2\n'


def open_log(path: Path) -> optuna.Study:
    """Return the log of the search `formula` as Optuna opens it."""
    return optuna.load_study(study_name="formula", storage=JournalStorage(JournalFileBackend(str(path))))


def height(cell: Cell) -> float:
    """Return 1 at a learning rate of 1e-3 with tanh, less elsewhere; a little more for odd seeds."""
    distance = abs(math.log10(cell.run.learning_rate) + 3)
    return 1 - 0.2 * distance - 0.1 * (cell.run.activation == "relu") + 0.01 * (cell.run.seed % 2)


@dataclass(frozen=True)
class FormulaRow:
    """The row of a run that nobody trained, at a step."""

    cell: Cell
    step: int
    status: str


@dataclass
class Formula:
    """What runs come to: at their end as `value` says, and before that less, evenly."""

    value: Callable[[Cell], float] = height
    status: str = "done"

    def read_rows(self, store: Store, cells: Sequence[Cell], step: int | None = None) -> list[FormulaRow]:
        """Replace `read_rows`."""
        return [FormulaRow(cell, step or cell.run.steps, self.status) for cell in cells]

    def outcome(self, row: FormulaRow, name: str) -> float:
        """Replace `outcome`."""
        return self.value(row.cell) * row.step / row.cell.run.steps


@pytest.fixture
def formula(monkeypatch: pytest.MonkeyPatch) -> Iterator[Formula]:
    """What runs come to in place of training; a test may change it."""
    formula = Formula()
    monkeypatch.setattr(trials, "read_rows", lambda *args: formula.read_rows(*args))
    monkeypatch.setattr(values, "outcome", lambda *args: formula.outcome(*args))
    yield formula


@dataclass(frozen=True)
class Task:
    """A search with its budget; what it comes to in a results folder."""

    search: Search
    budget: Budget
    asked: list[Mapping[str, int]] = field(default_factory=list)
    """How far runs were to be trained, by id, in each round."""
    notes: list[str] = field(default_factory=list)

    def train(self, plan: Plan, until: Mapping[str, int]) -> list[CellResult]:
        """Note what is to be trained."""
        self.asked.append(until)
        return []

    def record(self, store: Store | None = None, train: Train | None = None) -> Record:
        """Run the search, by default in a new folder."""
        store = store or Store(Path(mkdtemp()))
        *_, record = run_search(self.search, self.budget, store, train or self.train, self.notes.append)
        return record

    def solve(self, store: Store | None = None, train: Train | None = None) -> list[dict[str, Any]]:
        """Run the search, and return its trials up to its budget."""
        ended = self.record(store, train).ended
        return [comparable(trial) for trial in ended if trial.number < self.budget.trials]


def comparable(trial: FrozenTrial) -> dict[str, Any]:
    """Return what a search comes to in a trial, without identities and times."""
    return {
        "number": trial.number,
        "params": trial.params,
        "state": STATES[trial.state],
        "values": tuple(trial.values or ()),
        "run_ids": tuple(trial.user_attrs["run_ids"]),
        "reports": trial.intermediate_values,
        "note": trial.user_attrs.get("note", ""),
    }


MakeTask = Callable[..., Task]


@pytest.fixture
def make_task(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, formula: Formula) -> MakeTask:
    """Return a function that makes a task of the formula search, whose file is in the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(trials, "check_environments", lambda runs: None)
    monkeypatch.setattr(spec, "CORNERS", 16)  # of so small a space these are enough, and soon looked at

    def make(count: int = 8, more: str = "", second: str = "", start: str = "", **budget: Any) -> Task:
        Path("formula.toml").write_text(SPACE.format(more=more, second=second, start=start))
        size = {"trials": count, "seeds": (1000, 1001), "steps": 2048, **budget}
        return Task(load_search("formula", None if "env = " in more else "text"), Budget(**size))

    return make
