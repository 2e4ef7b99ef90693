"""The loop of a search: generations of trials are suggested together, trained, and reported in order.

The study in the log is all that it goes by. Before each suggestion the sampler is made again with a seed of
the trial, so that it depends only on the trials before, and not on the number of workers or on how often the
search was stopped (Akiba et al. 2019 describe ask and tell). What has begun is never suggested again, and
several processes that run a search do the same: whoever comes first writes, and the others go on from there.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from pneuma.analysis.outcomes import check_outcome
from pneuma.config import Run, stream_seed
from pneuma.engines.loop import EVALUATIONS, evaluation_steps
from pneuma.errors import UserError
from pneuma.schema import shown
from pneuma.search.record import STATES, Record, Task, common_steps, open_record
from pneuma.search.samplers import BY_SEED, PRUNERS, make_sampler
from pneuma.search.spec import Budget, Search, check_budget
from pneuma.search.values import Outcomes, objective_value, over_seeds
from pneuma.store.store import Store
from pneuma.study.identity import config_id
from pneuma.study.plan import Cell, Plan, rounding_notes
from pneuma.study.spec import Study
from pneuma.training.execute import CellResult, check_environments

Train = Callable[[Plan, Mapping[str, int]], None]
"""Trains runs of a plan, by id, up to a step each, or to the end if that is 0; raises `Unfinished`."""


class Unfinished(Exception):
    """A run did not finish, so that its trial has no value and the search cannot go on."""


def refuse_unfinished(results: Sequence[CellResult], until: Mapping[str, int]) -> None:
    """Raise `Unfinished` if a run is not where `until` says."""
    for each in results:
        cell, status = each.cell, each.status
        if cell.run_id in until and not (status.finished or 0 < until[cell.run_id] <= status.step):
            what = f"{cell.condition} seed {cell.seed} {status.name} (run {cell.run_id})"
            why = f": {each.reason}" if each.reason else ""
            again = "; --retry-failed tries again" if status.failed else ""
            raise Unfinished(f"{what}{why}{again}")


def run_search(
    search: Search, budget: Budget, store: Store, train: Train, say: Callable[[str], None]
) -> Iterator[Record]:
    """Search, training only runs that are not stored; yield the record at first and after each generation.

    The budget's steps are rounded up alike for all trials and the base. `say` tells how far the search is. A
    search that cannot be run here is refused before anything is trained. Raises `Unfinished` when a run
    crashed; trials that ended before are stored.
    """
    runs = [search.make_run({}), *(run for _, run in search.corners())]
    check_budget(search, budget)
    check_environments(runs)
    for objective, env in product(search.sought, sorted({run.env for run in runs})):
        check_outcome(objective.outcome, [env])
    steps = common_steps(runs, budget.steps)
    if steps != budget.steps:
        alike = f"{steps:,} for all trials and the base, whole updates of each"
        say(f"Note: {budget.steps:,} steps are rounded up to {alike}.")
    for note in search.beyond_space:
        say(f"Note: {note}.")
    task = Task(search, budget.model_copy(update={"steps": steps}))
    record = open_record(store, task, say)
    yield record
    yield from conduct(record, train, Outcomes(search, store), say)


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
    if task.search.pruner.name == BY_SEED:
        return [Round((seed,)) for seed in seeds]
    return [Round(seeds, pause) for pause in (*pauses(task), EVALUATIONS)]


def pauses(task: Task) -> list[int]:
    """Return the numbers of evaluations at which the pruner may stop a trial: for any of the user's own, all.

    Training pauses there, so that all trials of a generation are compared with the same earlier ones.
    """
    name, given = task.search.pruner.name, task.search.pruner.arguments
    if name == "median":
        first, every = int(given["n_warmup_steps"]), int(given["interval_steps"])
        return [k for k in range(1, EVALUATIONS) if k >= first and (k - first) % every == 0]
    if name == "hyperband":
        least, factor = int(given["min_resource"]), int(given["reduction_factor"])
        rungs = (least * factor**rung for rung in range(EVALUATIONS))
        return [k for k in rungs if k < EVALUATIONS]
    return [] if name in PRUNERS else [*range(1, EVALUATIONS)]


def conduct(record: Record, train: Train, outcomes: Outcomes, say: Callable[[str], None]) -> Iterator[Record]:
    """Search, and yield the record when the trials of each generation have ended.

    `say` tells which are trained or stopped. Raises `Unfinished` when a run crashed.
    """
    size = record.search.generation
    trained: list[Cell] = []
    for first in range(0, record.budget.trials, size):
        for number in range(first, first + size):  # whole, so that a longer search has the same trials
            _suggest(record, number)
        several = range(first, min(first + size, record.budget.trials))
        cells = {number: _cells_of(record, record.begun[number]) for number in several}
        trained += [cell for each in cells.values() for cell in each]
        for part in rounds(record):
            begun = [number for number in several if cells[number] and _goes_on(record, number)]
            if until := _to_train(part, [cell for number in begun for cell in cells[number]]):
                if part == rounds(record)[0]:
                    say(f"trials {begun[0]} to {begun[-1]} of {record.budget.trials}")
                train(make_trial_plan(record, trained), until)
            for number in begun:
                _compare(record, part, number, cells[number], outcomes)
            if stopped := [f"trial {number}" for number in begun if not _goes_on(record, number)]:
                say(f"{', '.join(stopped)} stopped early")
        for number in several:
            _end(record, number, cells[number], outcomes)
        yield record


def _goes_on(record: Record, number: int) -> bool:
    """Return whether a trial is this search's and has not ended; others may have been asked elsewhere."""
    trial = record.begun[number]
    return trial.state not in STATES and "run_ids" in trial.user_attrs


# --- Suggestions -----------------------------------------------------------------------------------


def _suggest(record: Record, number: int) -> None:
    """Suggest a trial that has not begun; one that waits is suggested as it was enqueued."""
    study, search = record.study, record.search
    with _entry(record, f"sampler {record.search.sampler.name}"):
        waits = [trial.state == TrialState.WAITING for trial in record.begun[number : number + 1]]
        if waits == [False]:
            return
        study.sampler = _sampler(record, number)
        trial = study.ask()
        given = record.begun[number].system_attrs.get("fixed_params", {})
        about: dict[str, Any] = {"seeds": [*record.budget.seeds], "run_ids": []}
        try:
            for name, value in given.items():
                if not search.holds({name: value}):
                    raise UserError(f"was enqueued with {name} = {shown(value)}, which is not in its space")
            search.ask(lambda parameter: trial._suggest(parameter.name, parameter.distribution))
            cells = _cells(record, number, trial.params)
            about |= {"run_ids": [cell.run_id for cell in cells], "config_id": config_id(cells[0].run)}
        except UserError as error:
            about["note"] = str(error)
        for key, value in about.items():
            trial.set_user_attr(key, value)


def _sampler(task: Task, number: int) -> BaseSampler:
    """Return the sampler of a trial, with its seed."""
    search, stream = task.search, task.search.name
    stream += f"/{search.sampler_seed}" if search.sampler_seed else ""
    return make_sampler(search.sampler, stream_seed(stream, "sampler", number) % 2**32)


@contextmanager
def _entry(record: Record, what: str) -> Iterator[None]:
    """Write an entry of the log; say in a line what anybody's sampler or pruner cannot do."""
    try:
        with record.journal.together(), warnings.catch_warnings(action="ignore"):  # of what is experimental
            yield
    except UserError:
        raise
    except Exception as error:
        raise UserError(
            f"search {record.search.name}: {what}: {type(error).__name__}: {error}; "
            "change its arguments in the search's file, or move the log away"
        ) from None


def _cells(task: Task, number: int, params: Mapping[str, Any]) -> list[Cell]:
    run = task.search.make_run(params, steps=task.budget.steps)
    runs = [replace(run, seed=seed) for seed in task.budget.seeds]
    return [Cell(f"trial-{number:03}", one.seed, one) for one in runs]


def _cells_of(task: Task, trial: FrozenTrial) -> list[Cell]:
    """Return the runs of a trial in the log; none if it can have none."""
    return _cells(task, trial.number, trial.params) if trial.user_attrs.get("run_ids") else []


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
        task.search.full_title,
        [cell.condition for cell in cells],
        section=task.search.section,
        about=task.search.about,
        world=task.search.world,
    )
    notes = tuple(rounding_notes((task.budget.steps, cell.run) for cell in cells))
    return Plan(study, tuple(cells), notes=notes)


# --- Values ----------------------------------------------------------------------------------------


def _compare(record: Record, part: Round, number: int, cells: Sequence[Cell], outcomes: Outcomes) -> None:
    """Report a trial's values of a round, and stop it if its pruner says so; both in one entry of the log.

    A round whose last value is in the log was decided when it was written.
    """
    last = record.begun[number].last_step
    several = len(record.search.sought) > 1
    if several or not (found := _values(record, part, cells, outcomes, -1 if last is None else last)):
        return
    with _entry(record, f"pruner {record.search.pruner.name}"):
        if not _goes_on(record, number) or (trial := record.begun[number]).last_step != last:
            return  # another process was faster
        for step, value in found.items():
            if np.isfinite(value):
                record.study._storage.set_trial_intermediate_value(trial._trial_id, step, value)
        trial = record.begun[number]
        is_whole = part.seeds[-1] == record.budget.seeds[-1] and EVALUATIONS in part.steps(cells[0].run)
        if not is_whole and trial.last_step is not None and record.study.pruner.prune(record.study, trial):
            record.study.tell(number, state=TrialState.PRUNED)


def _values(
    task: Task, part: Round, cells: Sequence[Cell], outcomes: Outcomes, last: int
) -> dict[int, float]:
    """Return a trial's values of a round by the pruner's steps, from those after `last` on."""
    sought, seeds = task.search.sought[0], task.budget.seeds
    if task.search.pruner.name == BY_SEED:
        places = [place for place in map(seeds.index, part.seeds) if place > last]
        return {place: outcomes.read(cells[place], sought.outcome) for place in places}
    steps = {number: step for number, step in part.steps(cells[0].run).items() if number > last}
    each = np.array([outcomes.read_early(cell, sought.outcome, [*steps.values()]) for cell in cells])
    return {
        number: over_seeds(sought.over_seeds, column) for number, column in zip(steps, each.T, strict=True)
    }


def _end(record: Record, number: int, cells: Sequence[Cell], outcomes: Outcomes) -> None:
    """Tell the study what a trial came to, unless that is told already."""
    if not _goes_on(record, number):
        return
    objectives, notes = record.search.sought, [record.begun[number].user_attrs.get("note", "")]
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
    failed = lacking or not values
    with _entry(record, f"sampler {record.search.sampler.name}"):
        if not _goes_on(record, number):
            return  # another process was faster
        if note := "; ".join(filter(None, notes)):
            trial = record.begun[number]
            record.study._storage.set_trial_user_attr(trial._trial_id, "note", note)
        record.study.sampler = _sampler(record, number)
        ended = TrialState.FAIL if failed else TrialState.COMPLETE
        record.study.tell(number, None if failed else values, ended)
