"""The loop of a search: generations of trials are suggested together, trained, and reported in order.

The log is all that it goes by. Each suggestion is made in memory, from the trials of earlier generations, by
a sampler whose seed is the trial's: so it depends neither on the number of workers nor on how often the
search was stopped (Akiba et al. 2019 describe ask and tell). A new trial is one line of the log, and what
follows is written again, alike, by whoever continues a search that was killed. Several processes may run the
same search: the first to come to a result writes it, and the others continue from there.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState, create_trial

from pneuma.analysis.outcomes import check_outcome
from pneuma.config import Run, round_up, stream_seed
from pneuma.engines.loop import EVALUATIONS, evaluation_steps
from pneuma.errors import UserError
from pneuma.schema import shown
from pneuma.search.log import Record, open_record
from pneuma.search.spec import Budget, Search, check_budget
from pneuma.search.values import read_rows, trial_value
from pneuma.store.store import Store
from pneuma.study.identity import config_id
from pneuma.study.plan import Cell, Plan
from pneuma.study.spec import Study
from pneuma.training.execute import CellResult, check_environments

Train = Callable[[Plan, Mapping[str, int]], None]
"""Trains runs of a plan, by id, up to a step each, or to the end if that is 0; raises `Unfinished`."""
Say = Callable[[str], None]
STUDY_ATTRIBUTES = "pneuma:study"
"""The attribute of a trial with what its sampler has noted of the whole study."""


class Unfinished(Exception):
    """A run did not finish, so that its trial has no value and the search cannot go on."""


def refuse_unfinished(results: Sequence[CellResult], until: Mapping[str, int]) -> None:
    """Raise `Unfinished` if a run is not where `until` says."""
    for result in results:
        cell, status = result.cell, result.status
        step = until.get(cell.run_id)
        if step is None or status.finished or 0 < step <= status.step:
            continue
        message = f"{cell.condition} seed {cell.seed} {status.name} (run {cell.run_id})"
        if result.reason:
            message += f": {result.reason}"
        raise Unfinished(message)


def run_search(search: Search, budget: Budget, store: Store, train: Train, say: Say) -> Iterator[Record]:
    """Search, training only runs that are not stored; yield the record at first and after each generation.

    The budget's steps are rounded up alike for all trials and the base. A search that cannot be run here is
    refused before anything is trained.

    Raises:
        Unfinished: when a run crashed; trials that ended before are stored.
    """
    runs = [search.make_run({}), *(run for _, run in search.corners())]
    check_budget(search, budget)
    check_environments(runs)
    for objective in search.objectives.values():
        for env in sorted({run.env for run in runs}):
            check_outcome(objective.outcome, [env])
    steps = common_steps(runs, budget.steps)
    if steps != budget.steps:
        say(f"Note: {budget.steps:,} steps are rounded up to {steps:,} for all trials and the base.")
    elif any(round_up(run, steps) != steps for run in runs):
        say(f"Note: {steps:,} steps are rounded up to whole updates, which differ from trial to trial.")
    record = open_record(store, search, budget.model_copy(update={"steps": steps}), say)
    yield record
    for first in range(0, budget.trials, search.generation):
        for number in range(first, first + search.generation):  # so that a longer search has the same trials
            _suggest(record, number)
        last = min(first + search.generation, budget.trials)
        _run_generation(record, store, range(first, last), train, say)
        yield record


def common_steps(runs: Iterable[Run], steps: int) -> int:
    """Return the least steps from `steps` on that are whole updates of all runs.

    Where they would be more than twice as many, `steps` are returned: each run rounds them up for itself.
    """
    update = math.lcm(*(run.steps_per_update for run in runs))
    rounded = math.ceil(steps / update) * update
    return rounded if rounded <= 2 * steps else steps


def _run_generation(record: Record, store: Store, numbers: range, train: Train, say: Say) -> None:
    """Train and report the trials of a generation, stop some early, and store their values."""
    cells: dict[int, list[Cell]] = {}
    for number in numbers:
        trial = record.trials[number]
        cells[number] = (
            _make_cells(record, trial.number, trial.params) if trial.user_attrs.get("run_ids") else []
        )
    for pause in [*_pauses(record.search), EVALUATIONS]:
        running = [number for number in numbers if cells[number] and _is_running(record, number)]
        until: dict[str, int] = {}
        for number in running:
            steps = _evaluations(cells[number][0].run, pause)
            for cell in cells[number]:
                until[cell.run_id] = 0 if EVALUATIONS in steps else max(steps.values())
        if until:
            train(_make_plan(record, [cell for number in running for cell in cells[number]]), until)
        for number in running:
            _report(record, store, number, cells[number], pause)
        pruned = [str(number) for number in running if record.trials[number].state == TrialState.PRUNED]
        if pruned:
            say(f"Stopped early: trial {', '.join(pruned)}.")
    for number in numbers:
        _finish(record, store, number, cells[number])


def _pauses(search: Search) -> list[int]:
    """Return the numbers of evaluations at which the pruner may stop a trial.

    Training pauses there, so that all trials of a generation are compared with the same earlier ones.
    """
    if search.pruner is None:
        return []
    if search.pruner.name != "median":
        return list(range(1, EVALUATIONS))
    pruner = search.pruner.create()
    return list(range(max(pruner._n_warmup_steps, 1), EVALUATIONS, pruner._interval_steps))


def _evaluations(run: Run, pause: int) -> dict[int, int]:
    """Return the steps of a run's evaluations, by number, up to the first that is not before a pause."""
    steps = evaluation_steps(run)
    last = min(number for number in steps if number >= pause)
    return {number: step for number, step in steps.items() if number <= last}


def _is_running(record: Record, number: int) -> bool:
    """Return whether a trial is this search's and has not ended; another program may have asked for it."""
    trial = record.trials[number]
    return trial.state == TrialState.RUNNING and "run_ids" in trial.user_attrs


def _make_cells(record: Record, number: int, params: Mapping[str, Any]) -> list[Cell]:
    run = record.search.make_run(params, steps=record.budget.steps)
    cells = []
    for seed in record.budget.seeds:
        cells.append(Cell(f"trial-{number:03}", seed, replace(run, seed=seed)))
    return cells


def _make_plan(record: Record, cells: Sequence[Cell]) -> Plan:
    search = record.search
    conditions = [cell.condition for cell in cells]
    study = Study.without_file(f"search-{search.label}", search.full_title, conditions, world=search.world)
    return Plan(study, tuple(cells))


# --- Suggestions -----------------------------------------------------------------------------------


def _suggest(record: Record, number: int) -> None:
    """Add the next trial to the log; one that waits there, because a user enqueued it, is filled in."""
    while True:
        trials = record.trials
        waiting = trials[number] if number < len(trials) else None
        if waiting and waiting.state != TrialState.WAITING:
            return
        suggestion = _sample(record, number, waiting)
        with record.writing():
            if len(record.trials) != len(trials):
                continue  # something was added meanwhile
            if waiting is None:
                record.study.add_trial(suggestion)
            elif record.trials[number].state == TrialState.WAITING:
                _fill(record, waiting, suggestion)
            return


def _sample(record: Record, number: int, waiting: FrozenTrial | None) -> FrozenTrial:
    """Return a trial as the sampler suggests it, or as far as it was given."""
    search = record.search
    given = waiting.system_attrs.get("fixed_params", {}) if waiting else {}
    if waiting is None and number < len(search.start):
        given = search.params_of(search.start[number])
    about: dict[str, Any] = {"seeds": record.budget.seeds, "run_ids": []}
    for name, value in given.items():
        if not search.holds({name: value}):
            about["note"] = f"was enqueued with {name} = {shown(value)}, which is not in its space"
            return create_trial(state=TrialState.RUNNING, user_attrs=about)
    study = _study_before(record, number)
    stream = f"{search.name}/{search.sampler_seed}" if search.sampler_seed else search.name
    seed = stream_seed(stream, "sampler", number) % 2**32
    if given:
        study.enqueue_trial(given)
    with _calling(record, f"sampler {search.sampler.name}"):
        study.sampler = search.sampler.create(seed=seed)
        trial = study.ask()
        params = search.suggest(lambda parameter: trial._suggest(parameter.name, parameter.distribution))
    try:
        cells = _make_cells(record, number, params)
        about["run_ids"] = [cell.run_id for cell in cells]
        about["config_id"] = config_id(cells[0].run)
    except UserError as error:
        about["note"] = str(error)
    for key, value in about.items():
        trial.set_user_attr(key, value)
    attributes = study._storage.get_study_system_attrs(study._study_id)
    if attributes:
        study._storage.set_trial_system_attr(trial._trial_id, STUDY_ATTRIBUTES, attributes)
    return study._storage.get_trial(trial._trial_id)


def _study_before(record: Record, number: int) -> optuna.Study:
    """Return a study in memory as it is when a trial is suggested.

    The trials of earlier generations have ended, and those of its own generation are running.
    """
    search = record.search
    study = optuna.create_study(study_name=search.name, directions=search.directions)
    attributes: Mapping[str, Any] = {}
    first = number - number % search.generation
    for trial in record.trials[:number]:
        study.add_trial(trial if trial.number < first else _as_suggested(trial, trial.system_attrs))
        attributes = trial.system_attrs.get(STUDY_ATTRIBUTES, attributes)
    for key, value in attributes.items():
        study._storage.set_study_system_attr(study._study_id, key, value)
    return study


def _as_suggested(trial: FrozenTrial, system_attributes: Mapping[str, Any]) -> FrozenTrial:
    return create_trial(
        state=TrialState.RUNNING,
        params=trial.params,
        distributions=trial.distributions,
        user_attrs=trial.user_attrs,
        system_attrs=dict(system_attributes),
    )


def _fill(record: Record, waiting: FrozenTrial, suggestion: FrozenTrial) -> None:
    """Write a suggestion into a trial that waits; cut short, it waits on, and gets the same again."""
    storage, trial_id = record.study._storage, waiting._trial_id
    for name, distribution in suggestion.distributions.items():
        value = distribution.to_internal_repr(suggestion.params[name])
        storage.set_trial_param(trial_id, name, value, distribution)
    for key, value in suggestion.user_attrs.items():
        storage.set_trial_user_attr(trial_id, key, value)
    for key, value in suggestion.system_attrs.items():
        storage.set_trial_system_attr(trial_id, key, value)
    storage.set_trial_state_values(trial_id, TrialState.RUNNING)


@contextmanager
def _calling(record: Record, name: str) -> Iterator[None]:
    """Say in a line what a sampler or pruner of anybody's cannot do."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of what is experimental
            yield
    except Exception as error:
        raise UserError(
            f"search {record.search.name}: {name}: {type(error).__name__}: {error}; "
            "change its arguments in the search's file, or move the log away"
        ) from None


# --- Values ----------------------------------------------------------------------------------------


def _report(record: Record, store: Store, number: int, cells: Sequence[Cell], pause: int) -> None:
    """Report a trial's values at its evaluations up to a pause, and stop it if its pruner says so."""
    if len(record.search.objectives) > 1:
        return  # Optuna reports single values alone
    (objective,) = record.search.objectives.values()
    trial = record.trials[number]
    evaluations = _evaluations(cells[0].run, pause)
    reports: dict[int, float] = {}
    for evaluation, step in evaluations.items():
        if evaluation in trial.intermediate_values:
            value = trial.intermediate_values[evaluation]
        else:
            value = trial_value(objective, read_rows(store, cells, step))
        if math.isfinite(value):
            reports[evaluation] = value
    at_end = EVALUATIONS in evaluations
    pruned, attributes = (False, {}) if at_end else _prune(record, trial, reports)
    with record.writing():
        if not _is_running(record, number):
            return  # another process was faster
        storage = record.study._storage
        for evaluation in sorted(reports.keys() - trial.intermediate_values.keys()):
            storage.set_trial_intermediate_value(trial._trial_id, evaluation, reports[evaluation])
        for key, value in attributes.items():
            if trial.system_attrs.get(key) != value:
                storage.set_trial_system_attr(trial._trial_id, key, value)
        if pruned:
            latest = reports[max(reports)]
            storage.set_trial_state_values(trial._trial_id, TrialState.PRUNED, [latest])


def _prune(record: Record, trial: FrozenTrial, reports: Mapping[int, float]) -> tuple[bool, dict[str, Any]]:
    """Ask the pruner at each report, with the trials of earlier generations alone to compare with.

    So it decides alike however often the search is stopped.

    Returns:
        Whether the trial is stopped, and what the pruner has noted of it.
    """
    if record.search.pruner is None:
        return False, {}
    pruned = False
    with _calling(record, f"pruner {record.search.pruner.name}"):
        pruner = record.search.pruner.create()
        study = _study_before(record, trial.number)
        study.add_trial(_as_suggested(trial, {}))
        trial_id = study.get_trials(deepcopy=False)[-1]._trial_id
        for evaluation, value in sorted(reports.items()):
            study._storage.set_trial_intermediate_value(trial_id, evaluation, value)
            pruned = pruned or pruner.prune(study, study._storage.get_trial(trial_id))
        return pruned, study._storage.get_trial(trial_id).system_attrs


def _finish(record: Record, store: Store, number: int, cells: Sequence[Cell]) -> None:
    """Store the values of a trial, or that it failed, unless it has ended."""
    if not _is_running(record, number):
        return
    trial = record.trials[number]
    rows = read_rows(store, cells)
    notes = [trial.user_attrs["note"]] if "note" in trial.user_attrs else []
    values = []
    for objective in record.search.objectives.values() if rows else ():
        value = trial_value(objective, rows)
        values.append(value)
        if not math.isfinite(value):
            notes.append(f"a run has no {objective.outcome}, or none that is finite")
    diverged = sum(row.status == "diverged" for row in rows)
    if diverged:
        notes.append(f"{diverged} of {len(rows)} runs diverged")
    is_complete = bool(values) and all(map(math.isfinite, values))
    with record.writing():
        if not _is_running(record, number):
            return  # another process was faster
        storage = record.study._storage
        if notes:
            storage.set_trial_user_attr(trial._trial_id, "note", "; ".join(notes))
        if is_complete:
            storage.set_trial_state_values(trial._trial_id, TrialState.COMPLETE, values)
        else:
            storage.set_trial_state_values(trial._trial_id, TrialState.FAIL)
