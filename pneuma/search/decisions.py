"""What the sampler and the pruner of a search decide, always the same from the same log.

They work on a copy of the study in memory, in which the trials of earlier generations have ended. The sampler
has a seed of the trial's own. So a decision depends neither on the number of workers nor on how often the
search was stopped. Whoever writes it again writes the same.
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
from pneuma.schema import shown
from pneuma.search.log import Record
from pneuma.study.identity import config_id
from pneuma.study.plan import Cell

STUDY_ATTRIBUTES = "pneuma:study"
"""The attribute of a trial with what its sampler has noted of the whole study."""


def make_cells(record: Record, number: int, params: Mapping[str, Any]) -> list[Cell]:
    """Return the runs of a trial, one for each seed."""
    run = record.search.make_run(params, steps=record.budget.steps)
    cells = []
    for seed in record.budget.seeds:
        cells.append(Cell(f"trial-{number:03}", seed, replace(run, seed=seed)))
    return cells


def suggest(record: Record, number: int) -> None:
    """Give a trial its parameters, unless it has them; those that a user enqueued stay.

    A trial waits in the log until it has all of them. If this is cut short, it gets the same again.
    """
    if number == len(record.trials):
        record.study.enqueue_trial({})
    waiting = record.trials[number]
    if waiting.state != TrialState.WAITING:
        return
    params = waiting.system_attrs.get("fixed_params")
    if not params and number < len(record.search.start):
        params = record.search.params_of(record.search.start[number])
    trial = _sample(record, number, params or {})
    storage = record.study._storage
    with suppress(UpdateFinishedTrialError):  # another process was faster
        for name, distribution in trial.distributions.items():
            value = distribution.to_internal_repr(trial.params[name])
            storage.set_trial_param(waiting._trial_id, name, value, distribution)
        for key, value in trial.user_attrs.items():
            storage.set_trial_user_attr(waiting._trial_id, key, value)
        for key, value in trial.system_attrs.items():
            storage.set_trial_system_attr(waiting._trial_id, key, value)
        storage.set_trial_state_values(waiting._trial_id, TrialState.RUNNING)


def _sample(record: Record, number: int, enqueued: dict[str, Any]) -> FrozenTrial:
    """Return a trial with the enqueued parameters, and the others as the sampler suggests them."""
    search = record.search
    attributes: dict[str, Any] = {"seeds": record.budget.seeds, "run_ids": []}
    for name, value in enqueued.items():
        if not search.holds({name: value}):
            attributes["note"] = f"was enqueued with {name} = {shown(value)}, which is not in its space"
            return create_trial(state=TrialState.RUNNING, user_attrs=attributes)
    study = _copy_study(record, number)
    study.enqueue_trial(enqueued)
    stream = search.name
    if search.sampler_seed:
        stream += f"/{search.sampler_seed}"
    with _explained(record, f"sampler {search.sampler.name}"):
        study.sampler = search.sampler.create(seed=stream_seed(stream, "sampler", number) % 2**32)
        trial = study.ask()
        params = search.suggest(lambda parameter: trial._suggest(parameter.name, parameter.distribution))
    try:
        cells = make_cells(record, number, params)
        attributes["run_ids"] = [cell.run_id for cell in cells]
        attributes["config_id"] = config_id(cells[0].run)
    except UserError as error:
        attributes["note"] = str(error)
    for key, value in attributes.items():
        trial.set_user_attr(key, value)
    noted = study._storage.get_study_system_attrs(study._study_id)
    if noted:
        study._storage.set_trial_system_attr(trial._trial_id, STUDY_ATTRIBUTES, noted)
    return study._storage.get_trial(trial._trial_id)


def prune(record: Record, trial: FrozenTrial, reports: Mapping[int, float]) -> tuple[bool, dict[str, Any]]:
    """Ask the pruner at each report of a trial, with the trials of earlier generations to compare with.

    Returns:
        Whether the trial is stopped, and what the pruner has noted of it.
    """
    pruner = record.search.pruner
    if pruner is None:
        return False, {}
    stopped = False
    with _explained(record, f"pruner {pruner.name}"):
        optuna_pruner = pruner.create()
        study = _copy_study(record, trial.number)
        study.add_trial(_as_suggested(trial, {}))
        trial_id = study.get_trials(deepcopy=False)[-1]._trial_id
        for evaluation, value in sorted(reports.items()):
            study._storage.set_trial_intermediate_value(trial_id, evaluation, value)
            stopped = stopped or optuna_pruner.prune(study, study._storage.get_trial(trial_id))
        return stopped, study._storage.get_trial(trial_id).system_attrs


def _copy_study(record: Record, number: int) -> optuna.Study:
    """Return a copy of the study as it was when a trial was suggested: its own generation is running."""
    search = record.search
    study = optuna.create_study(study_name=search.name, directions=search.directions)
    first = number - number % search.generation
    noted: Mapping[str, Any] = {}
    for trial in record.trials[:number]:
        noted = trial.system_attrs.get(STUDY_ATTRIBUTES, noted)
        if trial.number >= first:
            trial = _as_suggested(trial, trial.system_attrs)
        study.add_trial(trial)
    for key, value in noted.items():
        study._storage.set_study_system_attr(study._study_id, key, value)
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
def _explained(record: Record, name: str) -> Iterator[None]:
    """Explain in a line what a sampler or pruner, which may be anybody's, cannot do."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of what is experimental
            yield
    except Exception as error:
        raise UserError(
            f"search {record.search.name}: {name}: {type(error).__name__}: {error}; "
            "change its arguments in the search's file, or move the log away"
        ) from None
