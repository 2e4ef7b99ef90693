"""The loop of a search: generations of trials are suggested together, trained, and reported in order.

A search is a function of its file, its budget and the outcomes of its runs. Every call replays it from the
first trial: trials that have ended are taken from the log, the others are trained. So after a kill it goes on
with the same suggestions.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import optuna

from pneuma.analysis.frames import StudyData
from pneuma.analysis.outcomes import find_outcome, outcome
from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run, as_fields
from pneuma.engines.loop import EVALUATIONS, evaluation_steps
from pneuma.errors import UserError
from pneuma.search.optuna_study import STATES, ask, create_study, ended_study
from pneuma.search.spec import BY_SEED, OVER_SEEDS, Budget, Objective, Search
from pneuma.study.identity import run_id, user_files_digest
from pneuma.study.measure import row_until, stored_row
from pneuma.study.plan import Cell, Plan, rounding_notes
from pneuma.study.rows import Row
from pneuma.study.spec import Study
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.search.storage import JournalLog

Train = Callable[[Plan, Mapping[str, int]], None]
"""Trains runs of a plan, by id, up to a step each, or to the end if that is 0; raises `Unfinished`."""


class Unfinished(Exception):
    """A run did not finish, so that its trial has no value and the search cannot go on."""


@dataclass(frozen=True)
class Task:
    """A search with its budget; `over` has fields that replace those of its file."""

    search: Search
    budget: Budget
    over: Mapping[str, Any] = field(default_factory=dict)

    @property
    def identity(self) -> dict[str, Any]:
        """Return everything that the suggestions depend on, except the number of trials."""
        search = self.search
        values = [{key: value} for key, each in search.space.all_values().items() for value in each]
        code = [*filter(None, map(user_files_digest, values))]
        return {
            **({"contents": code} if code else {}),
            "base": search.space.base,
            "fixed": search.space.fixed,
            "space": [parameter.identity for parameter in search.space.parameters],
            "objectives": [objective.model_dump() for objective in search.objectives],
            "start": [search.space.named(params) for params in search.first_trials],
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
    """A trial that has ended."""

    number: int  # from 0, in the order of suggestion
    params: Mapping[str, Any]
    state: str  # complete; pruned, if it was stopped early; failed, if it has no value
    values: tuple[float, ...]  # one for each objective; for a pruned trial, its last report
    run_ids: tuple[str, ...]
    reports: Mapping[int, float]  # what its pruner saw: by evaluation, as in `evaluation_steps`, or by seed
    note: str = ""  # why it failed, or that one of its runs diverged


@dataclass
class PendingTrial:
    """A trial that has not ended, with its runs."""

    trial: optuna.Trial
    cells: Sequence[Cell] = ()
    note: str = ""
    pruned: bool = False
    reports: dict[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcomes:
    """Reads outcomes of stored runs as a search counts them."""

    task: Task
    store: Store

    def read(self, cell: Cell, name: str) -> float:
        """Return an outcome of a finished run; NaN if it has none."""
        run = replace(stored_row(self.store, cell.run_id), condition=cell.condition)
        return counted_outcome(self.task.search, self._data(run, cell), run, name)

    def read_early(self, cell: Cell, name: str, steps: Sequence[int]) -> list[float]:
        """Return an outcome as it is at steps before the run's end, in their order; NaN if there is none."""
        status = self.store.status(cell.run_id)
        healthy = [step for step in steps if status.name != "diverged" or step < status.step]
        values = []
        if healthy:
            row = row_until(self.store, cell.run_id, cell.run, healthy[-1])
            run = replace(row, condition=cell.condition)
            values = [outcome(self._data(run, cell), run, name, step) for step in healthy]
        return values + [self.read(cell, name) for _ in steps[len(healthy) :]]

    def diverged(self, cell: Cell) -> bool:
        return self.store.status(cell.run_id).name == "diverged"

    def _data(self, run: Row, cell: Cell) -> StudyData:
        title = self.task.search.title
        return StudyData(title, title, title, cell.condition, {cell.condition: as_fields(cell.run)}, [run])


@dataclass(frozen=True)
class Round:
    """A part of the training of a generation, after which its trials are compared."""

    seeds: tuple[int, ...]
    pause: int = EVALUATIONS  # up to the first evaluation of this number, or a greater one, is trained

    def steps(self, run: Run) -> dict[int, int]:
        """Return the steps of a run's evaluations up to the end of the round, by number."""
        steps = evaluation_steps(run)
        end = min(number for number in steps if number >= self.pause)
        return {number: step for number, step in steps.items() if number <= end}


def rounds(task: Task) -> list[Round]:
    """Return the rounds of each generation: between its pruner's evaluations, or seed by seed."""
    seeds = task.budget.seeds
    if task.search.spec.pruner.name == BY_SEED:
        return [Round((seed,)) for seed in seeds]
    return [Round(seeds, pause) for pause in (*pauses(task.search), EVALUATIONS)]


def pauses(search: Search) -> list[int]:
    """Return the numbers of evaluations at which the pruner may stop a trial.

    Training pauses there, so that all trials of a generation are compared with the same earlier ones.
    """
    name, given = search.spec.pruner.name, search.spec.pruner.arguments
    if name in ("median", "percentile"):
        first, every = int(given["n_warmup_steps"]), int(given["interval_steps"])
        return [k for k in range(1, EVALUATIONS) if k >= first and (k - first) % every == 0]
    if name in ("successive-halving", "hyperband"):
        least, factor = int(given["min_resource"]), int(given["reduction_factor"])
        rungs = (least * factor**rung for rung in range(EVALUATIONS))
        return [k for k in rungs if k < EVALUATIONS]
    return []


def conduct(
    task: Task, train: Train, outcomes: Outcomes, log: JournalLog, say: Callable[[str], None]
) -> Iterator[list[EndedTrial]]:
    """Search, and yield the trials of each generation when they have ended.

    `log` knows the trials that ended before, which must be those that the search suggests, and notes the
    others; `say` tells which are trained or stopped. Raises `Unfinished` when a run crashed.
    """
    search, budget = task.search, task.budget
    study, first_trials = create_study(search), search.first_trials
    trained: list[Cell] = []
    parts = rounds(task)

    for first in range(0, budget.trials, search.spec.generation):
        asked = [PendingTrial(ask(study, search, first_trials)) for _ in range(search.spec.generation)]
        asked = asked[: budget.trials - first]
        for each in asked:
            try:
                each.cells = _cells(task, each)
            except UserError as error:
                each.note = str(error)
            log.begin(each)
            trained += each.cells
        for part in parts:
            pending = [each for each in asked if each.cells and not each.pruned]
            begun = [each for each in pending if each.trial.number not in log.ended]
            if until := _to_train(part, begun):
                if part is parts[0] or part.seeds != budget.seeds:
                    seed = "" if part.seeds == budget.seeds else f", seed {part.seeds[0]}"
                    numbers = f" {begun[0].trial.number}" + f" to {begun[-1].trial.number}" * bool(begun[1:])
                    say(f"trial{'s' * bool(begun[1:])}{numbers} of {budget.trials}{seed}")
                train(make_trial_plan(task, trained), until)
            for each in pending:
                _report(task, part, each, outcomes, log)
                each.pruned = not _is_trained(part, each, parts[-1]) and each.trial.should_prune()
            if stopped := [f"trial {each.trial.number}" for each in begun if each.pruned]:
                say(f"{', '.join(stopped)} stopped early")
        yield [_tell(study, search.objectives, each, outcomes, log) for each in asked]


def _cells(task: Task, asked: PendingTrial) -> list[Cell]:
    run = task.search.space.make_run(asked.trial.params, steps=task.budget.steps)
    name = f"trial-{asked.trial.number:03}"
    runs = [replace(run, seed=seed) for seed in task.budget.seeds]
    return [Cell(name, one.seed, one, run_id(one)) for one in runs]


def _to_train(part: Round, pending: Sequence[PendingTrial]) -> dict[str, int]:
    """Return the runs of a round, by id, with the step up to which they are trained; 0 is the end."""
    return {
        cell.run_id: 0 if EVALUATIONS in (steps := part.steps(cell.run)) else max(steps.values())
        for each in pending
        for cell in each.cells
        if cell.seed in part.seeds
    }


def _is_trained(part: Round, asked: PendingTrial, last: Round) -> bool:
    """Return whether all runs of a trial have been trained to their end."""
    return part.seeds == last.seeds and EVALUATIONS in part.steps(asked.cells[0].run)


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
    return Plan(study, tuple(cells), tuple(rounding_notes((task.budget.steps, cell.run) for cell in cells)))


def _report(task: Task, part: Round, asked: PendingTrial, outcomes: Outcomes, log: JournalLog) -> None:
    """Report a trial's values in the first objective, if it is the only one and they are finite."""
    if len(task.search.objectives) > 1:
        return
    sought, known = task.search.objectives[0], log.ended.get(asked.trial.number)
    if task.search.spec.pruner.name == BY_SEED:
        numbers = [task.budget.seeds.index(seed) for seed in part.seeds]
        values: Iterator[float] = (outcomes.read(asked.cells[number], sought.outcome) for number in numbers)
    else:
        steps = {k: at for k, at in part.steps(asked.cells[0].run).items() if k not in asked.reports}
        numbers, values = [*steps], _values(sought, asked.cells, [*steps.values()], outcomes)
    found = known.reports if known else dict(zip(numbers, values, strict=True))
    for number in numbers:
        if np.isfinite(value := found.get(number, np.nan)):
            asked.reports[number] = value
            asked.trial.report(value, number)
            if not known:
                log.report(asked.trial.number, number, value)


def _values(
    sought: Objective, cells: Sequence[Cell], steps: Sequence[int], outcomes: Outcomes
) -> Iterator[float]:
    """Yield a trial's values at steps of its runs."""
    each = np.array([outcomes.read_early(cell, sought.outcome, steps) for cell in cells])
    yield from (over_seeds(sought.over_seeds, column) for column in each.T)


def _tell(
    study: optuna.Study,
    objectives: Sequence[Objective],
    asked: PendingTrial,
    outcomes: Outcomes,
    log: JournalLog,
) -> EndedTrial:
    number = asked.trial.number
    ended = log.ended.get(number) or _end(objectives, asked, outcomes)
    if (ended.state == "pruned") != asked.pruned:
        raise UserError(f"trial {number} of the log ended otherwise than this search would end it")
    study.tell(asked.trial, list(ended.values) if ended.state == "complete" else None, STATES[ended.state])
    if number not in log.ended:
        log.end(ended)
    return ended


def _end(objectives: Sequence[Objective], asked: PendingTrial, outcomes: Outcomes) -> EndedTrial:
    run_ids = tuple(cell.run_id for cell in asked.cells)
    number, params = asked.trial.number, asked.trial.params
    if asked.pruned:
        last = asked.reports[max(asked.reports)]
        return EndedTrial(number, params, "pruned", (last,), run_ids, asked.reports)
    diverged = sum(map(outcomes.diverged, asked.cells))
    values = tuple(
        objective_value(
            each, np.array([outcomes.read(cell, each.outcome) for cell in asked.cells]), diverged > 0
        )
        for each in objectives
        if run_ids
    )
    lacking = [
        each.outcome for each, value in zip(objectives, values, strict=False) if not np.isfinite(value)
    ]
    state = "failed" if lacking or not values else "complete"
    notes = [asked.note, *(f"a run has no {name}, or none that is finite" for name in lacking)]
    if diverged:
        notes.append(f"{diverged} of {len(asked.cells)} runs diverged")
    note = "; ".join(filter(None, notes))
    finite = values if state == "complete" else ()
    return EndedTrial(number, params, state, finite, run_ids, asked.reports, note)


def best_number(trials: Sequence[EndedTrial], search: Search) -> int | list[int] | None:
    """Return the number of the best trial, the first of equals; with several objectives, the Pareto front.

    Raises:
        ValueError: for trials that do not fit the search.
    """
    front = [trials[trial.number].number for trial in ended_study(trials, search).best_trials]
    return front if len(search.objectives) > 1 else min(front, default=None)


def counted_outcome(search: Search, data: StudyData, run: Row, name: str) -> float:
    """Return an outcome of a run of some data as a search counts it.

    A diverged run counts with the worst possible value of the outcome, or with its last recorded value if the
    outcome has no bound.
    """
    if run.status == "diverged":
        minimized = any(
            (one.outcome, one.direction) == (name, "minimize") and one.over_seeds != "deviation"
            for one in search.objectives
        )
        worst = find_outcome(name).bounds[minimized]
        if np.isfinite(worst):
            return float(worst)
    return outcome(data, run, name)


def objective_value(objective: Objective, values: np.ndarray, diverged: bool) -> float:
    """Return the value of runs in one objective from their outcomes, (seeds,), and whether some diverged.

    Runs that all diverge have no spread, which would look good. They count with the greatest possible spread,
    if the outcome is bounded.
    """
    bounds, half = find_outcome(objective.outcome).bounds, len(values) // 2
    if objective.over_seeds == "deviation" and np.isfinite(bounds).all() and diverged:
        return over_seeds("deviation", np.repeat(bounds, [half, len(values) - half]))
    return over_seeds(objective.over_seeds, values)


def over_seeds(name: str, values: np.ndarray) -> float:
    """Combine the outcomes of a trial's runs, (seeds,); NaN if one has none."""
    if not np.isfinite(values).all() or (name == "deviation" and len(values) < 2):
        return float("nan")
    return float(OVER_SEEDS[name](values))
