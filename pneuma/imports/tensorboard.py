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

from pneuma.errors import UserError, counted, install_command
from pneuma.files import read_regular
from pneuma.imports.logs import (
    MOST_COLUMNS,
    Import,
    Log,
    choose_study_name,
    condition_and_seed,
    file_facts,
    store_logs,
)
from pneuma.store.store import Store

SOURCE, IMPORT_VERSION = "tensorboard", 3
"""The version is raised by hand when the same logs give other points; it is part of an imported run's id."""
MOST_FOLDERS = 100_000
"""Most folders in which event files are searched; a link may lead to the whole disk."""


class Scalar(NamedTuple):
    """A point of a log; `second` is when it was written, since 1970."""

    tag: str
    step: int
    value: float
    second: float


def import_tensorboard(folders: Sequence[Path], store: Store, study_name: str | None = None) -> Import:
    """Import all runs below some folders as one study.

    Each folder contains NAME_1/, NAME_2/, … with event files, at any depth, or event files itself. All files
    are read before anything is written.
    """
    shared_folder = os.path.commonpath([folder.resolve() for folder in folders])
    chosen_name = choose_study_name(study_name, Path(shared_folder), store, SOURCE)
    files_by_folder, left_out = find_logs(folders)
    logs = [_read_log(folder_names, paths) for folder_names, paths in files_by_folder.items()]
    is_named = study_name is not None
    study_name, kept_logs, notes = store_logs(logs, store, SOURCE, chosen_name, adds_runs=is_named)
    return study_name, kept_logs, [f"left out {link}" for link in left_out] + notes


def find_logs(folders: Sequence[Path]) -> tuple[dict[tuple[str, ...], list[Path]], list[str]]:
    """Return event files by the names of their folders below the one that all share, the oldest first.

    Links to other folders are followed, as TensorBoard follows them. Also return a note for each that is not.
    """
    event_files: set[Path] = set()  # folders may be given twice
    left_out: list[str] = []
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder}: is not a folder; name the folder that holds NAME_1/, NAME_2/, …")
        paths = _event_files(folder.resolve(), left_out)
        if not paths:
            raise UserError(f"{folder}: contains no TensorBoard event files (events.out.tfevents…)")
        for path in paths:
            readable_path = os.fsencode(path).decode(errors="backslashreplace")
            if readable_path != str(path):
                raise UserError(f"{readable_path}: this name is not UTF-8; rename the file")
        event_files.update(paths)
    shared_folder = os.path.commonpath([path.parents[1] for path in event_files])
    files_by_folder: dict[tuple[str, ...], list[Path]] = {}
    for path in sorted(event_files):
        folder_names = path.parent.relative_to(shared_folder).parts
        files_by_folder.setdefault(folder_names, []).append(path)
    return files_by_folder, list(dict.fromkeys(left_out))


def _event_files(top_folder: Path, left_out: list[str]) -> list[Path]:
    """Return the event files below a folder, of each folder once; note the links that are not followed."""
    event_files: list[Path] = []
    seen_folders: set[Path] = set()
    walks = [top_folder]
    while walks:  # links come after all that lies below them, and may lead to it
        walked = walks.pop(0)
        real_folder = walked.resolve()
        if real_folder in seen_folders or real_folder in top_folder.parents:
            left_out.append(f"{walked}: is a link to a folder around it, or to one that is read anyway")
            continue
        for parent_name, folder_names, file_names in os.walk(walked):
            parent = Path(parent_name)
            if parent.resolve() in seen_folders:
                folder_names.clear()
                continue
            seen_folders.add(parent.resolve())
            if len(seen_folders) > MOST_FOLDERS:
                raise UserError(
                    f"{top_folder}: has more than {MOST_FOLDERS:,} folders; name those of the runs"
                )
            walks += [parent / name for name in sorted(folder_names) if (parent / name).is_symlink()]
            for file_name in file_names:
                path = parent / file_name
                if path.is_symlink() and not path.exists():
                    left_out.append(f"{path}: is a link that leads nowhere")
                elif "tfevents" in file_name and path.is_file():
                    event_files.append(path)
    return event_files


def _read_log(folder_names: tuple[str, ...], paths: Sequence[Path]) -> Log:
    files, notes = [], []
    scalar_rows: list[tuple[object, ...]] = []
    for file_number, path in enumerate(paths):
        try:
            file_bytes = read_regular(path)
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror})") from None
        files.append(file_facts(file_bytes))
        scalars, sound_bytes = read_event_file(path)
        scalar_rows.extend((file_number, *scalar) for scalar in scalars)
        lost_bytes = len(file_bytes) - sound_bytes
        if lost_bytes:
            notes.append(
                f"{path.name} is damaged: its last {lost_bytes:,} of {len(file_bytes):,} bytes are left out"
            )
    points = pd.DataFrame(scalar_rows, columns=("file",) + Scalar._fields)
    tag_count = points["tag"].nunique()
    if tag_count > MOST_COLUMNS:
        raise UserError(f"{paths[0].parent}: has {tag_count:,} tags; {MOST_COLUMNS:,} are the most")
    points["superseded"] = find_superseded(points)
    superseded = int(points["superseded"].sum())
    if superseded:
        notes.append(f"left out {counted(superseded, 'point')} that a restart superseded")
    contents = "".join(facts["sha256"] for facts in files)
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
    """Return when a log was started, and in how many seconds it was written."""
    seconds = points["second"][points["second"].between(1, 1e11)]  # a later time is invalid: the year 5138
    if seconds.empty:
        return {"started": None, "wall_seconds": 0.0}
    first_second, last_second = float(seconds.min()), float(seconds.max())
    started = datetime.fromtimestamp(first_second, UTC).isoformat(timespec="seconds")
    return {"started": started, "wall_seconds": round(last_second - first_second, 3)}


def read_event_file(path: Path) -> tuple[list[Scalar], int]:
    """Return every scalar of an event file in the order of writing, up to damage, and how many bytes that is.

    TensorBoard's EventAccumulator uses the same reader, but does not keep the order of tags, which shows
    restarts.
    """
    try:
        from tensorboard.backend.event_processing.event_file_loader import RawEventFileLoader
        from tensorboard.compat.proto.event_pb2 import Event
        from tensorboard.util.tensor_util import make_ndarray
    except ImportError:
        needed = f"reading TensorBoard logs needs the tensorboard package: {install_command('tensorboard')}"
        raise UserError(needed) from None
    scalars: list[Scalar] = []
    sound_bytes = 0
    plugin_by_tag: dict[str, str] = {}  # some writers name the plugin of a tag once
    with suppress(Exception):  # any error from an invalid length or message means damage
        for record in RawEventFileLoader(str(path)).Load():
            event = Event.FromString(record)
            for value in event.summary.value:
                plugin_name = plugin_by_tag.setdefault(value.tag, value.metadata.plugin_data.plugin_name)
                if value.HasField("simple_value"):
                    scalar_value = value.simple_value
                elif plugin_name == "scalars" and not value.tensor.tensor_shape.dim:
                    scalar_value = float(make_ndarray(value.tensor))
                else:  # a text or a histogram
                    continue
                scalars.append(Scalar(value.tag, event.step, scalar_value, event.wall_time))
            sound_bytes += len(record) + 16  # its length, and two checksums
    return scalars, sound_bytes


def find_superseded(points: pd.DataFrame) -> pd.Series:
    """Return which scalars of a log were replaced by later ones of their tag, after a restart.

    A restarted logger goes back in steps and writes them again. From that step on, its points replace earlier
    ones of its file, and of files that had ended when its file was started. Files that are written at the
    same time have several writers, and replace nothing of each other.
    """
    superseded = pd.Series(False, index=points.index)
    written = points.groupby("file")["second"].agg(["min", "max"])
    for _, tag_points in points.groupby("tag"):
        for file_number, steps in tag_points.groupby("file")["step"]:
            ended_files = written.index[
                (written.index < file_number) & (written["max"] <= written["min"][file_number])
            ]
            earlier_steps = tag_points["step"][tag_points["file"].isin(ended_files)]
            superseded[earlier_steps.index] |= earlier_steps >= steps.min()
            went_back = steps.where(steps.diff() < 0)[::-1]  # the later first
            superseded[steps.index] |= steps >= went_back.cummin().ffill().shift()[::-1]
    return superseded
