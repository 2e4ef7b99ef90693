"""A search in a results folder: an Optuna study in a log of lines of JSON, results/searches/NAME.log.

    optuna.load_study(study_name=SEARCH, storage=JournalStorage(JournalFileBackend(".../NAME.log")))

Optuna's tools open the log, also while the search goes on. The search itself stands in its file, which must
not have changed. The log of an untrusted results folder is safe to read: it is parsed as JSON, system
attributes, in which some samplers keep pickles, are not looked at, and nothing that it says is run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import check_distribution_compatibility
from optuna.storages import BaseStorage, JournalStorage
from optuna.storages.journal import BaseJournalBackend, JournalFileBackend
from optuna.trial import FrozenTrial, TrialState, create_trial

from pneuma.analysis.outcomes import check_outcome
from pneuma.config import Run
from pneuma.env.fields import read_fields
from pneuma.errors import UserError
from pneuma.files import parse_json, read_whole, to_json
from pneuma.search.optuna_study import STATES, create_study, distributions, ended_study
from pneuma.search.spec import Budget, Search, check_budget, load_search
from pneuma.search.trials import EndedTrial, Outcomes, PendingTrial, Task, Train, best_number, conduct
from pneuma.study.execute import check_environments
from pneuma.study.identity import config_id
from pneuma.study.locks import run_lock
from pneuma.study.store import PUBLISHED, Store, shipped_tables

VERSIONS = ("optuna", "rules", "engines")
"""Parts of a search's identity that the user does not choose."""
ABOUT = "pneuma"
"""The user attribute of a study that says which search it is."""
LARGEST_LOG = 2**28
"""Most bytes of a log that is read."""
MAKES_NO_SENSE = (KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""What reading an untrusted log raises."""


@dataclass(frozen=True)
class RecordedSearch:
    """A recorded search: its file, its budget, the trials that have ended, and whether others have begun."""

    task: Task
    trials: tuple[EndedTrial, ...]
    running: bool = False
    published: Path | None = None
    """Its log, if it is a published one, whose runs are not here."""

    @property
    def best(self) -> int | list[int] | None:
        """Return the number of the best trial; of several objectives, the Pareto front."""
        return best_number(self.trials, self.task.search)


def run_search(
    task: Task, store: Store, train: Train, say: Callable[[str], None]
) -> Iterator[list[EndedTrial]]:
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
        log, trials = _open_log(store, task, say), []
        for generation in conduct(task, train, Outcomes(task, store), log, say):
            trials += generation
            yield trials


# --- Writing ---------------------------------------------------------------------------------------


def log_path(store: Store, label: str) -> Path:
    return store.root / "searches" / f"{label}.log"


class JournalLog:
    """The log of a search that is being run, with the trials that ended before, by number.

    Only the process that holds the search's lock may use it.
    """

    def __init__(self, storage: BaseStorage, task: Task) -> None:
        self._task, self._storage = task, storage
        if not storage.get_all_studies():
            create_study(task.search, storage=storage)
        self._study = optuna.load_study(study_name=task.search.name, storage=storage)
        known = self._study.user_attrs.get(ABOUT)
        if not isinstance(known, dict) or known["trials_asked"] < task.budget.trials:
            about = {
                "search": task.search.name,
                "set": task.over,
                "digest": task.digest,
                "identity": task.identity,
                "trials_asked": task.budget.trials,
            }
            self._study.set_user_attr(ABOUT, json.loads(to_json(about)))
        self._noted = {trial.number: trial for trial in self._study.get_trials()}
        self.ended = {trial.number: trial for trial in _ended(self._noted.values(), task.search)}

    def begin(self, pending: PendingTrial) -> None:
        """Note a trial that was asked for; refuse it if another was noted by its number."""
        number, params = pending.trial.number, pending.trial.params
        if noted := self._noted.get(number):
            if noted.params != params:
                raise UserError(
                    f"trial {number} of the log of search {self._task.search.name} is not what the search "
                    "suggests; move the log away, and no run is trained twice"
                )
            return
        attributes: dict[str, Any] = {"seeds": [*self._task.budget.seeds], "run_ids": []}
        if pending.cells:
            ids = [cell.run_id for cell in pending.cells]
            attributes |= {"run_ids": ids, "config_id": config_id(pending.cells[0].run)}
        template = create_trial(
            state=TrialState.RUNNING,
            params=params,
            distributions=pending.trial.distributions,
            user_attrs=attributes,
        )
        made = self._storage.create_new_trial(self._study._study_id, template_trial=template)
        if self._storage.get_trial(made).number != number:
            raise UserError(
                f"another program added a trial to the log of search {self._task.search.name} meanwhile; "
                "move the log away, and no run is trained twice"
            )

    def report(self, number: int, step: int, value: float) -> None:
        """Note a value by which a trial is compared."""
        self._storage.set_trial_intermediate_value(self._id(number), step, value)

    def end(self, trial: EndedTrial) -> None:
        if trial.note:
            self._storage.set_trial_user_attr(self._id(trial.number), "note", trial.note)
        values = trial.values or None
        self._storage.set_trial_state_values(self._id(trial.number), STATES[trial.state], values)

    def _id(self, number: int) -> int:
        return self._storage.get_trial_id_from_study_id_trial_number(self._study._study_id, number)


def _open_log(store: Store, task: Task, say: Callable[[str], None]) -> JournalLog:
    """Open the log of a search: repair its last line, and set aside the log of an earlier search."""
    path = log_path(store, task.search.label)
    if path.is_symlink():
        raise UserError(f"{path}: is a link; remove it")
    if path.exists():
        data = read_whole(path, LARGEST_LOG)
        whole = data.rfind(b"\n") + 1
        if data and not whole and not data.startswith(b'{"op_code"'):
            raise _damaged(path)
        about = _read_study(path, task.search).user_attrs.get(ABOUT) if whole else None
        if whole < len(data):
            os.truncate(path, whole)
            say(f"{path}: its last line was cut off, and is left out")
        if isinstance(about, dict) and about.get("digest") != task.digest:
            _set_aside(path, about, task, say)
    Path(f"{path}.lock").unlink(missing_ok=True)  # left by a kill: Optuna would wait for it for ever
    try:
        return JournalLog(JournalStorage(JournalFileBackend(str(path.resolve()))), task)
    except MAKES_NO_SENSE:
        raise _damaged(path) from None


def _set_aside(path: Path, about: Mapping[str, Any], task: Task, say: Callable[[str], None]) -> None:
    """Rename the log of an earlier search, and take back that of this one if it was set aside."""
    digest = str(about.get("digest"))  # of a log that may be untrusted
    named = digest if digest.isalnum() and len(digest) <= 64 else "earlier"
    aside = path.with_name(f"{path.stem}.{named}.log")
    if os.path.lexists(aside):
        raise UserError(f"{aside}: is there already, and {path} is of the same search; move one away")
    try:
        changed = ", ".join(_changed(about.get("identity"), task))
    except MAKES_NO_SENSE:
        raise _damaged(path) from None
    os.replace(path, aside)
    say(f"the search so far had other {changed}: its log is now {aside}; its runs stay")
    before = path.with_name(f"{path.stem}.{task.digest}.log")
    if before.is_file() and not before.is_symlink():
        found = _read_study(before, task.search).user_attrs.get(ABOUT)
        if not isinstance(found, dict) or found.get("digest") != task.digest:
            raise _damaged(before)
        os.replace(before, path)
        say(f"the search goes on from the log {before}, which is now {path}")


def _damaged(path: Path) -> UserError:
    return UserError(f"{path}: damaged; move it away, and `pneuma search run` trains nothing twice")


# --- Reading ---------------------------------------------------------------------------------------


def read_record(store: Store, name: str, world: str | None = None, stored: bool = True) -> RecordedSearch:
    """Return a search that was run here, or else a published one; refuse one whose file has changed since.

    `name` and `world` are as in `load_search`. Without `stored`, published searches alone count.
    """
    search = load_search(name, world)
    own = log_path(store, search.label)
    if stored and own.exists() and own.stat().st_size:  # Optuna makes an empty file where it finds none
        return _read(own, search)
    if path := published_log(store, search.label):
        return replace(_read(path, search), published=path)
    raise UserError(
        f"search {search.label} was not run in {store.root}: `pneuma search run` it first, "
        "or name the folder with --results"
    )


def published_log(store: Store, label: str) -> Path | None:
    """Return the published log of a search, if there is one in the results folder or with Pneuma."""
    logs = [folder / f"search-{label}.log" for folder in (store.root / PUBLISHED, shipped_tables())]
    return next((path for path in logs if path.exists()), None)


class _Lines(BaseJournalBackend):
    """A log that is only read: whole lines of JSON, without a last one that is cut off."""

    def __init__(self, data: bytes) -> None:
        self._logs = [parse_json(line) for line in data[: data.rfind(b"\n") + 1].splitlines()]

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
        return iter(self._logs[log_number_from:])

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        raise PermissionError("this log is only read")


def _read_study(path: Path, search: Search) -> optuna.Study:
    """Return the study of a search in a log, which may be untrusted."""
    data = read_whole(path, LARGEST_LOG)
    try:
        storage = JournalStorage(_Lines(data))
        names = [str(study.study_name) for study in storage.get_all_studies()]
        if search.name in names:
            return optuna.load_study(study_name=search.name, storage=storage)
    except Exception:  # a line of JSON may be any operation, on anything
        raise _damaged(path) from None
    raise UserError(f"{path}: holds {', '.join(names) or 'no study'}, not search {search.name}; move it away")


def _read(path: Path, search: Search) -> RecordedSearch:
    """Return a search from its log, which may be untrusted, and its file."""
    study = _read_study(path, search)
    if ABOUT not in study.user_attrs and not study.get_trials(deepcopy=False):
        raise UserError(f"{path}: no trial was begun yet: `pneuma search run` it first")
    try:
        about = study.user_attrs[ABOUT]
        over = read_fields(Run, about["set"])
        identity = about["identity"]
        budget = Budget(trials=about["trials_asked"], seeds=identity["seeds"], steps=identity["steps"])
        search = search.with_settings(over)
        task = Task(search, budget, over)
        if changed := [spot for spot in _changed(identity, task) if spot.split(".")[0] not in VERSIONS]:
            raise UserError(
                f"{path}: the search had other {', '.join(changed)} than its file has now; search again"
            )
        noted = study.get_trials(deepcopy=False)
        ended = tuple(_ended(noted, search))
        return RecordedSearch(task, ended, running=len(ended) < len(noted))
    except MAKES_NO_SENSE:
        raise _damaged(path) from None


def _changed(identity: Any, task: Task) -> list[str]:
    """Return where a recorded search differs from this one, as keys with dots."""
    then, now = (
        {**each, "space": {one["name"]: one for one in each["space"]}}
        for each in (identity, json.loads(to_json(task.identity)))
    )
    return _differences("", then, now)


def _differences(key: str, one: Any, other: Any) -> list[str]:
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return [] if one == other else [key]
    names = {name: f"{key}.{name}" if key else name for name in {**one, **other}}
    return [
        spot for name, place in names.items() for spot in _differences(place, one.get(name), other.get(name))
    ]


def _ended(trials: Sequence[FrozenTrial] | Any, search: Search) -> list[EndedTrial]:
    """Return the trials that have ended, up to the first that has not.

    Raises ValueError for values that do not fit the search, and UserError for parameters outside its space.
    """
    names, ended, running = {state: name for name, state in STATES.items()}, [], False
    for trial in sorted(trials, key=lambda each: int(each.number)):
        if trial.state not in names:
            running = True
            continue
        if running or "run_ids" not in trial.user_attrs:
            raise UserError(
                f"the log of search {search.name}: another program ended trial {trial.number}; "
                "move the log away, and no run is trained twice"
            )
        if trial.state == TrialState.PRUNED and len(trial.values or ()) != 1:
            raise ValueError("a trial that was stopped early without a value")
        try:
            for name, distribution in distributions(search.space, trial.params).items():
                check_distribution_compatibility(distribution, trial.distributions[name])
        except ValueError:
            raise UserError(
                f"the log of search {search.name}: trial {trial.number} is outside the search's space; "
                "move the log away, and no run is trained twice"
            ) from None
        ended.append(
            EndedTrial(
                number=trial.number,
                params=trial.params,
                state=names[trial.state],
                values=tuple(map(float, trial.values or ())),
                run_ids=tuple(map(str, trial.user_attrs["run_ids"])),
                reports={int(step): float(value) for step, value in trial.intermediate_values.items()},
                note=str(trial.user_attrs.get("note", "")),
            )
        )
    ended_study(ended, search)  # refuses values that do not fit the search
    return ended


def trial_document(trial: EndedTrial, search: Search) -> dict[str, Any]:
    """Return a trial as JSON: `value` with one objective, `values` with several."""
    values = list(trial.values) if trial.state != "failed" else None
    one = {"value": values[0] if values else None}
    return {
        "number": trial.number,
        "params": dict(trial.params),
        **(one if len(search.objectives) == 1 else {"values": values}),
        "state": trial.state,
        "run_ids": list(trial.run_ids),
        "reports": {str(step): value for step, value in trial.reports.items()},
        "note": trial.note,
    }
