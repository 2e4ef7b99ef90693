"""The loop of a search: generations of trials are suggested together, trained, and reported in order.

The study in the log is all that it goes by. Before each suggestion the sampler is made again with a seed of
the trial, so that it depends only on the trials before, and not on the number of workers or on how often the
search was stopped (Akiba et al. 2019 describe ask and tell). What has begun is never suggested again.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from optuna.exceptions import ExperimentalWarning
from optuna.trial import FrozenTrial, TrialState

from pneuma.analysis.outcomes import check_outcome
from pneuma.config import Run, stream_seed
from pneuma.engines.loop import EVALUATIONS, evaluation_steps
from pneuma.errors import UserError
from pneuma.search.journal import STATES, SearchLog, open_log
from pneuma.search.samplers import BY_SEED, PRUNERS, make_sampler
from pneuma.search.spec import check_budget
from pneuma.search.task import Task
from pneuma.search.values import Outcomes, objective_value, over_seeds
from pneuma.study.execute import check_environments
from pneuma.study.identity import config_id, run_id
from pneuma.study.locks import run_lock
from pneuma.study.plan import Cell, Plan, rounding_notes
from pneuma.study.spec import Study
from pneuma.study.store import Store

Train = Callable[[Plan, Mapping[str, int]], None]
"""Trains runs of a plan, by id, up to a step each, or to the end if that is 0; raises `Unfinished`."""


class Unfinished(Exception):
    """A run did not finish, so that its trial has no value and the search cannot go on."""


def run_search(
    task: Task, store: Store, train: Train, say: Callable[[str], None]
) -> Iterator[list[FrozenTrial]]:
    """Search, training only runs that are not stored; yield all trials after each generation.

    The log in `store` is written as it goes; `say` tells of one that was repaired or set aside, and how far
    the search is. A search that cannot be run here is refused before anything is trained. Raises `Unfinished`
    when a run crashed; trials that ended before are stored.
    """
    search, runs = task.search, [run for _, run in task.search.space.corners()]
    check_budget(search, task.budget)
    check_environments(runs)
    for objective, env in product(search.objectives, sorted({run.env for run in runs})):
        check_outcome(objective.outcome, [env])
    store.check_writable()
    with run_lock(store.root / "searches" / f".{search.label}") as mine:
        if not mine:
            raise UserError(f"search {search.name}: another process searches in {store.root} now")
        log, trials = open_log(store, task, say), []
        for generation in conduct(log, train, Outcomes(search, store), say):
            trials += generation
            yield trials


# --- Rounds of a generation ------------------------------------------------------------------------


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
    return [Round(seeds, pause) for pause in (*pauses(task), EVALUATIONS)]


def pauses(task: Task) -> list[int]:
    """Return the numbers of evaluations at which the pruner may stop a trial: for any of the user's own, all.

    Training pauses there, so that all trials of a generation are compared with the same earlier ones.
    """
    name, given = task.search.spec.pruner.name, task.search.spec.pruner.arguments
    if name == "median":
        first, every = int(given["n_warmup_steps"]), int(given["interval_steps"])
        return [k for k in range(1, EVALUATIONS) if k >= first and (k - first) % every == 0]
    if name == "hyperband":
        least, factor = int(given["min_resource"]), int(given["reduction_factor"])
        rungs = (least * factor**rung for rung in range(EVALUATIONS))
        return [k for k in rungs if k < EVALUATIONS]
    return [] if name in PRUNERS else [*range(1, EVALUATIONS)]


def conduct(
    log: SearchLog, train: Train, outcomes: Outcomes, say: Callable[[str], None]
) -> Iterator[list[FrozenTrial]]:
    """Search, and yield the trials of each generation when they have ended.

    `say` tells which are trained or stopped. Raises `Unfinished` when a run crashed.
    """
    budget, size = log.task.budget, log.task.search.spec.generation
    trained: list[Cell] = []
    for first in range(0, budget.trials, size):
        if len(log.trials) < first + size:
            _suggest(log, first + size)
        numbers = range(first, min(first + size, budget.trials))
        cells = {number: _cells_of(log, log.trials[number]) for number in numbers}
        trained += [cell for each in cells.values() for cell in each]
        for part in rounds(log.task):
            begun = [number for number in numbers if cells[number] and _goes_on(log, number)]
            if until := _to_train(part, [cell for number in begun for cell in cells[number]]):
                if begins := _begins(log.task, part, begun):
                    say(begins)
                train(make_trial_plan(log.task, trained), until)
            for number in begun:
                _compare(log, part, number, cells[number], outcomes)
            if stopped := [f"trial {number}" for number in begun if not _goes_on(log, number)]:
                say(f"{', '.join(stopped)} stopped early")
        with log.journal.together():
            for number in numbers:
                if _goes_on(log, number):
                    _end(log, number, cells[number], outcomes)
        yield [log.trials[number] for number in numbers]


def _goes_on(log: SearchLog, number: int) -> bool:
    return log.trials[number].state not in STATES


def _begins(task: Task, part: Round, numbers: Sequence[int]) -> str:
    """Return what is said when trials begin, or their next seed; nothing when they only go on."""
    seeds, several = task.budget.seeds, len(numbers) > 1
    if part.seeds == seeds and part != rounds(task)[0]:
        return ""
    seed = "" if part.seeds == seeds else f", seed {part.seeds[0]}"
    named = f"trials {numbers[0]} to {numbers[-1]}" if several else f"trial {numbers[0]}"
    return f"{named} of {task.budget.trials}{seed}"


# --- Suggestions -----------------------------------------------------------------------------------


def _suggest(log: SearchLog, end: int) -> None:
    """Suggest the trials up to the end of a generation, all in one entry of the log.

    A generation is suggested whole, also where the budget needs a part of it: a search of more trials goes on
    with the same ones.
    """
    task, study = log.task, log.study
    search = task.search
    with log.journal.together(), _by_optuna(log, f"sampler {search.spec.sampler.name}"):
        for number in range(len(log.trials), end):
            if number < len(search.first_trials):
                study.enqueue_trial(search.first_trials[number])
            study.sampler = make_sampler(
                search.spec.sampler, stream_seed(search.name, "sampler", number) % 2**32
            )
            trial = study.ask()
            search.space.ask(lambda parameter, trial=trial: parameter.suggest(trial))  # type: ignore[misc]
            about: dict[str, Any] = {"seeds": [*task.budget.seeds], "run_ids": []}
            try:
                cells = _cells(task, number, trial.params)
                ids = [cell.run_id for cell in cells]
                about |= {"run_ids": ids, "config_id": config_id(cells[0].run)}
            except UserError as error:
                about["note"] = str(error)
            for key, value in about.items():
                trial.set_user_attr(key, value)


@contextmanager
def _by_optuna(log: SearchLog, what: str) -> Iterator[None]:
    """Say in a line what a sampler or pruner cannot do, be it anybody's class or an odd log."""
    try:
        with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
            yield
    except UserError:
        raise
    except Exception as error:
        raise UserError(
            f"search {log.task.search.name}: {what}: {type(error).__name__}: {error}; "
            "change its arguments in the search's file, or move the log away"
        ) from None


def _cells(task: Task, number: int, params: Mapping[str, Any]) -> list[Cell]:
    run = task.search.space.make_run(params, steps=task.budget.steps)
    runs = [replace(run, seed=seed) for seed in task.budget.seeds]
    return [Cell(f"trial-{number:03}", one.seed, one, run_id(one)) for one in runs]


def _cells_of(log: SearchLog, trial: FrozenTrial) -> list[Cell]:
    """Return the runs of a trial in the log; none if it can have none."""
    noted = trial.user_attrs.get("run_ids")
    if noted == []:
        return []
    with _by_optuna(log, f"trial {trial.number} of the log"):
        cells = _cells(log.task, trial.number, trial.params)
    if noted != [cell.run_id for cell in cells]:
        raise UserError(
            f"trial {trial.number} of the log of search {log.task.search.name} is not what the search "
            "suggests; move the log away, and no run is trained twice"
        )
    return cells


def _to_train(part: Round, cells: Sequence[Cell]) -> dict[str, int]:
    """Return the runs of a round, by id, with the step up to which they are trained; 0 is the end."""
    return {
        cell.run_id: 0 if EVALUATIONS in (steps := part.steps(cell.run)) else max(steps.values())
        for cell in cells
        if cell.seed in part.seeds
    }


def make_trial_plan(task: Task, cells: Sequence[Cell]) -> Plan:
    """Return the runs of trials as the plan of a study, which can be exported and drawn."""
    name = f"search-{task.search.label}"
    study = Study.without_file(
        name,
        task.search.title,
        [cell.condition for cell in cells],
        section=task.search.spec.section,
        about=task.search.spec.about,
        world=task.search.world,
    )
    return Plan(study, tuple(cells), tuple(rounding_notes((task.budget.steps, cell.run) for cell in cells)))


# --- Values ----------------------------------------------------------------------------------------


def _compare(log: SearchLog, part: Round, number: int, cells: Sequence[Cell], outcomes: Outcomes) -> None:
    """Report a trial's values of a round, and stop it if its pruner says so; both in one entry of the log.

    A round whose last value is in the log was decided when it was written.
    """
    task, (sought, *more) = log.task, log.task.search.objectives
    if more:
        return
    last = log.trials[number].last_step
    if task.search.spec.pruner.name == BY_SEED:
        places = [task.budget.seeds.index(seed) for seed in part.seeds]
        found = {
            place: outcomes.read(cells[place], sought.outcome) for place in places if _after(place, last)
        }
    else:
        steps = {k: at for k, at in part.steps(cells[0].run).items() if _after(k, last)}
        each = np.array([outcomes.read_early(cell, sought.outcome, [*steps.values()]) for cell in cells])
        values = (over_seeds(sought.over_seeds, column) for column in each.T)
        found = dict(zip(steps, values, strict=True))
    if not found:
        return
    with log.journal.together(), _by_optuna(log, f"pruner {task.search.spec.pruner.name}"):
        for step, value in found.items():
            if np.isfinite(value):
                log.report(number, step, value)
        trial = log.trials[number]
        is_whole = part.seeds[-1] == task.budget.seeds[-1] and EVALUATIONS in part.steps(cells[0].run)
        if not is_whole and trial.last_step is not None and log.study.pruner.prune(log.study, trial):
            log.study.tell(number, state=TrialState.PRUNED)


def _after(step: int, last: int | None) -> bool:
    return last is None or step > last


def _end(log: SearchLog, number: int, cells: Sequence[Cell], outcomes: Outcomes) -> None:
    """Tell the study what a trial came to."""
    objectives, notes = log.task.search.objectives, [log.trials[number].user_attrs.get("note", "")]
    diverged = sum(map(outcomes.diverged, cells))
    values = [
        objective_value(each, np.array([outcomes.read(cell, each.outcome) for cell in cells]), diverged > 0)
        for each in objectives
        if cells
    ]
    lacking = [
        each.outcome for each, value in zip(objectives, values, strict=False) if not np.isfinite(value)
    ]
    notes += [f"a run has no {name}, or none that is finite" for name in lacking]
    if diverged:
        notes.append(f"{diverged} of {len(cells)} runs diverged")
    if note := "; ".join(filter(None, notes)):
        log.note(number, "note", note)
    failed = lacking or not values
    with _by_optuna(log, f"sampler {log.task.search.spec.sampler.name}"):
        log.study.tell(number, None if failed else values, TrialState.FAIL if failed else TrialState.COMPLETE)
