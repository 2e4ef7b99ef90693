"""The loop of a search: generations of trials are suggested together, trained, and reported in order.

It depends on the log alone (Akiba et al. 2019 describe ask and tell). A new trial is one line of the log.
Whoever continues a search that was killed writes the same lines after it. Several processes may run the same
search: the first that has a result writes it, and the others continue from there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress

from optuna.exceptions import UpdateFinishedTrialError
from optuna.trial import TrialState

from pneuma.analysis.outcomes import check_outcome
from pneuma.config import Run
from pneuma.engines.loop import EVALUATIONS, planned_evaluations
from pneuma.errors import Say, UserError
from pneuma.files import write_error
from pneuma.search.decisions import make_cells, prune, suggest
from pneuma.search.log import Record, open_record
from pneuma.search.optuna_private import steps_of_median, storage_of, trial_id
from pneuma.search.spec import DEVIATION, Budget, Search
from pneuma.search.values import read_rows, trial_value
from pneuma.store.store import Store
from pneuma.study.plan import Cell, Plan
from pneuma.study.spec import Study
from pneuma.training.execute import CellResult, check_environments

Train = Callable[[Plan, Mapping[str, int]], Sequence[CellResult]]
"""Trains runs of a plan, by id, up to a step each, or to the end if that is 0."""


class Unfinished(Exception):
    """A run did not finish, so that its trial has no value and the search cannot go on."""


def run_search(search: Search, budget: Budget, store: Store, train: Train, say: Say) -> Iterator[Record]:
    """Search, training only runs that are not stored; yield the record at first and after each generation.

    A search that cannot be run here is refused before anything is trained.

    Raises:
        Unfinished: when a run crashed; trials that ended before are stored.
    """
    runs = [search.make_run({})] + [run for _, run in search.corners()]
    check_environments(runs)
    for objective_name, objective in search.objectives.items():
        if objective.over_seeds == DEVIATION and len(budget.seeds) < 2:
            raise UserError(f"objective {objective_name}: a standard deviation needs at least 2 seeds")
        for env in sorted({run.env for run in runs}):
            check_outcome(objective.outcome, [env])
    record = open_record(store, search, budget)
    yield record
    try:
        for first_number in range(0, budget.trials, search.generation):
            generation = range(first_number, min(first_number + search.generation, budget.trials))
            for trial_number in generation:  # a longer search later adds what the others have not seen
                suggest(record, trial_number)
            _run_generation(record, store, generation, train, say)
            yield record
    except OSError as error:
        raise write_error(record.path, error) from None


def _run_generation(record: Record, store: Store, trial_numbers: range, train: Train, say: Say) -> None:
    """Train the trials of a generation, stop some early, and store their values."""
    cells_by_trial: dict[int, list[Cell]] = {}
    for trial_number in trial_numbers:
        trial = record.trials[trial_number]
        run_ids = trial.user_attrs.get("run_ids")
        if run_ids:
            cells_by_trial[trial_number] = make_cells(record, trial_number, trial.params)
        elif run_ids is not None:  # its note has the reason why it can have no runs
            record.study.tell(trial_number, state=TrialState.FAIL, skip_if_finished=True)
    for pause in _pauses(record.search) + [EVALUATIONS]:
        running = [
            trial_number
            for trial_number in cells_by_trial
            if record.trials[trial_number].state == TrialState.RUNNING
        ]
        planned_cells: list[Cell] = []
        step_by_run: dict[str, int] = {}
        for trial_number in running:
            planned_cells += cells_by_trial[trial_number]
            steps = _evaluations(cells_by_trial[trial_number][0].run, pause)
            step = 0 if EVALUATIONS in steps else max(steps.values())
            step_by_run |= dict.fromkeys((cell.run_id for cell in cells_by_trial[trial_number]), step)
        if running:
            _refuse_unfinished(train(_make_plan(record, planned_cells), step_by_run), step_by_run)
        for trial_number in running:
            with suppress(UpdateFinishedTrialError):  # another process was faster
                _tell(record, store, trial_number, cells_by_trial[trial_number], pause)
        pruned_trials = [
            str(trial_number)
            for trial_number in running
            if record.trials[trial_number].state == TrialState.PRUNED
        ]
        if pruned_trials:
            say(f"Stopped early: trial {', '.join(pruned_trials)}.")


def _refuse_unfinished(results: Sequence[CellResult], step_by_run: Mapping[str, int]) -> None:
    """Raise `Unfinished` if a run has not reached its step."""
    for result in results:
        cell, status = result.cell, result.status
        step = step_by_run.get(cell.run_id)
        if step is None or status.finished or 0 < step <= status.step:
            continue
        message = f"{cell.condition} seed {cell.seed} {status.name} (run {cell.run_id})"
        if result.reason:
            message += f": {result.reason}"
        raise Unfinished(message)


def _pauses(search: Search) -> list[int]:
    """Return the numbers of evaluations at which the pruner may stop a trial.

    Training pauses there, so that all trials of a generation are compared with the same earlier ones.
    """
    if search.pruner is None:
        return []
    if search.pruner.name != "median":
        return list(range(1, EVALUATIONS))
    warmup_steps, steps_between = steps_of_median(search.pruner.create())
    return list(range(max(warmup_steps, 1), EVALUATIONS, steps_between))


def _evaluations(run: Run, pause: int) -> dict[int, int]:
    """Return the steps of a run's evaluations, by number, up to the first that is not before a pause."""
    steps_by_number: dict[int, int] = {}
    for evaluation in planned_evaluations(run):
        steps_by_number[evaluation.number] = evaluation.step
        if evaluation.number >= pause:
            break
    return steps_by_number


def _make_plan(record: Record, cells: Sequence[Cell]) -> Plan:
    search = record.search
    conditions = [cell.condition for cell in cells]
    study = Study.without_file(f"search-{search.label}", search.full_title, conditions, world=search.world)
    return Plan(study, tuple(cells))


# --- Values ----------------------------------------------------------------------------------------


def _tell(record: Record, store: Store, trial_number: int, cells: Sequence[Cell], pause: int) -> None:
    """Report a trial's values at its evaluations up to a pause; end it at the last, or if its pruner does."""
    trial, study = record.trials[trial_number], record.study
    storage = storage_of(study)
    evaluations = _evaluations(cells[0].run, pause)
    reports = dict(trial.intermediate_values)
    if len(record.search.objectives) == 1:  # Optuna reports single values alone
        (objective,) = record.search.objectives.values()
        for evaluation, step in evaluations.items():
            if evaluation not in reports:
                value = trial_value(objective, read_rows(store, cells, step))
                if math.isfinite(value):
                    reports[evaluation] = value
    has_ended = EVALUATIONS in evaluations
    is_pruned, attributes = (False, {}) if has_ended else prune(record, trial, reports)
    for evaluation in sorted(reports.keys() - trial.intermediate_values.keys()):
        storage.set_trial_intermediate_value(trial_id(trial), evaluation, reports[evaluation])
    for attribute, value in attributes.items():
        if trial.system_attrs.get(attribute) != value:
            storage.set_trial_system_attr(trial_id(trial), attribute, value)
    if is_pruned:  # its value is the last that was reported
        study.tell(trial_number, state=TrialState.PRUNED, skip_if_finished=True)
    if has_ended:
        _end(record, store, trial_number, cells)


def _end(record: Record, store: Store, trial_number: int, cells: Sequence[Cell]) -> None:
    """Store the values of a trial whose runs have ended, or that it failed."""
    rows = read_rows(store, cells)
    notes: list[str] = []
    trial_values: list[float] = []
    for objective in record.search.objectives.values():
        value = trial_value(objective, rows)
        trial_values.append(value)
        if not math.isfinite(value):
            notes.append(f"a run has no {objective.outcome}, or none that is finite")
    state = TrialState.FAIL if notes else TrialState.COMPLETE
    diverged = sum(row.status == "diverged" for row in rows)
    if diverged:
        notes.append(f"{diverged} of {len(rows)} runs diverged")
    if notes:
        trial = record.trials[trial_number]
        storage_of(record.study).set_trial_user_attr(trial_id(trial), "note", "; ".join(notes))
    record.study.tell(
        trial_number,
        trial_values if state == TrialState.COMPLETE else None,
        state=state,
        skip_if_finished=True,
    )
