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
from pneuma.files import names_in
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


# --- The lock --------------------------------------------------------------------------------------


class LogLock(BaseJournalFileLock):
    """The right to write a log, which ends with the process that has it.

    Optuna's own locks outlive a process that is killed. A process may acquire it again while it holds it.
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
        said = False
        begin = time.monotonic()
        while True:
            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            except BlockingIOError:
                time.sleep(0.01)
            except OSError:  # there are no locks on this file system
                return
            if not said and time.monotonic() - begin > self.WAIT_SECONDS:
                said = True
                self._file.seek(0)
                holder = self._file.read().decode(errors="replace") or "another process"
                print_aside(f"Waiting for {holder}, which writes {self._log}.")

    def _cut_torn_line(self) -> None:
        """Cut off a line that a killed process has not finished; Optuna cannot read what follows it."""
        torn = _torn_line(self._log)
        if torn:
            time.sleep(0.1)  # another program may be writing it
            if _torn_line(self._log) == torn:
                os.truncate(self._log, self._log.stat().st_size - len(torn))


def _torn_line(log: Path) -> bytes:
    data = log.read_bytes() if log.exists() else b""
    return data[data.rfind(b"\n") + 1 :]


# --- The record ------------------------------------------------------------------------------------


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
            raise UserError(f"{self.path}: cannot be written ({error.strerror})") from None

    def document(self) -> dict[str, Any]:
        """Return it as JSON."""
        trials = []
        for trial in self.ended:
            reports = {str(step): value for step, value in trial.intermediate_values.items()}
            trials.append(
                {
                    "number": trial.number,
                    "params": trial.params,
                    "values": [] if trial.state == TrialState.FAIL else trial.values,
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


def identify(search: Search, budget: Budget) -> dict[str, Any]:
    """Return everything that the suggestions depend on, except the number of trials, as plain JSON."""
    choices = [search.sampler.model_dump(), search.pruner and search.pruner.model_dump()]
    modules = [choice["name"].rpartition(":")[0] for choice in choices if choice]
    user_code = [search.fields({}), *({"env_module": name} for name in modules if not _is_optunas(name))]
    for name, parameter in search.space.items():
        user_code += [search.fields({name: value}) for value in parameter.choices]
    identity = {
        "base": search.base,
        "fixed": search.run,
        "space": {name: parameter.identity for name, parameter in search.space.items()},
        "objectives": [objective.model_dump() for objective in search.objectives.values()],
        "start": [search.params_of(start) for start in search.start],
        "generation": search.generation,
        "sampler": choices[0],
        "sampler_seed": search.sampler_seed,
        "pruner": choices[1],
        "seeds": budget.seeds,
        "steps": budget.steps,
        "user_code": sorted({user_files_digest(fields) for fields in user_code} - {""}),
        "optuna": optuna.__version__,
        "rules": RULES_VERSION,
        "engines": ENGINE_VERSIONS,
    }
    plain: dict[str, Any] = json.loads(json.dumps(identity, default=list))
    return plain


def _is_optunas(module: str) -> bool:
    return module.partition(".")[0] in ("", "optuna")


def open_record(store: Store, search: Search, budget: Budget, say: Callable[[str], None]) -> Record:
    """Return the record of a search, which is begun if there is none; other processes may write it too."""
    store.check_writable()
    identity = identify(search, budget)
    digest = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:12]
    usual = store.root / "searches" / f"{search.label}.log"
    own = usual.with_name(f"{search.label}.{digest}.log")
    usual.parent.mkdir(parents=True, exist_ok=True)
    paths = [own] if own.exists() else [usual, own]
    for path in paths:
        if path.is_symlink():
            raise UserError(f"{path}: is a link; remove it")
        record, begun_with = _begin(path, search, budget, identity)
        changed = [key for key in identity if begun_with.get(key) != identity[key]]
        if not changed:
            return record
        say(f"the search so far had other {', '.join(changed)}, and stays in {path}; this one is in {own}")
    raise _damaged(own)


def _begin(
    path: Path, search: Search, budget: Budget, identity: dict[str, Any]
) -> tuple[Record, dict[str, Any]]:
    """Return the record in a log, and the identity of its search; a new log becomes this search's."""
    with _explained(path):
        lock = LogLock(path)
        storage = JournalStorage(JournalFileBackend(str(path), lock))
        with lock:
            if not storage.get_all_studies():  # `create_study` would write a line each time
                storage.create_new_study(search.directions, search.name)
            study = _load_study(storage, path, search)
            about = study.user_attrs.get(ABOUT)
            if about is None:
                names = [f"{one.outcome}, {one.over_seeds}" for one in search.objectives.values()]
                with warnings.catch_warnings(action="ignore"):  # it is experimental
                    study.set_metric_names(names)
                about = {"search": search.name, "identity": identity, "trials_asked": 0}
            if about["identity"] == identity and about["trials_asked"] < budget.trials:
                study.set_user_attr(ABOUT, {**about, "trials_asked": budget.trials})
        return Record(search, budget, study, path, lock), about["identity"]


# --- Reading ---------------------------------------------------------------------------------------


def read_record(store: Store, name: str, world: str | None = None, stored: bool = True) -> Record:
    """Return a search that was run here, or else a published one.

    `name` and `world` are as in `load_search`. Of several logs of a search, the one that was written last
    counts. One whose search's file has changed since is refused. Without `stored`, published ones are read.
    """
    search = load_search(name, world)
    folder = store.root / "searches"
    pattern = re.escape(search.label) + r"(\.[0-9a-f]{12})?\.log"
    logs = [folder / file for file in names_in(folder) if re.fullmatch(pattern, file)]
    logs = [path for path in logs if stored and path.stat().st_size]  # Optuna leaves an empty file
    published = published_log(store, search.label)
    if logs:
        return _read(max(logs, key=lambda path: path.stat().st_mtime_ns), search)
    if published:
        return _read(published, search, published=True)
    raise UserError(
        f"search {search.label} was not run in {store.root}: `pneuma search run` it first, "
        "or name another results folder"
    )


def published_log(store: Store, label: str) -> Path | None:
    """Return the published log of a search, if there is one in the results folder or with Pneuma."""
    for folder in (store.root / PUBLISHED, shipped_tables()):
        path = folder / f"search-{label}.log"
        if path.exists():
            return path
    return None


def _read(path: Path, search: Search, published: bool = False) -> Record:
    with _explained(path):
        lock = LogLock(path)
        study = _load_study(JournalStorage(JournalFileBackend(str(path), lock)), path, search)
        about = study.user_attrs.get(ABOUT)
        if about is None:
            raise UserError(f"{path}: no trial was begun yet: `pneuma search run` it first")
        begun_with = about["identity"]
        budget = Budget(trials=about["trials_asked"], seeds=begun_with["seeds"], steps=begun_with["steps"])
        identity = identify(search, budget)
        changed = [key for key in COMPARED if begun_with[key] != identity[key]]
        if changed:
            raise UserError(
                f"{path}: the search had other {', '.join(changed)} than its file has now; "
                "change the file back, or search again"
            )
        return Record(search, budget, study, path, lock, published)


def _load_study(storage: JournalStorage, path: Path, search: Search) -> optuna.Study:
    """Return the study of a log, whose trials are the search's."""
    names = [study.study_name for study in storage.get_all_studies()]
    if search.name not in names:
        contents = ", ".join(names) or "no study"
        raise UserError(f"{path}: contains {contents}, not search {search.name}; move it away")
    study = optuna.load_study(study_name=search.name, storage=storage)
    if study.directions != search.directions:
        raise UserError(f"{path}: the search had other directions; move it away")
    for trial in study.get_trials(deepcopy=False):
        if not search.holds(trial.params):
            raise UserError(
                f"{path}: trial {trial.number} is outside the search's space; move the log away, "
                "and no run is trained twice"
            )
        numbers = [*(trial.values or ()), *trial.intermediate_values.values()]
        if not all(map(math.isfinite, numbers)):
            raise ValueError("values that no trial can have")
        if trial.state == TrialState.COMPLETE and len(trial.values) != len(search.objectives):
            raise ValueError("values of other objectives")
    return study


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Say in a line what cannot be read; a line of JSON may be any operation, on anything."""
    try:
        yield
    except UserError:
        raise
    except OSError as error:
        raise UserError(f"{error.filename or path}: cannot be opened ({error.strerror})") from None
    except Exception:
        raise _damaged(path) from None


def _damaged(path: Path) -> UserError:
    return UserError(
        f"{path}: damaged, or of another version of Optuna; move it away, and no run is trained twice"
    )
