"""The log of a search: one Optuna study in a journal of JSON lines, which Optuna's own tools open.

    optuna.load_study(study_name=SEARCH, storage=JournalStorage(JournalFileBackend(".../NAME.log")))

A log may come from anybody: it is parsed as JSON and compared with the search's file, and nothing in it is
imported or unpickled. The search with other seeds, steps or another file has a log of its own,
`NAME.DIGEST.log`.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import math
import os
import re
import socket
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.storages.journal._file import BaseJournalFileLock
from optuna.trial import FrozenTrial, TrialState

from pneuma.config import ENGINE_VERSIONS, RULES_VERSION
from pneuma.errors import UserError, print_aside
from pneuma.files import names_in, write_error
from pneuma.search.spec import Budget, Search, load_search
from pneuma.store.store import PUBLISHED, Store
from pneuma.study.identity import user_files_digest
from pneuma.study.shipped import shipped_tables

ABOUT = "pneuma"
"""The user attribute of a study that says which search it is."""
STATES = {TrialState.COMPLETE: "complete", TrialState.PRUNED: "pruned", TrialState.FAIL: "failed"}
"""Of trials that have ended: a pruned one was stopped early, and a failed one has no value."""
COMPARED = ("base", "fixed", "objectives")
"""What a search's file must have as its log has it: without it trials mean something else."""


class LogLock(BaseJournalFileLock):
    """The right to write a log, which ends with the process that has it; Optuna's own locks outlive a kill.

    A process that has it may acquire it again.
    """

    WAIT_SECONDS = 10.0
    """Waiting longer, it says for whom."""

    def __init__(self, log: Path) -> None:
        self._log = log.resolve()
        self._path = self._log.with_name(f".{log.name}.lock")
        self._depth = 0
        self._file: BinaryIO

    def acquire(self) -> bool:
        if self._depth == 0:
            flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW
            self._file = os.fdopen(os.open(self._path, flags, 0o666), "a+b")
            self._wait()
            self._file.truncate(0)
            self._file.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
            self._file.flush()
            self._cut_torn_line()
        self._depth += 1
        return True

    def release(self) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._file.close()

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(self, *error: object) -> None:
        self.release()

    def _wait(self) -> None:
        message_time = time.monotonic() + self.WAIT_SECONDS
        while True:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                time.sleep(0.01)
            except OSError:  # there are no locks on this file system
                return
            if time.monotonic() > message_time:
                message_time = math.inf
                self._file.seek(0)
                holder = self._file.read().decode(errors="replace") or "another process"
                print_aside(f"Waiting for {holder}, which writes {self._log}.")

    def _cut_torn_line(self) -> None:
        """Cut off a line that a killed process has not finished; Optuna cannot read what follows it."""
        torn = self._torn_line()
        if torn:
            time.sleep(0.1)  # another program may be writing it
            if self._torn_line() == torn:
                os.truncate(self._log, self._log.stat().st_size - len(torn))

    def _torn_line(self) -> bytes:
        if not self._log.exists():
            return b""
        return self._log.read_bytes().rpartition(b"\n")[2]


@dataclass(frozen=True)
class Record:
    """A search with its trials. A published one has no runs here."""

    search: Search
    budget: Budget
    study: optuna.Study
    path: Path
    lock: LogLock
    published: bool = False

    @property
    def trials(self) -> list[FrozenTrial]:
        """All trials, also those that have not ended."""
        return self.study.get_trials(deepcopy=False)

    @property
    def ended(self) -> list[FrozenTrial]:
        return [trial for trial in self.trials if trial.state in STATES]

    @property
    def complete(self) -> list[FrozenTrial]:
        return [trial for trial in self.trials if trial.state == TrialState.COMPLETE]

    @property
    def best(self) -> int | list[int] | None:
        """The number of the best trial; of several objectives, the Pareto front."""
        if len(self.search.objectives) > 1:
            return sorted(trial.number for trial in self.study.best_trials)
        return self.study.best_trial.number if self.complete else None

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Let no other process write meanwhile."""
        try:
            with self.lock:
                yield
        except OSError as error:
            raise write_error(self.path, error) from None

    def document(self) -> dict[str, Any]:
        """Return it as JSON."""
        trials = []
        for trial in self.ended:
            reports = {str(step): value for step, value in trial.intermediate_values.items()}
            trials.append(
                {
                    "number": trial.number,
                    "params": trial.params,
                    "values": trial.values or [],
                    "state": STATES[trial.state],
                    "run_ids": trial.user_attrs.get("run_ids", []),
                    "reports": reports,
                    "note": str(trial.user_attrs.get("note", "")),
                }
            )
        return {
            "search": self.search.name,
            "trials_asked": self.budget.trials,
            "seeds": self.budget.seeds,
            "steps": self.budget.steps,
            "trials": trials,
            "best": self.best,
        }


# --- Writing ---------------------------------------------------------------------------------------


def open_record(store: Store, search: Search, budget: Budget, say: Callable[[str], None]) -> Record:
    """Return the record of a search, which is begun if there is none; other processes may write it too."""
    store.check_writable()
    identity = _identify(search, budget)
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:12]
    first_log = store.root / "searches" / f"{search.label}.log"
    own_log = first_log.with_name(f"{search.label}.{digest}.log")
    if not own_log.exists():
        record = _begin(first_log, search, budget, identity)
        changed = ", ".join(_changes(record.study, identity))
        if not changed:
            return record
        say(f"The search in {first_log} had other {changed}, and stays there; this one is in {own_log}.")
    return _begin(own_log, search, budget, identity)


def _begin(path: Path, search: Search, budget: Budget, identity: dict[str, Any]) -> Record:
    """Return the record in a log; a new log becomes this search's."""
    if path.is_symlink():
        raise UserError(f"{path}: is a link; remove it")
    lock = LogLock(path)
    with _explained(path, search):
        path.parent.mkdir(parents=True, exist_ok=True)
        with lock:
            study = _open_study(path, lock, search, identity, budget)
        return Record(search, budget, study, path, lock)


def _open_study(
    path: Path, lock: LogLock, search: Search, identity: dict[str, Any], budget: Budget
) -> optuna.Study:
    storage = JournalStorage(JournalFileBackend(str(path), lock))
    if not storage.get_all_studies():  # `create_study` would write a line each time
        storage.create_new_study(search.directions, search.name)
    study = _load_study(storage, search)
    if ABOUT not in study.user_attrs:
        names = []
        for objective in search.objectives.values():
            names.append(f"{objective.outcome}, {objective.over_seeds}")
        with warnings.catch_warnings(action="ignore"):  # it is experimental
            study.set_metric_names(names)
        about = {"search": search.name, "identity": identity, "trials_asked": budget.trials}
        study.set_user_attr(ABOUT, about)
    about = study.user_attrs[ABOUT]
    if not _changes(study, identity) and about["trials_asked"] < budget.trials:
        study.set_user_attr(ABOUT, {**about, "trials_asked": budget.trials})
    return study


def _identify(search: Search, budget: Budget) -> dict[str, Any]:
    """Return everything that the suggestions depend on, except the number of trials, as plain JSON."""
    user_code = [search.fields({})]
    for name, parameter in search.space.items():
        user_code += [search.fields({name: value}) for value in parameter.choices]
    for choice in (search.sampler, search.pruner):
        if choice and ":" in choice.name and not choice.name.startswith("optuna."):
            user_code.append({"env_module": choice.name.partition(":")[0]})
    identity = search.model_dump(exclude={"title", "section", "about", "presets"})
    identity["fixed"] = identity.pop("run")
    identity["objectives"] = list(identity["objectives"].values())
    identity |= {
        "seeds": budget.seeds,
        "steps": budget.steps,
        "user_code": sorted({user_files_digest(fields) for fields in user_code} - {""}),
        "optuna": optuna.__version__,
        "rules": RULES_VERSION,
        "engines": ENGINE_VERSIONS,
    }
    plain: dict[str, Any] = json.loads(json.dumps(identity))
    return plain


def _changes(study: optuna.Study, identity: dict[str, Any]) -> list[str]:
    begun_with = study.user_attrs[ABOUT]["identity"]
    return [key for key in identity if begun_with.get(key) != identity[key]]


# --- Reading ---------------------------------------------------------------------------------------


def read_record(store: Store, name: str, world: str | None = None) -> Record:
    """Return a search that was run here, or else a published one; `name` and `world` are as in `load_search`.

    Of several logs of a search, the one that was written last counts. One whose search's file has changed
    since is refused.
    """
    search = load_search(name, world)
    folder = store.root / "searches"
    pattern = re.escape(search.label) + r"(\.[0-9a-f]{12})?\.log"
    logs = [folder / file for file in names_in(folder) if re.fullmatch(pattern, file)]
    logs = [path for path in logs if path.stat().st_size]  # Optuna leaves an empty file
    if logs:
        return _read(max(logs, key=lambda path: path.stat().st_mtime_ns), search)
    return read_published(store, search)


def read_published(store: Store, search: Search) -> Record:
    """Return a search whose log is published in the results folder or comes with Pneuma."""
    for folder in (store.root / PUBLISHED, shipped_tables()):
        path = folder / f"search-{search.label}.log"
        if path.exists():
            return _read(path, search, published=True)
    raise UserError(
        f"search {search.label} was not run in {store.root}: `pneuma search run` it first, "
        "or name another results folder"
    )


def _read(path: Path, search: Search, published: bool = False) -> Record:
    lock = LogLock(path)
    with _explained(path, search):
        study = _load_study(JournalStorage(JournalFileBackend(str(path), lock)), search)
        about = study.user_attrs[ABOUT]
        seeds, steps = about["identity"]["seeds"], about["identity"]["steps"]
        budget = Budget(trials=about["trials_asked"], seeds=seeds, steps=steps)
        changed = [key for key in _changes(study, _identify(search, budget)) if key in COMPARED]
        if changed:
            raise UserError(
                f"{path}: the search had other {', '.join(changed)} than its file has now; "
                "change the file back, or search again"
            )
        return Record(search, budget, study, path, lock, published)


def _load_study(storage: JournalStorage, search: Search) -> optuna.Study:
    """Return the study of a log; ValueError or the like for one that cannot be the search's."""
    study = optuna.load_study(study_name=search.name, storage=storage)
    if study.directions != search.directions:
        raise ValueError("other directions")
    for trial in study.get_trials(deepcopy=False):
        numbers = [*(trial.values or ()), *trial.intermediate_values.values()]
        is_whole = trial.state != TrialState.COMPLETE or len(trial.values) == len(search.objectives)
        if not (is_whole and all(map(math.isfinite, numbers)) and search.holds(trial.params)):
            raise ValueError(f"trial {trial.number} is not the search's")
    return study


@contextmanager
def _explained(path: Path, search: Search) -> Iterator[None]:
    """Say in a line what cannot be read; a line of JSON may be any operation, on anything."""
    try:
        yield
    except UserError:
        raise
    except OSError as error:
        raise write_error(path, error) from None
    except Exception as error:
        reason = str(error) or type(error).__name__
        raise UserError(
            f"{path}: not a whole log of search {search.name} ({reason}); move it away, "
            "and no run is trained twice"
        ) from None
