"""The log of a search: one Optuna study in a journal of JSON lines, which Optuna's own tools open.

    optuna.load_study(study_name=SEARCH, storage=JournalStorage(JournalFileBackend(".../NAME.DIGEST.log")))

A log may be untrusted: it is parsed as JSON and compared with the search's file. Nothing in it is imported or
unpickled. DIGEST is of all that the suggestions depend on: the file, seeds, steps, and versions.
"""

from __future__ import annotations

import json
import math
import os
import re
import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import BaseJournalBackend, JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from pneuma.config import ENGINE_VERSIONS, RULES_VERSION
from pneuma.errors import UserError, print_aside
from pneuma.files import checksum, names_in, open_stored, read_stored, stored_file
from pneuma.schema import read_toml
from pneuma.search.optuna_private import BaseJournalFileLock
from pneuma.search.spec import Budget, Search, load_search
from pneuma.store.locks import take_lock
from pneuma.store.store import PUBLISHED, Store
from pneuma.study.identity import user_files_digest
from pneuma.study.shipped import read_published_file, shipped_tables

ABOUT = "pneuma"
"""The user attribute of a study that holds which search it is."""
STATES = {TrialState.COMPLETE: "complete", TrialState.PRUNED: "pruned", TrialState.FAIL: "failed"}
"""Of trials that have ended: a pruned one was stopped early, and a failed one has no value."""
COMPARED = ("base", "fixed", "objectives")
"""What a search's file must have as its log has it: without it trials mean something else."""

WORDS = ("title", "section", "about", "presets")
"""Keys of a search's file that suggestions do not depend on; of a preset they depend on seeds and steps."""


class ReadLog(BaseJournalBackend):
    """A log that is only read, as it was when it was opened; its last line may be unfinished."""

    def __init__(self, contents: bytes) -> None:
        self._lines = contents.split(b"\n")[:-1]

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
        for line in self._lines[log_number_from:]:
            yield json.loads(line)

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        raise NotImplementedError


class LogLock(BaseJournalFileLock):
    """The right to append to a log. It ends with the process that has it; Optuna's own locks outlive a kill.

    Whoever gets it removes a line that a killed process has not finished: Optuna cannot read what follows.
    """

    WAIT_SECONDS = 10.0
    """After this time it prints for whom it waits."""

    def __init__(self, log_path: Path) -> None:
        self._log, self._has_told = log_path.resolve(), False
        self._file: BinaryIO

    def acquire(self) -> bool:
        lock_path = self._log.with_name(f".{self._log.name}.lock")
        self._file = open(lock_path, "a+b", opener=open_stored)  # noqa: SIM115 (`release` closes it)
        message_time = time.monotonic() + self.WAIT_SECONDS
        while not take_lock(self._file):
            if time.monotonic() > message_time and not self._has_told:
                self._has_told = True
                self._file.seek(0)
                holder = self._file.read().decode(errors="replace") or "another process"
                print_aside(f"Waiting for {holder}, which writes {self._log}.")
        self._file.truncate(0)
        self._file.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
        self._file.flush()
        with open(self._log, "r+b", opener=open_stored) as log_file:
            log_file.seek(max(log_file.seek(0, os.SEEK_END) - 1, 0))
            if log_file.read() not in (b"", b"\n"):
                log_file.seek(0)
                log_file.truncate(log_file.read().rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        self._file.close()


@dataclass(frozen=True)
class Record:
    """A search with its trials. A published one has no runs here."""

    search: Search
    budget: Budget
    study: optuna.Study
    path: Path
    published: bool = False

    @property
    def trials(self) -> list[FrozenTrial]:
        """All trials, also those that have not ended."""
        return self.study.get_trials(deepcopy=False)

    @property
    def ended(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False, states=tuple(STATES))

    @property
    def complete(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))

    @property
    def best(self) -> int | list[int] | None:
        """The number of the best trial; of several objectives, the Pareto front."""
        if len(self.search.objectives) > 1:
            return sorted(trial.number for trial in self.study.best_trials)
        return self.study.best_trial.number if self.complete else None


# --- Writing ---------------------------------------------------------------------------------------


def open_record(store: Store, search: Search, budget: Budget) -> Record:
    """Return the record of a search, and begin it if there is none; other processes may write it too."""
    store.check_writable()
    identity = _identify(search, budget)
    digest = checksum(json.dumps(identity, sort_keys=True).encode())[:12]
    log_path = store.root / "searches" / f"{search.label}.{digest}.log"
    with stored_file(log_path):
        log_path.parent.mkdir(parents=True, exist_ok=True)
        open(log_path, "a+b", opener=open_stored).close()  # Optuna opens it by its name
        storage = JournalStorage(JournalFileBackend(str(log_path), LogLock(log_path)))
        if not storage.get_all_studies():  # `create_study` would write a line each time
            optuna.create_study(
                storage=storage, study_name=search.name, directions=search.directions, load_if_exists=True
            )
        study = _load_study(storage, search)
        if study.user_attrs.get(ABOUT, {}).get("trials_asked", 0) < budget.trials:
            about = {"search": search.name, "identity": identity, "trials_asked": budget.trials}
            study.set_user_attr(ABOUT, about)
        return Record(search, budget, study, log_path)


def _identify(search: Search, budget: Budget) -> dict[str, Any]:
    """Return everything that the suggestions depend on, except the number of trials, as plain JSON."""
    objectives = []
    for objective_name, objective in search.objectives.items():
        objectives.append({"name": objective_name, **objective.model_dump()})
    user_code = {user_files_digest(search.fields({}))}
    for parameter_name, parameter in search.space.items():
        for choice in parameter.choices:
            user_code.add(user_files_digest(search.fields({parameter_name: choice})))
    file_contents = read_toml(search.path).data
    identity = {
        "base": search.base,
        "fixed": search.run,
        "objectives": objectives,
        "file": {file_key: value for file_key, value in file_contents.items() if file_key not in WORDS},
        "seeds": budget.seeds,
        "steps": budget.steps,
        "user_code": sorted(user_code),
        "optuna": optuna.__version__,
        "rules": RULES_VERSION,
        "engines": ENGINE_VERSIONS,
    }
    plain_identity: dict[str, Any] = json.loads(json.dumps(identity))
    return plain_identity


# --- Reading ---------------------------------------------------------------------------------------


def read_record(store: Store, search_name: str, world: str | None = None) -> Record:
    """Return a search that was run here, or else a published one; the arguments are those of `load_search`.

    Of several logs of a search, the one that was written last counts. One whose search's file has changed
    since is refused.
    """
    search = load_search(search_name, world)
    folder = store.root / "searches"
    log_paths = []
    for file_name in names_in(folder):
        is_log = re.fullmatch(re.escape(search.label) + r"(\.[0-9a-f]{12})?\.log", file_name)
        if is_log and (folder / file_name).lstat().st_size:  # a search may be stopped before its first line
            log_paths.append(folder / file_name)
    if log_paths:
        return _read(max(log_paths, key=lambda log_path: log_path.lstat().st_mtime_ns), search)
    return read_published(store, search)


def read_published(store: Store, search: Search) -> Record:
    """Return a search whose log is published in the results folder or comes with Pneuma."""
    for folder in (store.root / PUBLISHED, shipped_tables()):
        log_path = folder / f"search-{search.label}.log"
        if os.path.lexists(log_path):
            return _read(log_path, search, is_published=True)
    raise UserError(
        f"search {search.label} was not run in {store.root}: start it with `{_run_command(search)}`, "
        "or name another results folder"
    )


def _run_command(search: Search) -> str:
    words = ["pneuma search run", search.name]
    if search.label != search.name:
        words += ["--world", search.world]
    return " ".join(words)


def _read(log_path: Path, search: Search, is_published: bool = False) -> Record:
    with stored_file(log_path):
        contents = read_published_file(log_path) if is_published else read_stored(log_path)
        study = _load_study(JournalStorage(ReadLog(contents)), search)
        about = study.user_attrs[ABOUT]
        stored_identity = about["identity"]
        budget = Budget(
            trials=about["trials_asked"], seeds=stored_identity["seeds"], steps=stored_identity["steps"]
        )
        identity = _identify(search, budget)
        changed = [
            identity_key
            for identity_key in COMPARED
            if stored_identity.get(identity_key) != identity[identity_key]
        ]
        if changed:
            raise UserError(
                f"{log_path}: its file now has other {', '.join(changed)} than when the search began; "
                "undo that change, or search under a new name"
            )
        return Record(search, budget, study, log_path, is_published)


def _load_study(storage: JournalStorage, search: Search) -> optuna.Study:
    """Return the study of a log; ValueError or the like for one that cannot be the search's."""
    study = optuna.load_study(study_name=search.name, storage=storage)
    if study.directions != search.directions:
        raise ValueError("other directions")
    for trial in study.get_trials(deepcopy=False):
        reported_values = list(trial.values or ()) + list(trial.intermediate_values.values())
        is_whole = trial.state != TrialState.COMPLETE or len(trial.values) == len(search.objectives)
        are_ids = all(isinstance(run_id, str) for run_id in trial.user_attrs.get("run_ids", []))
        if not (
            is_whole and are_ids and all(map(math.isfinite, reported_values)) and search.holds(trial.params)
        ):
            raise ValueError(f"trial {trial.number} is not the search's")
    return study
