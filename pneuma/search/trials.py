"""The loop of a search: generations of trials are suggested together, trained, and reported in order.

A search is a function of its file, its budget and the outcomes of its runs. Every call replays it from the
first trial: stored runs are read, the others are trained. So after a kill it continues with the same
suggestions, and needs no state that a kill could damage.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import optuna

from pneuma.analysis.frames import FinishedRun, StudyData
from pneuma.analysis.outcomes import find_outcome, outcome
from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run, as_fields, make_run
from pneuma.errors import UserError
from pneuma.search.optuna_study import STATES, ask, create_study, ended_study
from pneuma.search.spec import OVER_SEEDS, Budget, Median, Objective, Pruner, Search
from pneuma.study.identity import contents, run_id
from pneuma.study.measure import stored_row
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.spec import Study
from pneuma.study.store import Store

RUNG_FACTOR = 3
"""By which a rung is longer than the one before; the usual one of successive halving (Li et al. 2018)."""

Train = Callable[[Plan], None]
"""Trains a plan's missing runs; raises `Unfinished` if a run did not finish."""


class Unfinished(Exception):
    """A run did not finish, so that its trial has no value and the search cannot go on."""


@dataclass(frozen=True)
class Task:
    """A search with its budget.

    Attributes:
        search: its file.
        budget: trials, seeds and steps.
        over: fields that replace those of the file.
    """

    search: Search
    budget: Budget
    over: Mapping[str, Any] = field(default_factory=dict)

    @property
    def identity(self) -> dict[str, Any]:
        """Return everything that the suggestions depend on, except the number of trials."""
        search = self.search
        values = [{key: value} for key, each in search.space.all_values().items() for value in each]
        code = [*filter(None, map(contents, values))]
        return {
            **({"contents": code} if code else {}),
            "base": search.space.base,
            "fixed": search.space.fixed,
            "space": [parameter.identity for parameter in search.space.parameters],
            "objectives": [objective.model_dump() for objective in search.objectives],
            "start": search.first_trials,
            "generation": search.spec.generation,
            "sampler": search.spec.sampler.model_dump(),
            "pruner": search.spec.pruner.model_dump(),
            "seeds": self.budget.seeds,
            "steps": self.budget.steps,
            "optuna": optuna.__version__,
            "rules": RULES_VERSION,
            "engines": ENGINE_VERSIONS,
        }

    @property
    def digest(self) -> str:
        text = json.dumps(self.identity, sort_keys=True, default=list)
        return hashlib.sha256(text.encode()).hexdigest()[:12]


@dataclass(frozen=True)
class EndedTrial:
    """A trial that has ended.

    Attributes:
        number: from 0, in the order of suggestion.
        params: the suggested values.
        state: 'complete'; 'pruned', if it was stopped early; 'failed', if it has no value.
        values: one for each objective; for a pruned trial, those at its last rung.
        run_ids: of its runs, those at its rungs first.
        rungs: the value by which it was compared at each rung; NaN if it had none.
        note: why it failed, or that one of its runs diverged.
    """

    number: int
    params: Mapping[str, Any]
    state: str
    values: tuple[float, ...]
    run_ids: tuple[str, ...]
    rungs: Mapping[int, float]
    note: str = ""


@dataclass
class _PendingTrial:
    """A trial that has not ended; `longest` are the cells of its longest training."""

    trial: optuna.Trial
    params: Mapping[str, Any]
    run: Run | None = None
    note: str = ""
    pruned: bool = False
    cells: list[Cell] = field(default_factory=list)
    longest: list[Cell] = field(default_factory=list)
    rungs: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcomes:
    """Reads outcomes of stored runs as a search counts them.

    A diverged run counts with the worst possible value of the outcome, or with its last recorded value if the
    outcome has no bound.
    """

    task: Task
    store: Store

    def read(self, cell: Cell, name: str) -> float:
        """Return an outcome of a finished run; NaN if it has none."""
        if self.diverged(cell):
            minimized = any(
                (one.outcome, one.direction) == (name, "minimize") and one.over_seeds != "deviation"
                for one in self.task.search.objectives
            )
            worst = find_outcome(name).bounds[minimized]
            if np.isfinite(worst):
                return float(worst)
        run = FinishedRun(cell.condition, cell.seed, stored_row(self.store, cell.run_id))
        title = self.task.search.title
        data = StudyData(title, title, title, cell.condition, {cell.condition: as_fields(cell.run)}, [run])
        return outcome(data, run, name)

    def diverged(self, cell: Cell) -> bool:
        return self.store.status(cell.run_id).name == "diverged"


def conduct(task: Task, train: Train, outcomes: Outcomes) -> Iterator[list[EndedTrial]]:
    """Search, and yield the trials of each generation when they have ended.

    Args:
        task: the search and its budget.
        train: trains the runs of a plan that are not stored.
        outcomes: reads the outcomes of the runs.

    Raises:
        Unfinished: when a run crashed.
    """
    search, budget = task.search, task.budget
    rungs, first_trials = rung_steps(search.spec.pruner, budget), search.first_trials
    study = create_study(search)
    trained: list[Cell] = []

    for first in range(0, budget.trials, search.spec.generation):
        asked = [_PendingTrial(*ask(study, search, first_trials)) for _ in range(search.spec.generation)]
        asked = asked[: budget.trials - first]
        for each in asked:
            try:
                each.run = search.space.make_run(each.params, steps=budget.steps)
            except UserError as error:
                each.note = str(error)
        for rung, steps in rungs.items():
            _train_rung(task, steps, asked, trained, train)
            if len(rungs) > 1:
                _report(search.objectives[0], rung, asked, outcomes)
                if isinstance(search.spec.pruner, Median) and rung < len(rungs):
                    _prune(study, search, rung, search.spec.pruner.startup_trials, asked)
        yield [_tell(study, search.objectives, each, outcomes) for each in asked]


def rung_steps(pruner: Pruner, budget: Budget) -> dict[int, int]:
    """Return the steps of the trainings after which trials are compared, by rung from 1 on.

    Each rung is a separate training with all seeds, as a run's steps are part of its id. So the first are
    short: of three rungs 1/9 and 1/3 of the budget. The last has the whole budget.
    """
    if not isinstance(pruner, Median):
        return {1: budget.steps}
    rungs = range(1, pruner.rungs + 1)
    return {rung: max(1, round(budget.steps / RUNG_FACTOR ** (pruner.rungs - rung))) for rung in rungs}


def make_trial_plan(task: Task, cells: Sequence[Cell]) -> Plan:
    """Return the runs of trials as the plan of a study, which can be exported and drawn."""
    name = f"search-{task.search.label}"
    study = Study(
        name=name,
        path=None,
        title=task.search.title,
        section=task.search.spec.section,
        about=task.search.spec.about,
        figure=name,
        baseline=cells[0].condition,
        base=task.search.space.base,
        conditions={cell.condition: {} for cell in cells},
        world=task.search.world,
    )
    return Plan(study, Selection(seeds=task.budget.seeds), tuple(cells), (), ())


def _train_rung(
    task: Task, steps: int, asked: list[_PendingTrial], trained: list[Cell], train: Train
) -> None:
    """Train all remaining trials for so many steps; `trained` receives their cells."""
    for each in asked:
        if each.run is None or each.pruned:
            continue
        run = make_run({**as_fields(each.run), "steps": steps})
        whole = run.steps == each.run.steps
        name = f"trial-{each.trial.number:03}" + ("" if whole else f" at {run.steps}")
        runs = [replace(run, seed=seed) for seed in task.budget.seeds]
        each.longest = [Cell(name, one.seed, one, run_id(one)) for one in runs]
        cells = [cell for cell in each.longest if cell not in each.cells]  # two rungs round up to one budget
        each.cells += cells
        trained += cells
    if trained:
        train(make_trial_plan(task, trained))


def _report(sought: Objective, rung: int, asked: list[_PendingTrial], outcomes: Outcomes) -> None:
    """Report the value at a rung of each trial that was trained to it."""
    for each in asked:
        if each.run is not None and not each.pruned:
            each.rungs[rung] = value = objective_value(sought, each.longest, outcomes)
            if np.isfinite(value):
                each.trial.report(value, rung)


def _prune(study: Any, search: Search, rung: int, enough: int, asked: list[_PendingTrial]) -> None:
    """Stop trials below the median of the earlier generations' trials at the same rung.

    Optuna's pruner takes the median of the trials that were never stopped, which rises and rises.
    """
    values = [trial.intermediate_values.get(rung, np.nan) for trial in study.get_trials(deepcopy=False)]
    before = np.array(values[: asked[0].trial.number])
    before = before[np.isfinite(before)]
    if len(before) >= enough:
        sign = 1 if search.objectives[0].direction == "maximize" else -1
        for each in asked:
            each.pruned |= rung in each.rungs and sign * each.rungs[rung] < sign * np.median(before)


def _tell(
    study: optuna.Study, objectives: Sequence[Objective], asked: _PendingTrial, outcomes: Outcomes
) -> EndedTrial:
    values = tuple(
        objective_value(objective, asked.longest, outcomes) for objective in objectives if asked.cells
    )
    lacking = [
        each.outcome for each, value in zip(objectives, values, strict=False) if not np.isfinite(value)
    ]
    state = "failed" if lacking or not values else "pruned" if asked.pruned else "complete"
    study.tell(asked.trial, list(values) if state == "complete" else None, STATES[state])
    notes = [asked.note, *(f"a run has no {name}, or none that is finite" for name in lacking)]
    if count := sum(map(outcomes.diverged, asked.cells)):
        notes.append(f"{count} of {len(asked.cells)} runs diverged")
    run_ids = tuple(cell.run_id for cell in asked.cells)
    note = "; ".join(filter(None, notes))
    return EndedTrial(asked.trial.number, asked.params, state, values, run_ids, asked.rungs, note)


def best_number(trials: Sequence[EndedTrial], search: Search) -> int | list[int] | None:
    """Return the number of the best trial, the first of equals; with several objectives, the Pareto front.

    Raises:
        ValueError: for trials that do not fit the search.
    """
    front = [trials[trial.number].number for trial in ended_study(trials, search).best_trials]
    return front if len(search.objectives) > 1 else min(front, default=None)


def objective_value(objective: Objective, cells: Sequence[Cell], outcomes: Outcomes) -> float:
    """Return the value of a trial's runs in one objective.

    Runs that all diverge have no spread, which would look good. They count with the greatest possible spread,
    if the outcome is bounded.
    """
    bounds, half = find_outcome(objective.outcome).bounds, len(cells) // 2
    spread = objective.over_seeds == "deviation"
    if spread and np.isfinite(bounds).all() and any(map(outcomes.diverged, cells)):
        return over_seeds("deviation", np.repeat(bounds, [half, len(cells) - half]))
    values = [outcomes.read(cell, objective.outcome) for cell in cells]
    return over_seeds(objective.over_seeds, np.array(values))


def over_seeds(name: str, values: np.ndarray) -> float:
    """Combine the outcomes of a trial's runs, (seeds,); NaN if one has none."""
    if not np.isfinite(values).all() or (name == "deviation" and len(values) < 2):
        return float("nan")
    return float(OVER_SEEDS[name](values))
