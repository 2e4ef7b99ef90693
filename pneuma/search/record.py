"""A search with its budget, and its record in a results folder: one Optuna study in a journal.

    optuna.load_study(study_name=SEARCH, storage=JournalStorage(JournalFileBackend(".../NAME.log")))

A record may be anybody's: it is parsed as JSON and held against the search's file, and nothing that it says
is run. The search with other steps, or another file, has a record of its own, `NAME.DIGEST.log`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import optuna
from optuna.exceptions import ExperimentalWarning
from optuna.storages import JournalStorage
from optuna.trial import FrozenTrial, TrialState

from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run
from pneuma.errors import UserError
from pneuma.files import names_in, read_whole
from pneuma.search.journal import LARGEST_LOG, Journal
from pneuma.search.samplers import make_pruner
from pneuma.search.spec import Budget, Search, load_search
from pneuma.store.store import PUBLISHED, Store
from pneuma.study.identity import user_files_digest
from pneuma.study.shipped import shipped_tables

ABOUT = "pneuma"
"""The user attribute of a study that says which search it is."""
FORMAT = 3
"""Of records; raised when one that was begun before would go on with other suggestions or runs."""
VERSIONS = ("optuna", "rules", "engines", "format")
"""Parts of a search's identity that the user does not choose."""
STATES = {TrialState.COMPLETE: "complete", TrialState.PRUNED: "pruned", TrialState.FAIL: "failed"}
"""Of trials that have ended: a pruned one was stopped early, and a failed one has no value."""


def common_steps(runs: Iterable[Run], steps: int) -> int:
    """Return the least steps from `steps` on that are whole updates of all runs.

    Where they would be more than twice as many, `steps` are returned: each run rounds them up for itself.
    """
    common = math.lcm(*(run.steps_per_update for run in runs))
    whole = -(-steps // common) * common
    return whole if whole <= 2 * steps else steps


@dataclass(frozen=True)
class Task:
    """A search with its budget, whose steps are those of each run."""

    search: Search
    budget: Budget

    @property
    def identity(self) -> dict[str, Any]:
        """Return everything that the suggestions depend on, except the number of trials."""
        search = self.search
        values = [{key: value} for key, value in search.run.items()]
        values += [{key: value} for key, each in search.space.items() for value in each.choices.values()]
        for name in (search.sampler.name, search.pruner.name):
            if ":" in name and not name.startswith("optuna."):  # Optuna's version is below
                values.append({"wrappers": (name,)})  # which are named, and hashed, alike
        contents = [*filter(None, map(user_files_digest, values))]
        warm_start = Path(search.warm_start).stem
        chosen = {"contents": contents, "warm_start": warm_start, "sampler_seed": search.sampler_seed}
        identity = {
            **{key: value for key, value in chosen.items() if value},
            "base": search.base,
            "fixed": search.run,
            "space": {name: parameter.identity for name, parameter in search.space.items()},
            "objectives": [objective.model_dump() for objective in search.sought],
            "start": [search.in_words(params) for params in search.first_trials],
            "generation": search.generation,
            "sampler": search.sampler.model_dump(),
            "pruner": search.pruner.model_dump(),
            "seeds": self.budget.seeds,
            "steps": self.budget.steps,
            "optuna": optuna.__version__,
            "rules": RULES_VERSION,
            "engines": ENGINE_VERSIONS,
            "format": FORMAT,
        }
        plain: dict[str, Any] = json.loads(json.dumps(identity, default=list))
        return plain

    @property
    def digest(self) -> str:
        return hashlib.sha256(json.dumps(self.identity, sort_keys=True).encode()).hexdigest()[:12]

    def changes_since(self, identity: Any) -> list[str]:
        """Return where a recorded identity differs from this one, as keys with dots."""
        then, now = _flat(identity), _flat(self.identity)
        return [key for key in {**then, **now} if then.get(key) != now.get(key)]


def _flat(value: Any, key: str = "") -> dict[str, Any]:
    if not isinstance(value, dict):
        return {key: value}
    parts = [_flat(each, f"{key}.{name}" if key else name) for name, each in value.items()]
    return {name: each for part in parts for name, each in part.items()}


@dataclass(frozen=True)
class Record(Task):
    """A recorded search: its study, and where it is; a published one has no runs here."""

    study: optuna.Study
    journal: Journal
    published: bool = False

    @property
    def begun(self) -> list[FrozenTrial]:
        """All trials, those under way and those that wait to be suggested among them."""
        return self.study.get_trials(deepcopy=False)

    @property
    def trials(self) -> list[FrozenTrial]:
        """The trials that have ended."""
        return [trial for trial in self.begun if trial.state in STATES]

    @property
    def under_way(self) -> bool:
        """Whether trials of its budget have begun and not ended."""
        return any(trial.state not in STATES for trial in self.begun[: self.budget.trials])

    @property
    def best(self) -> int | list[int] | None:
        """Return the number of the best trial; of several objectives, the Pareto front."""
        if len(self.search.sought) > 1:
            return sorted(trial.number for trial in self.study.best_trials)
        complete = any(trial.state == TrialState.COMPLETE for trial in self.trials)
        return self.study.best_trial.number if complete else None

    def document(self) -> dict[str, Any]:
        """Return it as JSON."""
        trials = [
            {
                "number": trial.number,
                "params": trial.params,
                "values": [] if trial.state == TrialState.FAIL else trial.values,
                "state": STATES[trial.state],
                "run_ids": trial.user_attrs.get("run_ids", []),
                "reports": {str(step): value for step, value in trial.intermediate_values.items()},
                "note": str(trial.user_attrs.get("note", "")),
            }
            for trial in self.trials
        ]
        asked, seeds, steps = self.budget.trials, self.budget.seeds, self.budget.steps
        amount = {"trials_asked": asked, "seeds": seeds, "steps": steps}
        return {"search": self.search.name, **amount, "trials": trials, "best": self.best}


# --- Searching ------------------------------------------------------------------------------------


def log_path(store: Store, label: str) -> Path:
    return store.root / "searches" / f"{label}.log"


def open_record(store: Store, task: Task, say: Callable[[str], None]) -> Record:
    """Open the record of a search, which is made if there is none; other processes may go on with it too."""
    store.check_writable()
    usual = log_path(store, task.search.label)
    own = usual.with_name(f"{task.search.label}.{task.digest}.log")
    usual.parent.mkdir(parents=True, exist_ok=True)
    for path in [own] if own.exists() else [usual, own]:
        if path.is_symlink():
            raise UserError(f"{path}: is a link; remove it")
        with _read_soundly(path):
            record = begin_record(path, task, store)
            _check_trials(record.study, task.search)
            about = record.study.user_attrs[ABOUT]
            if about["digest"] == task.digest:
                return record
            changed = ", ".join(task.changes_since(about["identity"]))
            say(f"the search so far had other {changed}, and stays in {path}; this one is in {own}")
    raise _damaged(own)


def begin_record(path: Path, task: Task, store: Store) -> Record:
    """Return the record in a journal; one that is new, or that Optuna began, is made the task's."""
    search, storage = task.search, JournalStorage(journal := Journal(path))
    with journal.together(), warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        if not storage.get_all_studies():  # `load_if_exists` would write a line each time
            storage.create_new_study([*search.directions], search.name)
        study = _study_in(storage, path, search)
        study.pruner = make_pruner(search.pruner)
        if ABOUT not in study.user_attrs:
            about = {"search": search.name, "digest": task.digest, "identity": task.identity}
            study.set_user_attr(ABOUT, {**about, "trials_asked": task.budget.trials})
            study.set_metric_names([f"{each.outcome}, {each.over_seeds}" for each in search.sought])
            for params in (*search.first_trials, *_warm_start(search, store)):
                study.enqueue_trial(params)
        about = study.user_attrs[ABOUT]
        if about["digest"] == task.digest and about["trials_asked"] < task.budget.trials:
            study.set_user_attr(ABOUT, {**about, "trials_asked": task.budget.trials})
    return Record(search, task.budget, study, journal)


def _warm_start(search: Search, store: Store) -> list[dict[str, Any]]:
    """Return the best trials of the search that this one starts from, as many as a generation has."""
    if not (name := search.warm_start):
        return []
    other = read_record(store, name, search.world if load_search(name).has_worlds else None)
    sign = 1 if other.search.sought[0].direction == "minimize" else -1
    complete = [trial for trial in other.trials if trial.state == TrialState.COMPLETE]
    ranked = sorted(complete, key=lambda trial: sign * trial.values[0])
    found = [search.find(other.search.fields(trial.params)) for trial in ranked]
    new = [params for place, params in enumerate(found) if params not in found[:place]]
    return new[: search.generation]


# --- Reading ---------------------------------------------------------------------------------------


def read_record(
    store: Store,
    name: str,
    world: str | None = None,
    settings: Mapping[str, Any] | None = None,
    stored: bool = True,
) -> Record:
    """Return a search that was run here, or else a published one; refuse one whose file has changed since.

    `name`, `world` and `settings` are as in `load_search`. Without `stored`, published searches alone count.
    Of several records of a search, that of the latest trial is read.
    """
    search = load_search(name, world, settings)
    folder, pattern = store.root / "searches", rf"{re.escape(search.label)}(\.[0-9a-f]+)?\.log"
    logs = [folder / name for name in names_in(folder) if stored and re.fullmatch(pattern, name)]
    if logs := [path for path in logs if path.stat().st_size]:  # Optuna leaves an empty file
        return _read_latest(logs, search)
    if path := published_log(store, search.label):
        return _read_latest([path], search, published=True)
    raise UserError(
        f"search {search.label} was not run in {store.root}: `pneuma search run` it first, "
        "or name the folder with --results"
    )


def published_log(store: Store, label: str) -> Path | None:
    """Return the published log of a search, if there is one in the results folder or with Pneuma."""
    logs = [folder / f"search-{label}.log" for folder in (store.root / PUBLISHED, shipped_tables())]
    return next((path for path in logs if path.exists()), None)


def _read_latest(paths: Sequence[Path], search: Search, published: bool = False) -> Record:
    """Return the record of the latest trial, of those that are of a search as its file has it now."""
    found: list[tuple[bool, float, str, Record]] = []
    for path in paths:
        with _read_soundly(path):
            study = _study_in(JournalStorage(journal := Journal(path)), path, search)
            if (about := study.user_attrs.get(ABOUT)) is None:
                raise UserError(f"{path}: no trial was begun yet: `pneuma search run` it first")
            identity = about["identity"]
            budget = Budget(trials=about["trials_asked"], seeds=identity["seeds"], steps=identity["steps"])
            record = Record(search, budget, study, journal, published)
            changes = record.changes_since(identity)
            changed = ", ".join(key for key in changes if key.split(".")[0] not in VERSIONS)
            if not changed:
                _check_trials(study, search)
            times = [trial.datetime_start.timestamp() for trial in record.begun if trial.datetime_start]
            found.append((not changed, max(times, default=0.0), changed, record))
    _, _, changed, record = max(found, key=lambda each: each[:2])
    if changed:
        raise UserError(
            f"{record.journal.path}: the search had other {changed} than its file or --set has now; "
            "set them alike, or search again"
        )
    return record


def _study_in(storage: JournalStorage, path: Path, search: Search) -> optuna.Study:
    names = [study.study_name for study in storage.get_all_studies()]
    if search.name not in names:
        holds = ", ".join(map(str, names)) or "no study"
        raise UserError(f"{path}: holds {holds}, not search {search.name}; move it away")
    return optuna.load_study(study_name=search.name, storage=storage)


def _check_trials(study: optuna.Study, search: Search) -> None:
    """Refuse a study whose trials are not of a search.

    Raises ValueError or the like for what makes no sense.
    """
    if study.directions != search.directions:
        raise ValueError("other directions than the search's")
    for trial in study.get_trials(deepcopy=False):
        if not search.holds(trial.params):
            raise UserError(
                f"the log of search {search.name}: trial {trial.number} is outside the search's space; "
                "move the log away, and no run is trained twice"
            )
        numbers = [float(value) for value in (*(trial.values or ()), *trial.intermediate_values.values())]
        whole = trial.state != TrialState.COMPLETE or len(trial.values) == len(search.sought)
        if not whole or not all(map(math.isfinite, numbers)):
            raise ValueError("values that no search can have")
        if not all(isinstance(name, str) for name in [*trial.user_attrs.get("run_ids", [])]):
            raise ValueError("runs that no search can have")


@contextmanager
def _read_soundly(path: Path) -> Iterator[None]:
    """Say in a line what cannot be read; a line of JSON may be any operation, on anything."""
    try:
        yield
    except UserError:
        raise
    except Exception:
        raise _damaged(path) from None


def _damaged(path: Path) -> UserError:
    """Return what is said of a log that cannot be read, perhaps as another version of Optuna wrote it."""
    found = re.search(rb'"optuna":"([\w.]{1,20})"', read_whole(path, LARGEST_LOG))
    if found and (version := found[1].decode()) != optuna.__version__:
        return UserError(
            f"{path}: Optuna {version} wrote it, which {optuna.__version__} cannot read; "
            "install that version, or move the log away, and no run is trained twice"
        )
    return UserError(f"{path}: damaged; move it away, and `pneuma search run` trains nothing twice")
