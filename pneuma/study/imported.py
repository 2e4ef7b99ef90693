"""Old logs as a study: Stable-Baselines3's TensorBoard logs, every point of them, in the store.

folder of logs → runs that were not trained here → store and selection, as `pneuma study run` leaves

An imported run holds `scalars.parquet` (tag, step, value, superseded) in place of an engine's
records. Its id is a hash of its event files, so importing twice changes nothing.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.errors import UserError
from pneuma.study.event_files import EventFile, Scalar, read_event_file
from pneuma.study.log_folders import LogFolder, find_logs
from pneuma.study.plan import Selection
from pneuma.study.spec import list_studies
from pneuma.study.store import SCALARS_FILE, Status, Store, to_json
from pneuma.worlds import split_world

SOURCE = "tensorboard"
"""What a selection's record calls the source of an imported study."""

SCHEMA = 1
IMPORT_VERSION = 1
"""Raised by hand when the same logs are read to other points; part of every imported run's id."""

STEP_GROUPS = ("rollout/", "train/", "time/", "eval/")
"""Tags that Stable-Baselines3 writes, whose steps are agent steps."""
DAMAGE_TOLD = 3


@dataclass(frozen=True)
class ImportedRun:
    """One imported run.

    Attributes:
        shown: its folder, for people.
        steps: the last agent step that was logged.
        points: how many scalars it holds, `superseded` of them by a restart.
        new: whether this call stored it.
        damage: what of its files could not be read, in words.
    """

    shown: str
    condition: str
    seed: int
    run_id: str
    steps: int
    points: int
    superseded: int
    new: bool
    damage: tuple[str, ...]


@dataclass(frozen=True)
class Import:
    """What an import did: the study's name, its runs, and notes for people."""

    study: str
    runs: tuple[ImportedRun, ...]
    notes: tuple[str, ...]


def import_tensorboard(folder: Path, store: Store, name: str | None = None) -> Import:
    """Import every run below a folder as one study.

    Args:
        folder: holds NAME_1/, NAME_2/, … with event files, at any depth, or event files itself.
        store: where to.
        name: the study's name; the folder's when left out.

    Raises:
        UserError: before anything is written, where no log is found, the name is taken or unfit, or
            the `tensorboard` package is not there.
    """
    study = _study_name(folder, name, store)
    folders, notes = find_logs(folder)
    logs = [_read_log(log) for log in folders]
    for log in logs:
        if not log.steps:
            notes.append(f"{log.folder.shown}: holds no scalars of Stable-Baselines3 and is left out")
    logs = [log for log in logs if log.steps]
    if not logs:
        raise UserError(f"{folder}: its event files hold no scalars of Stable-Baselines3 (rollout/…)")
    store.check_writable()
    runs = tuple(_store_log(log, store) for log in logs)
    notes += _copies(runs)
    record = _record(study, runs)
    if {**record, "schema": None} != {**(store.selection(study) or {}), "schema": None}:
        store.save_selection(study, record)
    return Import(study, runs, tuple(notes))


# --- One log --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Log:
    """What a folder's event files hold, read in order."""

    folder: LogFolder
    run_id: str
    files: list[dict[str, Any]]
    events: list[EventFile]
    scalars: list[Scalar]
    superseded: list[bool]
    steps: int


def _read_log(folder: LogFolder) -> _Log:
    digest = hashlib.sha256(f"{SOURCE} {IMPORT_VERSION}\0".encode())
    files, events = [], []
    for path in folder.files:
        try:
            data = path.read_bytes()
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror})") from None
        checksum = hashlib.sha256(data).hexdigest()
        digest.update(checksum.encode())
        files.append({"bytes": len(data), "sha256": checksum})
        events.append(read_event_file(data))
    scalars = [scalar for file in events for scalar in file.scalars]
    superseded = find_superseded([file.scalars for file in events])
    steps = [
        scalar.step
        for scalar, gone in zip(scalars, superseded, strict=True)
        if not gone and scalar.tag.startswith(STEP_GROUPS)
    ]
    return _Log(
        folder,
        digest.hexdigest()[:16],
        files,
        events,
        scalars,
        superseded,
        max(max(steps, default=0), 0),
    )


def find_superseded(files: Sequence[Sequence[Scalar]]) -> list[bool]:
    """Tell which scalars of a log a later one stands in for, in the order of all files' scalars.

    A logger that was restarted goes back in steps and writes anew. Of a tag, a value replaces those
    written before it at its own or a later step. A file that begins before the end of the files
    before it replaces, of all of Stable-Baselines3's tags, what they hold from there on.
    """
    kept: dict[str, list[tuple[int, int]]] = {}  # by tag: (step, place), steps rising
    gone = [False] * sum(len(file) for file in files)
    place = 0

    def drop_from(tag: str, step: int) -> None:
        points = kept.get(tag, [])
        while points and points[-1][0] >= step:
            gone[points.pop()[1]] = True

    for file in files:
        first = next((scalar.step for scalar in file if scalar.tag.startswith(STEP_GROUPS)), None)
        if first is not None:
            for tag in kept:
                if tag.startswith(STEP_GROUPS):
                    drop_from(tag, first)
        for scalar in file:
            drop_from(scalar.tag, scalar.step)
            kept.setdefault(scalar.tag, []).append((scalar.step, place))
            place += 1
    return gone


# --- Into the store -------------------------------------------------------------------------------


def _store_log(log: _Log, store: Store) -> ImportedRun:
    new = not store.status(log.run_id).finished
    damage = [words for file in log.events for words in file.damage]
    if new:
        files = {
            "run.json": to_json(
                {"schema": SCHEMA, "run_id": log.run_id, "source": SOURCE, "run": _settings(log.steps)}
            ),
            "provenance.json": to_json(_provenance(log, damage)),
            SCALARS_FILE: _scalars_table(log.scalars, log.superseded),
        }
        store.save_run(log.run_id, Status("done", log.steps), files)
    return ImportedRun(
        log.folder.shown,
        log.folder.condition,
        log.folder.seed,
        log.run_id,
        log.steps,
        len(log.scalars),
        sum(log.superseded),
        new,
        (*damage[:DAMAGE_TOLD], *([f"and {len(damage) - DAMAGE_TOLD} more"] * (len(damage) > DAMAGE_TOLD))),
    )


def _settings(steps: int) -> dict[str, Any]:
    """Return what is known of the settings of an imported run."""
    return {"env": "Imported TensorBoard logs", "slots": None, "steps": steps}


def _provenance(log: _Log, damage: list[str]) -> dict[str, Any]:
    """Tell when the log was written, and from what it was read; not from where, which may change."""
    seconds = [second for file in log.events for second in (file.first_second, file.last_second) if second]
    return {
        "imported": SOURCE,
        "import_version": IMPORT_VERSION,
        "started": _moment(min(seconds)) if seconds else None,
        "wall_seconds": round(max(seconds) - min(seconds), 3) if seconds else 0.0,
        "files": log.files,
        "damage": damage,
    }


def _moment(second: float) -> str | None:
    try:
        return datetime.fromtimestamp(second, UTC).isoformat(timespec="seconds")
    except (OverflowError, OSError, ValueError):  # no time that a clock ever showed
        return None


def _scalars_table(scalars: Iterable[Scalar], superseded: list[bool]) -> bytes:
    scalars = list(scalars)
    table = pa.table(
        {
            "tag": pa.array([scalar.tag for scalar in scalars], pa.string()),
            "step": pa.array([scalar.step for scalar in scalars], pa.int64()),
            "value": pa.array([scalar.value for scalar in scalars], pa.float64()),
            "superseded": pa.array(superseded, pa.bool_()),
        }
    )
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


# --- The study ------------------------------------------------------------------------------------


def _study_name(folder: Path, name: str | None, store: Store) -> str:
    asked = folder.resolve().name if name is None else name
    study = asked if name is not None else re.sub(r"[^A-Za-z0-9._-]+", "-", asked).strip("-.")
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}", study) or study.endswith(".toml"):
        raise UserError(
            f"--name {asked}: a study's name is letters, digits, dots, - and _, and not a file's (….toml)"
        )
    if split_world(study)[0] in list_studies():
        raise UserError(f"--name {study}: a shipped study is called that; give another")
    record = store.selection(study)
    if record and record.get("source") != SOURCE:
        raise UserError(f"--name {study}: a study of that name was run in {store.root}; give another")
    return study


def _copies(runs: Sequence[ImportedRun]) -> list[str]:
    first: dict[str, str] = {}
    notes = []
    for run in runs:
        if run.run_id in first:
            notes.append(f"{run.shown} holds the same log as {first[run.run_id]}: it is no run of its own")
        first.setdefault(run.run_id, run.shown)
    return notes


def _record(study: str, runs: Sequence[ImportedRun]) -> dict[str, Any]:
    """Return what `results/studies/NAME.json` holds, in the form of `execute.selection_record`."""
    conditions: dict[str, list[str]] = {}
    for run in runs:
        conditions.setdefault(run.condition, []).append(run.run_id)
    groups: dict[tuple[str, ...], list[str]] = {}
    for condition, names in conditions.items():
        groups.setdefault(tuple(names), []).append(condition)
    return {
        "study": study,
        "source": SOURCE,
        "path": None,
        "title": study,
        "figure": study,
        "baseline": next(iter(conditions)),
        "same": [names for names in groups.values() if len(names) > 1],
        "selection": _plain(asdict(Selection())),
        "runs": [
            {
                "condition": run.condition,
                "seed": run.seed,
                "run_id": run.run_id,
                "run": _settings(run.steps),
            }
            for run in runs
        ],
    }


def _plain(selection: dict[str, Any]) -> dict[str, Any]:
    """Return a selection as JSON gives it back, so that two can be compared."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in selection.items()}
