"""Imported logs as a study: every point of TensorBoard logs of Stable-Baselines3 or CleanRL, in the store.

folders of logs → runs that were not trained here → store and selection, as `pneuma study run` leaves

An imported run holds `scalars.parquet` (tag, step, value, superseded) in place of an engine's
records. Its id is a hash of its event files, so importing twice changes nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from pneuma.errors import UserError, counted, install_extra
from pneuma.files import checksum, read_whole, to_json
from pneuma.study.row_builder import cells_of_files
from pneuma.study.rows import encode_row
from pneuma.study.spec import list_studies
from pneuma.study.store import ROW_FILE, SCALARS_FILE, Identity, Status, Store

SOURCE = "tensorboard"
"""The source named in the record of an imported study."""
IMPORT_VERSION = 3
"""Raised by hand when the same logs give other points; part of every imported run's id."""
AGENT_STEPS = ("rollout/", "train/", "time/", "eval/", "charts/", "losses/")
"""Tags of Stable-Baselines3 and CleanRL whose steps are agent steps."""


class Log(NamedTuple):
    """One run's event files, oldest first, with its folder, condition and seed."""

    shown: str
    condition: str
    seed: int
    paths: list[Path]


class Scalar(NamedTuple):
    """A point of a log; `second` is when it was written, since 1970."""

    tag: str
    step: int
    value: float
    second: float


@dataclass(frozen=True)
class ImportedRun:
    """An imported run.

    Attributes:
        steps: the last logged agent step.
        points: tag, step, value and superseded (by a restart) of every scalar, as written.
        new: whether this call stored it.
        damage: what of it cannot be read, for each file that is damaged.
    """

    log: Log
    run_id: str
    steps: int
    points: pd.DataFrame
    provenance: dict[str, Any]
    new: bool
    damage: list[str]


def import_tensorboard(
    folders: Sequence[Path], store: Store, name: str | None = None
) -> tuple[str, list[ImportedRun], list[str]]:
    """Import all runs below some folders as one study; return its name, its runs, and notes for the user.

    Each folder contains NAME_1/, NAME_2/, … with event files, at any depth, or event files itself. The
    study's default name is that of the folder that contains all of them. All files are read
    before anything is written.
    """
    study = find_study_name(folders, name, store, SOURCE)
    logs, notes = find_logs(folders)
    runs = []
    for log in logs:
        runs.append(run := _read_log(log, store))
        notes += [f"{log.shown}: {damage}" for damage in run.damage]
        if anew := int(run.points["superseded"].sum()):
            notes.append(f"{log.shown}: left out {counted(anew, 'point')} that a restart superseded")
    return study, store_runs(study, runs, store, SOURCE, notes), notes


def store_runs(
    study: str, runs: Sequence[ImportedRun], store: Store, source: str, notes: list[str]
) -> list[ImportedRun]:
    """Store imported runs as a study; return those that have points, and add notes on the others."""
    found: dict[str, ImportedRun] = {}
    for run in runs:
        if not run.steps:
            notes.append(f"{run.log.shown}: holds no scalars of Stable-Baselines3 or CleanRL and is left out")
        elif run.run_id in found:
            same = found[run.run_id].log.shown
            notes.append(f"{run.log.shown}: holds the same log as {same} and is left out")
        else:
            found[run.run_id] = run
    if not found:
        raise UserError(f"{runs[0].log.paths[0]}: holds no scalars of Stable-Baselines3 or CleanRL")
    known = {(run["condition"], run["seed"]) for run in (store.listing(study) or {"runs": []})["runs"]}
    if known - {(run.log.condition, run.log.seed) for run in found.values()}:
        raise UserError(f"--name {study}: a study of that name has runs of other logs; give another")
    store.check_writable()
    rows = []
    for run_id, run in found.items():
        fields = {"env": "Imported TensorBoard logs", "slots": None, "steps": run.steps}
        rows.append({"run_id": run_id, "condition": run.log.condition, "seed": run.log.seed})
        if run.new:
            about = {"schema": 1, "run_id": run_id, "source": source, "run": fields}
            files = {"run.json": to_json(about), "provenance.json": to_json(run.provenance)}
            scalars = run.points[["tag", "step", "value", "superseded"]]
            files[SCALARS_FILE] = scalars.to_parquet(compression="zstd", index=False)
            status = Status("done", run.steps, identity=Identity(run_id, run.log.seed, run.steps))
            files[ROW_FILE] = encode_row(cells_of_files(run_id, status, files))
            store.save_run(run_id, status, files)
    about = {"title": study, "baseline": rows[0]["condition"], "source": source, "runs": rows}
    store.save_listing(study, about)
    return [*found.values()]


# --- Which runs there are -------------------------------------------------------------------------


def find_logs(folders: Sequence[Path]) -> tuple[list[Log], list[str]]:
    """Find all folders, among those given and below them, that contain event files.

    The condition is the folder's path below what all runs share, without the seed: Stable-Baselines3
    calls folders NAME_SEED, CleanRL NAME__SEED__TIME. A folder without a number is seed 0. Where two
    would be the same seed of a condition, one takes the next free number.

    Returns:
        The logs by condition and seed, and notes on seeds that were not as the name says.
    """
    files: set[Path] = set()
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder}: is no folder; name the folder that holds NAME_1/, NAME_2/, …")
        found = {path for path in folder.resolve().rglob("*tfevents*") if path.is_file()}
        if not found:
            raise UserError(f"{folder}: no TensorBoard event files (events.out.tfevents…) in it or below")
        for path in found:
            if (told := os.fsencode(path).decode(errors="backslashreplace")) != str(path):
                raise UserError(f"{told}: this name is not UTF-8; give another")
        files |= found
    shared = os.path.commonpath([path.parents[1] for path in files])
    folders = sorted({path.parent for path in files})
    of_folder = {folder: sorted(path for path in files if path.parent == folder) for folder in folders}
    logs, notes = name_logs(
        [(folder.relative_to(shared).parts, paths) for folder, paths in of_folder.items()]
    )
    return sorted(logs, key=lambda log: (log.condition, log.seed)), notes


def name_logs(found: Sequence[tuple[tuple[str, ...], list[Path]]]) -> tuple[list[Log], list[str]]:
    """Name runs by the parts of their names and their files; add notes on seeds that were taken."""
    logs: dict[tuple[str, int], Log] = {}
    notes = []
    for parts, paths in found:
        condition, number = _condition_and_seed(parts)
        seed, shown = number, "/".join(parts)
        while (condition, seed) in logs:
            seed += 1
        if seed > number:
            notes.append(f"{shown}: seed {number} of {condition} is taken, so it is seed {seed}")
        logs[condition, seed] = Log(shown, condition, seed, paths)
    return [*logs.values()], notes


def _condition_and_seed(parts: tuple[str, ...]) -> tuple[str, int]:
    """Return a condition's name, and the seed from the last folder that has a number."""
    name, seed = "/".join(parts), 0
    for place in reversed(range(len(parts))):
        cleanrl = re.fullmatch(r"(.+)__([0-9]{1,9})__[0-9]{9,}", parts[place])
        match = cleanrl or re.fullmatch(r"(.+)_([0-9]{1,18})", parts[place])
        if match:
            name, seed = "/".join((*parts[:place], match[1], *parts[place + 1 :])), int(match[2])
            break
    return name.lstrip("_/ ") or "run", seed  # legends leave out what begins with _


def find_study_name(folders: Sequence[Path], name: str | None, store: Store, source: str) -> str:
    if name is None:
        shared = os.path.commonpath([folder.resolve() for folder in folders])
        name = re.sub(r"[^A-Za-z0-9._-]+", "-", Path(shared).name).strip("-.")
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}", name) or name.endswith(".toml"):
        raise UserError(f"--name {name}: a study's name is letters, digits, dots, - and _, and no file's")
    if name in list_studies():
        raise UserError(f"--name {name}: a shipped study is called that; give another")
    listing = store.listing(name)
    if listing and listing.get("source") != source:
        raise UserError(f"--name {name}: a study of that name was run in {store.root}; give another")
    return name


# --- One log --------------------------------------------------------------------------------------


def _read_log(log: Log, store: Store) -> ImportedRun:
    files: list[dict[str, Any]] = []
    rows: list[tuple[Any, ...]] = []
    damage = []
    for place, path in enumerate(log.paths):
        try:
            data = read_whole(path)
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror})") from None
        files.append({"bytes": len(data), "sha256": checksum(data)})
        scalars, sound = read_event_file(path)
        rows += [(place, *scalar) for scalar in scalars]
        if lost := len(data) - sound:
            damage.append(f"{path.name} is damaged: its last {lost:,} of {len(data):,} bytes are left out")
    points = pd.DataFrame(rows, columns=["file", *Scalar._fields])
    points["superseded"] = find_superseded(points)
    steps = points["step"][points["tag"].str.startswith(AGENT_STEPS) & ~points["superseded"]]
    seconds = points["second"][points["second"].between(1, 1e11)]  # a later time is invalid: the year 5138
    first, last = (seconds.min(), seconds.max()) if len(seconds) else (0.0, 0.0)
    provenance = {
        "imported": SOURCE,
        "import_version": IMPORT_VERSION,
        "started": datetime.fromtimestamp(first, UTC).isoformat(timespec="seconds") if first else None,
        "wall_seconds": round(float(last - first), 3),
        "files": files,
    }
    contents = "".join(file["sha256"] for file in files)
    run_id = checksum(f"{SOURCE} {IMPORT_VERSION}\0{contents}".encode())[:16]
    reached, new = max(0, int(steps.max())) if len(steps) else 0, not store.status(run_id).finished
    return ImportedRun(log, run_id, reached, points, provenance, new, damage)


def read_event_file(path: Path) -> tuple[list[Scalar], int]:
    """Return every scalar of an event file in the order of writing, up to damage, and how many bytes that is.

    It uses the reader inside TensorBoard's EventAccumulator, which itself does not keep the order of tags
    that shows restarts.
    """
    try:
        from tensorboard.backend.event_processing.event_file_loader import RawEventFileLoader
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.util.tensor_util import make_ndarray
    except ImportError:
        needed = f"reading TensorBoard logs needs the tensorboard package: {install_extra('tensorboard')}"
        raise UserError(needed) from None
    scalars: list[Scalar] = []
    sound = 0
    plugins: dict[str, str] = {}  # what shows a tag's tensors: some writers tell it once
    with suppress(Exception):  # any error from an invalid length or message means damage
        for record in RawEventFileLoader(str(path)).Load():
            event = Event.FromString(record)
            for value in event.summary.value:
                plugin = plugins.setdefault(value.tag, value.metadata.plugin_data.plugin_name)
                if value.HasField("simple_value"):
                    number = value.simple_value
                elif plugin == "scalars" and not value.tensor.tensor_shape.dim:
                    number = float(make_ndarray(value.tensor))
                else:  # a text, a histogram and the like
                    continue
                scalars.append(Scalar(value.tag, event.step, number, event.wall_time))
            sound += len(record) + 16  # its length, and two checksums
    return scalars, sound


def find_superseded(points: pd.DataFrame) -> pd.Series:
    """Return which scalars of a log were replaced by later ones of their tag, after a restart.

    A restarted logger goes back in steps and writes them again: from that step on, what its file holds so far
    is replaced, and what is in files that had ended when its own began. Files that are written at the same
    time are of several writers, and replace nothing of each other.
    """
    gone = pd.Series(False, index=points.index)
    written = points.groupby("file")["second"].agg(["min", "max"])
    for _, of_tag in points.groupby("tag"):
        for file, steps in of_tag.groupby("file")["step"]:
            ended = written.index[(written.index < file) & (written["max"] <= written["min"][file])]
            before = of_tag["step"][of_tag["file"].isin(ended)]
            gone[before.index] |= before >= steps.min()
            went_back = steps.where(steps.diff() < 0)[::-1]  # the later first
            gone[steps.index] |= steps >= went_back.cummin().ffill().shift()[::-1]
    return gone
