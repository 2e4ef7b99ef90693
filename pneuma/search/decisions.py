"""What the sampler and the pruner of a search decide, always the same from the same log.

They work on a copy of the study in memory, in which the trials of earlier generations have ended. The sampler
gets a seed for each trial. So a decision depends neither on the number of workers nor on how often the search
was stopped, and every process that repeats it writes the same.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import Any

import optuna
from optuna.exceptions import UpdateFinishedTrialError
from optuna.trial import FrozenTrial, TrialState, create_trial

from pneuma.config import stream_seed
from pneuma.errors import UserError
from pneuma.search.log import Record
from pneuma.search.optuna_private import draw_value, storage_of, study_id, trial_id
from pneuma.study.identity import config_id
from pneuma.study.plan import Cell
from pneuma.values import format_json

STUDY_ATTRIBUTES = "pneuma:study"
"""The attribute of a trial with the attributes that its sampler gave the whole study."""


def make_cells(record: Record, trial_number: int, params: Mapping[str, Any]) -> list[Cell]:
    """Return the runs of a trial, one for each seed."""
    run = record.search.make_run(params, steps=record.budget.steps)
    cells = []
    for seed in record.budget.seeds:
        cells.append(Cell(f"trial-{trial_number:03}", seed, replace(run, seed=seed)))
    return cells


def suggest(record: Record, trial_number: int) -> None:
    """Give a trial its parameters, unless it has them; those that a user enqueued stay.

    A trial waits in the log until it has all of them. If this is cut short, it gets the same again.
    """
    if trial_number == len(record.trials):
        record.study.enqueue_trial({})
    waiting = record.trials[trial_number]
    if waiting.state != TrialState.WAITING:
        return
    params = waiting.system_attrs.get("fixed_params")
    if not params and trial_number < len(record.search.start):
        params = record.search.params_of(record.search.start[trial_number])
    trial = _sample(record, trial_number, params or {})
    storage, waiting_id = storage_of(record.study), trial_id(waiting)
    with suppress(UpdateFinishedTrialError):  # another process was faster
        for parameter_name, distribution in trial.distributions.items():
            value = distribution.to_internal_repr(trial.params[parameter_name])
            storage.set_trial_param(waiting_id, parameter_name, value, distribution)
        for attribute, value in trial.user_attrs.items():
            storage.set_trial_user_attr(waiting_id, attribute, value)
        for attribute, value in trial.system_attrs.items():
            storage.set_trial_system_attr(waiting_id, attribute, value)
        storage.set_trial_state_values(waiting_id, TrialState.RUNNING)


def _sample(record: Record, trial_number: int, enqueued: dict[str, Any]) -> FrozenTrial:
    """Return a trial with the enqueued parameters, and the others as the sampler suggests them."""
    search = record.search
    attributes: dict[str, Any] = {"seeds": record.budget.seeds, "run_ids": []}
    for parameter_name, value in enqueued.items():
        if not search.holds({parameter_name: value}):
            attributes["note"] = (
                f"was enqueued with {parameter_name} = {format_json(value)}, which is not in its space"
            )
            return create_trial(state=TrialState.RUNNING, user_attrs=attributes)
    study = _copy_study(record, trial_number)
    study.enqueue_trial(enqueued)
    stream = search.name
    if search.sampler_seed:
        stream += f"/{search.sampler_seed}"
    with _explained(record, f"sampler {search.sampler.name}"):
        study.sampler = search.sampler.create(seed=stream_seed(stream, "sampler", trial_number) % 2**32)
        trial = study.ask()
        params = search.suggest(lambda parameter: draw_value(trial, parameter.name, parameter.distribution))
    try:
        cells = make_cells(record, trial_number, params)
        attributes["run_ids"] = [cell.run_id for cell in cells]
        attributes["config_id"] = config_id(cells[0].run)
    except UserError as error:
        attributes["note"] = str(error)
    for attribute, value in attributes.items():
        trial.set_user_attr(attribute, value)
    storage = storage_of(study)
    study_attributes = storage.get_study_system_attrs(study_id(study))
    if study_attributes:
        storage.set_trial_system_attr(trial_id(trial), STUDY_ATTRIBUTES, study_attributes)
    return storage.get_trial(trial_id(trial))


def prune(record: Record, trial: FrozenTrial, reports: Mapping[int, float]) -> tuple[bool, dict[str, Any]]:
    """Ask the pruner at each report of a trial, with the trials of earlier generations to compare with.

    Returns:
        Whether the trial is stopped, and the attributes that the pruner gave it.
    """
    pruner = record.search.pruner
    if pruner is None:
        return False, {}
    is_stopped = False
    with _explained(record, f"pruner {pruner.name}"):
        optuna_pruner = pruner.create()
        study = _copy_study(record, trial.number)
        study.add_trial(_as_suggested(trial, {}))
        storage, copied_id = storage_of(study), trial_id(study.get_trials(deepcopy=False)[-1])
        for evaluation, value in sorted(reports.items()):
            storage.set_trial_intermediate_value(copied_id, evaluation, value)
            is_stopped = is_stopped or optuna_pruner.prune(study, storage.get_trial(copied_id))
        return is_stopped, storage.get_trial(copied_id).system_attrs


def _copy_study(record: Record, trial_number: int) -> optuna.Study:
    """Return a copy of the study as it was when a trial was suggested: its own generation is running."""
    search = record.search
    study = optuna.create_study(study_name=search.name, directions=search.directions)
    first_number = trial_number - trial_number % search.generation
    study_attributes: Mapping[str, Any] = {}
    for trial in record.trials[:trial_number]:
        study_attributes = trial.system_attrs.get(STUDY_ATTRIBUTES, study_attributes)
        if trial.number >= first_number:
            trial = _as_suggested(trial, trial.system_attrs)
        study.add_trial(trial)
    for attribute, value in study_attributes.items():
        storage_of(study).set_study_system_attr(study_id(study), attribute, value)
    return study


def _as_suggested(trial: FrozenTrial, system_attributes: dict[str, Any]) -> FrozenTrial:
    return create_trial(
        state=TrialState.RUNNING,
        params=trial.params,
        distributions=trial.distributions,
        user_attrs=trial.user_attrs,
        system_attrs=system_attributes,
    )


@contextmanager
def _explained(record: Record, component: str) -> Iterator[None]:
    """Turn any error of a sampler or pruner, which may be a user's, into a message of one line."""
    try:
        with warnings.catch_warnings(action="ignore"):  # experimental features
            yield
    except Exception as error:
        raise UserError(
            f"search {record.search.name}: {component}: {type(error).__name__}: {error}; "
            "change its arguments in the search's file, or move the log away"
        ) from None
