"""The log of a search in a results folder: one Optuna study, in lines of JSON that Optuna's tools open.

    optuna.load_study(study_name=SEARCH, storage=JournalStorage(JournalFileBackend(".../NAME.log")))

An entry is several lines, which are there whole or not at all: the suggestions of a generation, a comparison
of a trial, the ends of a generation. So a search that was killed goes on from its last entry. The log of an
untrusted results folder is safe to read: it is parsed as JSON, checked, and nothing that it says is run.
"""

from __future__ import annotations

import json
import math
import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import optuna
from optuna.distributions import check_distribution_compatibility
from optuna.exceptions import ExperimentalWarning
from optuna.storages import JournalStorage
from optuna.storages.journal import BaseJournalBackend
from optuna.trial import FrozenTrial, TrialState

from pneuma.config import Run
from pneuma.env.fields import read_fields
from pneuma.errors import UserError
from pneuma.files import parse_json, read_whole, to_json
from pneuma.search.samplers import make_pruner
from pneuma.search.spec import Budget, Search, load_search
from pneuma.search.task import VERSIONS, Task
from pneuma.study.store import PUBLISHED, Store, shipped_tables

ABOUT = "pneuma"
"""The user attribute of a study that says which search it is."""
STATES = {TrialState.COMPLETE: "complete", TrialState.PRUNED: "pruned", TrialState.FAIL: "failed"}
"""Of trials that have ended: a pruned one was stopped early, and a failed one has no value."""
LARGEST_LOG = 2**28
"""Most bytes of a log that is read."""
MAKES_NO_SENSE = (KeyError, TypeError, ValueError, AttributeError, OverflowError)
"""What reading an untrusted log raises."""


class Journal(BaseJournalBackend):
    """Lines of JSON, as Optuna's own backend writes them; all lines of an entry but its last have `more`.

    Only the process that holds the search's lock may write. Without a path nothing is kept.
    """

    def __init__(self, path: Path | None = None, data: bytes = b"") -> None:
        self.size, self._path = 0, path
        self._logs: list[dict[str, Any]] = []
        self._unwritten, self._held = list[str](), False
        entry: list[dict[str, Any]] = []
        place = 0
        for line in data[: data.rfind(b"\n") + 1].splitlines(keepends=True):
            entry.append(parse_json(line))
            place += len(line)
            if not entry[-1].get("more"):
                self._logs += entry
                self.size, entry = place, []

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
        return iter(self._logs[log_number_from:])

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        lines = [json.dumps(log, separators=(",", ":")) for log in logs]
        self._logs += map(json.loads, lines)
        self._unwritten += lines
        if not self._held:
            self._write()

    @contextmanager
    def together(self) -> Iterator[None]:
        """Write what is appended meanwhile as one entry."""
        self._held = True
        yield
        self._held = False
        self._write()

    def _write(self) -> None:
        lines, self._unwritten = self._unwritten, []
        if not lines or self._path is None:
            return
        more = [f'{line[:-1]},"more":true}}\n' for line in lines[:-1]]
        entry = "".join([*more, lines[-1] + "\n"]).encode()
        try:
            with self._path.open("ab") as file:
                if os.fstat(file.fileno()).st_size != self.size:
                    raise UserError(
                        f"another program wrote into {self._path} meanwhile; "
                        "the same command goes on, if it added no trial"
                    )
                file.write(entry)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise UserError(f"{self._path}: cannot be written ({error.strerror})") from None
        self.size += len(entry)


@dataclass(frozen=True)
class SearchLog:
    """A search that is being run: its task, and its study in the log."""

    task: Task
    study: optuna.Study
    journal: Journal

    @property
    def trials(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False)

    def note(self, number: int, key: str, value: Any) -> None:
        self.study._storage.set_trial_user_attr(self._id(number), key, value)

    def report(self, number: int, step: int, value: float) -> None:
        """Note a value by which a trial is compared."""
        self.study._storage.set_trial_intermediate_value(self._id(number), step, value)

    def _id(self, number: int) -> int:
        return self.study._storage.get_trial_id_from_study_id_trial_number(self.study._study_id, number)


@dataclass(frozen=True)
class RecordedSearch:
    """A recorded search: its task, its study, the trials that have ended, and whether others have begun."""

    task: Task
    study: optuna.Study
    trials: tuple[FrozenTrial, ...]
    running: bool = False
    published: Path | None = None
    """Its log, if it is a published one, whose runs are not here."""

    @property
    def best(self) -> int | list[int] | None:
        """Return the number of the best trial; of several objectives, the Pareto front."""
        return best_number(self.trials, self.task.search)


def best_number(trials: Any, search: Search) -> int | list[int] | None:
    """Return the number of the best trial, the first of equals; with several objectives, the Pareto front."""
    signs = [1 if objective.direction == "maximize" else -1 for objective in search.objectives]
    found = {
        trial.number: [sign * value for sign, value in zip(signs, trial.values, strict=True)]
        for trial in trials
        if trial.state == TrialState.COMPLETE
    }
    if len(signs) == 1:
        return max(found, key=lambda number: found[number], default=None)

    def beats(one: list[float], other: list[float]) -> bool:
        return one != other and all(mine >= its for mine, its in zip(one, other, strict=True))

    return [number for number, own in found.items() if not any(beats(each, own) for each in found.values())]


# --- Writing ---------------------------------------------------------------------------------------


def log_path(store: Store, label: str) -> Path:
    return store.root / "searches" / f"{label}.log"


def open_log(store: Store, task: Task, say: Callable[[str], None]) -> SearchLog:
    """Open the log of a search: cut off an entry that is not whole, and set aside that of an earlier search.

    Only the process that holds the search's lock may call this.
    """
    path = log_path(store, task.search.label)
    if path.is_symlink():
        raise UserError(f"{path}: is a link; remove it")
    if path.exists() and (size := path.stat().st_size):
        journal = _read_journal(path)
        about = _study_in(journal, path, task.search).user_attrs.get(ABOUT) if journal.size else None
        if journal.size < size:
            os.truncate(path, journal.size)
            say(f"{path}: its last entry was cut off, and is left out")
        if isinstance(about, dict) and about.get("digest") != task.digest:
            _set_aside(path, about, task, say)
    path.parent.mkdir(parents=True, exist_ok=True)
    journal = _read_journal(path) if path.exists() else Journal(path)
    try:
        log = begin_log(task, journal)
        _sound_trials(log.study, task.search)
    except MAKES_NO_SENSE:
        raise _damaged(path) from None
    return log


def begin_log(task: Task, journal: Journal) -> SearchLog:
    """Return the study of a search in a journal, which is made if it is empty."""
    search, storage = task.search, JournalStorage(journal)
    with journal.together(), warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        if not storage.get_all_studies():  # `load_if_exists` would write a line each time
            storage.create_new_study([*search.directions], search.name)
        study = optuna.load_study(
            study_name=search.name, storage=storage, pruner=make_pruner(search.spec.pruner)
        )
        known = study.user_attrs.get(ABOUT)
        if not isinstance(known, dict):
            study.set_metric_names([f"{each.outcome}, {each.over_seeds}" for each in search.objectives])
        if not isinstance(known, dict) or known["trials_asked"] < task.budget.trials:
            about = {
                "search": search.name,
                "set": task.over,
                "digest": task.digest,
                "identity": task.identity,
                "trials_asked": task.budget.trials,
            }
            study.set_user_attr(ABOUT, json.loads(to_json(about)))
    return SearchLog(task, study, journal)


def _set_aside(path: Path, about: Mapping[str, Any], task: Task, say: Callable[[str], None]) -> None:
    """Rename the log of an earlier search, and take back that of this one if it was set aside."""
    digest = str(about.get("digest"))  # of a log that may be untrusted
    named = digest if digest.isalnum() and len(digest) <= 64 else "earlier"
    aside = path.with_name(f"{path.stem}.{named}.log")
    if os.path.lexists(aside):
        raise UserError(f"{aside}: is there already, and {path} is of the same search; move one away")
    try:
        changed = ", ".join(task.changes_since(about.get("identity")))
    except MAKES_NO_SENSE:
        raise _damaged(path) from None
    os.replace(path, aside)
    say(f"the search so far had other {changed}: its log is now {aside}; its runs stay")
    before = path.with_name(f"{path.stem}.{task.digest}.log")
    if before.is_file() and not before.is_symlink():
        found = _study_in(_read_journal(before), before, task.search).user_attrs.get(ABOUT)
        if not isinstance(found, dict) or found.get("digest") != task.digest:
            raise _damaged(before)
        os.replace(before, path)
        say(f"the search goes on from the log {before}, which is now {path}")


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


def _read_journal(path: Path) -> Journal:
    data = read_whole(path, LARGEST_LOG)
    if data and b"\n" not in data and not data.startswith(b'{"op_code"'):
        raise _damaged(path)
    try:
        return Journal(path, data)
    except MAKES_NO_SENSE:
        raise _damaged(path) from None


def _study_in(journal: Journal, path: Path, search: Search) -> optuna.Study:
    """Return the study of a search in a log, which may be untrusted."""
    try:
        storage = JournalStorage(journal)
        names = [str(study.study_name) for study in storage.get_all_studies()]
        if search.name in names:
            return optuna.load_study(study_name=search.name, storage=storage)
    except Exception:  # a line of JSON may be any operation, on anything
        raise _damaged(path, journal) from None
    raise UserError(f"{path}: holds {', '.join(names) or 'no study'}, not search {search.name}; move it away")


def _read(path: Path, search: Search) -> RecordedSearch:
    """Return a search from its log, which may be untrusted, and its file."""
    study = _study_in(_read_journal(path), path, search)
    if ABOUT not in study.user_attrs and not study.get_trials(deepcopy=False):
        raise UserError(f"{path}: no trial was begun yet: `pneuma search run` it first")
    try:
        about = study.user_attrs[ABOUT]
        over = read_fields(Run, about["set"])
        identity = about["identity"]
        budget = Budget(trials=about["trials_asked"], seeds=identity["seeds"], steps=identity["steps"])
        search = search.with_settings(over)
        task = Task(search, budget, over)
        changed = [spot for spot in task.changes_since(identity) if spot.split(".")[0] not in VERSIONS]
        if changed:
            raise UserError(
                f"{path}: the search had other {', '.join(changed)} than its file has now; search again"
            )
        ended = tuple(_sound_trials(study, search))
        begun = study.get_trials(deepcopy=False)[: budget.trials]
        return RecordedSearch(task, study, ended, running=len(ended) < len(begun))
    except MAKES_NO_SENSE:
        raise _damaged(path) from None


def _sound_trials(study: optuna.Study, search: Search) -> list[FrozenTrial]:
    """Return the trials of a log that have ended, if all fit the search.

    Raises ValueError or the like for values that make no sense, and UserError for what another program did.
    """
    if study.directions != search.directions:
        raise ValueError("other directions than the search's")
    distributions = {parameter.name: parameter.distribution for parameter in search.space.parameters}
    ended, running = [], False
    for trial in study.get_trials(deepcopy=False):
        of_search = "run_ids" in trial.user_attrs
        if trial.state not in STATES:
            running = True
            continue
        if not of_search or (running and trial.state != TrialState.PRUNED):
            raise _other_program(search, f"ended trial {trial.number}")
        if {*trial.params} - {*distributions}:
            raise _outside(search, trial)
        for name in trial.params:
            try:
                check_distribution_compatibility(distributions[name], trial.distributions[name])
            except ValueError:
                raise _outside(search, trial) from None
        numbers = [float(value) for value in (*(trial.values or ()), *trial.intermediate_values.values())]
        wanted = {TrialState.COMPLETE: len(search.objectives), TrialState.PRUNED: 1, TrialState.FAIL: 0}
        if len(trial.values or ()) != wanted[trial.state] or not all(map(math.isfinite, numbers)):
            raise ValueError("values that no search can have")
        if not all(isinstance(name, str) for name in [*trial.user_attrs["run_ids"]]):
            raise ValueError("runs that no search can have")
        ended.append(trial)
    return ended


def _outside(search: Search, trial: FrozenTrial) -> UserError:
    return UserError(
        f"the log of search {search.name}: trial {trial.number} is outside the search's space; "
        "move the log away, and no run is trained twice"
    )


def _other_program(search: Search, what: str) -> UserError:
    return UserError(
        f"the log of search {search.name}: another program {what}; "
        "move the log away, and no run is trained twice"
    )


def _damaged(path: Path, journal: Journal | None = None) -> UserError:
    """Return what is said of a log that cannot be read, perhaps as another version of Optuna wrote it."""
    with suppress(*MAKES_NO_SENSE):
        for log in journal.read_logs(0) if journal else ():
            version = log.get("user_attr", {}).get(ABOUT, {}).get("identity", {}).get("optuna")
            if version and version != optuna.__version__:
                return UserError(
                    f"{path}: Optuna {str(version)[:20]} wrote it, which {optuna.__version__} cannot read; "
                    "install that version, or move the log away, and no run is trained twice"
                )
    return UserError(f"{path}: damaged; move it away, and `pneuma search run` trains nothing twice")


def trial_document(trial: FrozenTrial, search: Search) -> dict[str, Any]:
    """Return a trial as JSON: `value` with one objective, `values` with several."""
    values = None if trial.state == TrialState.FAIL else trial.values
    one = {"value": values[0] if values else None}
    return {
        "number": trial.number,
        "params": trial.params,
        **(one if len(search.objectives) == 1 else {"values": values}),
        "state": STATES[trial.state],
        "run_ids": trial.user_attrs["run_ids"],
        "reports": {str(step): value for step, value in trial.intermediate_values.items()},
        "note": str(trial.user_attrs.get("note", "")),
    }
