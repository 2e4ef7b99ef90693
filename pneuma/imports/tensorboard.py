"""TensorBoard logs of Stable-Baselines3 or CleanRL: every point of each run's event files.

folders -> `find_logs` -> event files of each run -> `Log` -> `logs.store_logs`
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import pandas as pd

from pneuma.errors import UserError, counted, install_extra
from pneuma.imports.logs import Import, Log, choose_study_name, condition_and_seed, file_facts, store_logs
from pneuma.store.store import Store

SOURCE, IMPORT_VERSION = "tensorboard", 3
"""The second is raised by hand when the same logs give other points; part of every imported run's id."""


class Scalar(NamedTuple):
    """A point of a log; `second` is when it was written, since 1970."""

    tag: str
    step: int
    value: float
    second: float


def import_tensorboard(folders: Sequence[Path], store: Store, name: str | None = None) -> Import:
    """Import all runs below some folders as one study.

    Each folder contains NAME_1/, NAME_2/, … with event files, at any depth, or event files itself. All files
    are read before anything is written.
    """
    shared = os.path.commonpath([folder.resolve() for folder in folders])
    study = choose_study_name(name, Path(shared), store, SOURCE)
    logs = [_read_log(folder_names, paths) for folder_names, paths in find_logs(folders).items()]
    return store_logs(logs, store, SOURCE, study, adds_runs=name is not None)


def find_logs(folders: Sequence[Path]) -> dict[tuple[str, ...], list[Path]]:
    """Return event files by the path of their folder below what all share; the oldest first."""
    by_folder: dict[Path, list[Path]] = {}
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder}: is not a folder; name the folder that holds NAME_1/, NAME_2/, …")
        paths = sorted(path for path in folder.resolve().rglob("*tfevents*") if path.is_file())
        if not paths:
            raise UserError(f"{folder}: contains no TensorBoard event files (events.out.tfevents…)")
        for path in paths:
            readable = os.fsencode(path).decode(errors="backslashreplace")
            if readable != str(path):
                raise UserError(f"{readable}: this name is not UTF-8; rename the file")
            files = by_folder.setdefault(path.parent, [])
            if path not in files:  # folders may be given twice
                files.append(path)
    shared = os.path.commonpath([folder.parent for folder in by_folder])
    return {folder.relative_to(shared).parts: by_folder[folder] for folder in sorted(by_folder)}


def _read_log(folder_names: tuple[str, ...], paths: Sequence[Path]) -> Log:
    files, notes = [], []
    rows: list[tuple[object, ...]] = []
    for number, path in enumerate(paths):
        try:
            data = path.read_bytes()
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror})") from None
        files.append(file_facts(data))
        scalars, sound = read_event_file(path)
        rows.extend((number, *scalar) for scalar in scalars)
        lost_bytes = len(data) - sound
        if lost_bytes:
            notes.append(
                f"{path.name} is damaged: its last {lost_bytes:,} of {len(data):,} bytes are left out"
            )
    points = pd.DataFrame(rows, columns=("file",) + Scalar._fields)
    points["superseded"] = find_superseded(points)
    superseded = int(points["superseded"].sum())
    if superseded:
        notes.append(f"left out {counted(superseded, 'point')} that a restart superseded")
    contents = "".join(file["sha256"] for file in files)
    condition, seed = condition_and_seed(folder_names)
    return Log(
        name="/".join(folder_names),
        condition=condition,
        seed=seed,
        points=points,
        identity=f"{SOURCE} {IMPORT_VERSION}\0{contents}",
        provenance={"imported": SOURCE, "import_version": IMPORT_VERSION, **_times(points), "files": files},
        notes=notes,
    )


def _times(points: pd.DataFrame) -> dict[str, object]:
    """Return when a log was begun, and over how many seconds it was written."""
    seconds = points["second"][points["second"].between(1, 1e11)]  # a later time is invalid: the year 5138
    if seconds.empty:
        return {"started": None, "wall_seconds": 0.0}
    first, last = float(seconds.min()), float(seconds.max())
    started = datetime.fromtimestamp(first, UTC).isoformat(timespec="seconds")
    return {"started": started, "wall_seconds": round(last - first, 3)}


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
    plugins: dict[str, str] = {}  # what shows a tag's tensors: some writers name it once
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
    superseded = pd.Series(False, index=points.index)
    written = points.groupby("file")["second"].agg(["min", "max"])
    for _, tag_points in points.groupby("tag"):
        for file, steps in tag_points.groupby("file")["step"]:
            ended = written.index[(written.index < file) & (written["max"] <= written["min"][file])]
            before = tag_points["step"][tag_points["file"].isin(ended)]
            superseded[before.index] |= before >= steps.min()
            went_back = steps.where(steps.diff() < 0)[::-1]  # the later first
            superseded[steps.index] |= steps >= went_back.cummin().ffill().shift()[::-1]
    return superseded
