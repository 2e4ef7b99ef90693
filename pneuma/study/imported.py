"""Old logs as a study: TensorBoard logs of Stable-Baselines3 or CleanRL, every point of them, in the store.

folders of logs → runs that were not trained here → store and selection, as `pneuma study run` leaves

An imported run holds `scalars.parquet` (tag, step, value, superseded) in place of an engine's
records. Its id is a hash of its event files, so importing twice changes nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pneuma.errors import UserError, install_extra
from pneuma.study.files import checksum, read_whole, to_json
from pneuma.study.plan import Selection
from pneuma.study.spec import list_studies
from pneuma.study.store import SCALARS_FILE, Status, Store
from pneuma.worlds import split_world

SOURCE = "tensorboard"
"""What a selection's record calls the source of an imported study."""

IMPORT_VERSION = 2
"""Raised by hand when the same logs are read to other points; part of every imported run's id."""

AGENT_STEPS = ("rollout/", "train/", "time/", "eval/", "charts/", "losses/")
"""Tags that Stable-Baselines3 and CleanRL write, whose steps are agent steps."""

FRAME_BYTES = 16
"""Length and checksums around each event of a file."""

Log = tuple[str, str, int, list[Path]]
"""A run's folder for people, its condition and seed, and its event files, oldest first."""
Scalar = tuple[str, int, float, float]
"""Tag, step, value, and the second since 1970 at which it was written."""


@dataclass(frozen=True)
class ImportedRun:
    """One imported run.

    Attributes:
        shown: its folder, for people.
        steps: the last agent step that was logged.
        points: tag, step, value and superseded (by a restart) of every scalar, in the order of writing.
        provenance: when it was logged, and its files; under `damage`, what could not be read of them.
        new: whether this call stored it.
    """

    shown: str
    condition: str
    seed: int
    run_id: str
    steps: int
    points: pd.DataFrame
    provenance: dict[str, Any]
    new: bool

    @property
    def fields(self) -> dict[str, Any]:
        """What is known of its configuration."""
        return {"env": "Imported TensorBoard logs", "slots": None, "steps": self.steps}


@dataclass(frozen=True)
class Import:
    """What an import did: the study's name, its runs, and notes for people."""

    study: str
    runs: list[ImportedRun]
    notes: list[str]


def import_tensorboard(folders: Sequence[Path], store: Store, name: str | None = None) -> Import:
    """Import every run below some folders as one study.

    Each folder holds NAME_1/, NAME_2/, … with event files, at any depth, or event files itself. The study is
    called as the folder that holds all that are given, where no name is.

    Raises:
        UserError: before anything is written, where no log is found, the name is taken or unfit, a file
            cannot be read or is too large, or the `tensorboard` package is not there.
    """
    study = _study_name(folders, name, store)
    logs, notes = find_logs(folders)
    found: dict[str, ImportedRun] = {}
    for log in logs:
        run = _read_log(log, store)
        if not run.steps:
            notes.append(f"{run.shown}: holds no scalars of Stable-Baselines3 or CleanRL and is left out")
        elif run.run_id in found:
            notes.append(f"{run.shown}: holds the same log as {found[run.run_id].shown} and is left out")
        else:
            found[run.run_id] = run
            notes += [f"{run.shown}/{words}" for words in run.provenance["damage"]]
            if again := run.points["superseded"].sum():
                written = f"{again:,} of {len(run.points):,} points were written again after a restart"
                notes.append(f"{run.shown}: {written}; the later ones count")
    runs = [*found.values()]
    if not runs:
        raise UserError(f"{folders[0]}: its logs hold no scalars of Stable-Baselines3 or CleanRL")
    store.check_writable()
    for run in runs:
        if run.new:
            about = {"schema": 1, "run_id": run.run_id, "source": SOURCE, "run": run.fields}
            files = {"run.json": to_json(about), "provenance.json": to_json(run.provenance)}
            scalars = run.points[["tag", "step", "value", "superseded"]]
            files[SCALARS_FILE] = scalars.to_parquet(compression="zstd", index=False)
            store.save_run(run.run_id, Status("done", run.steps), files)
    record: dict[str, Any] = {
        "study": study,
        "source": SOURCE,
        "path": None,
        "title": study,
        "figure": study,
        "baseline": runs[0].condition,
        "same": [],
        "selection": asdict(Selection()),
        "runs": [
            {"condition": run.condition, "seed": run.seed, "run_id": run.run_id, "run": run.fields}
            for run in runs
        ],
    }
    store.save_selection(study, record)
    return Import(study, runs, notes)


# --- Which runs there are -------------------------------------------------------------------------


def find_logs(folders: Sequence[Path]) -> tuple[list[Log], list[str]]:
    """Find every folder, of those given and all below, that holds event files.

    The condition is the folder's path below what all runs share, without the seed: Stable-Baselines3
    calls folders NAME_SEED, CleanRL NAME__SEED__TIME. A folder without a number is seed 0. Where two
    would be the same seed of a condition, one takes the next free number.

    Returns:
        The logs by condition and seed, and notes on seeds that were not as the name says.

    Raises:
        UserError: where a folder is none, or holds no event files.
    """
    files: set[Path] = set()
    for folder in folders:
        if not folder.is_dir():
            raise UserError(f"{folder}: is no folder; name the folder that holds NAME_1/, NAME_2/, …")
        found = {path for path in folder.resolve().rglob("*tfevents*") if path.is_file()}
        if not found:
            raise UserError(f"{folder}: no TensorBoard event files (events.out.tfevents…) in it or below")
        files |= found
    shared = os.path.commonpath([path.parents[1] for path in files])
    logs: dict[tuple[str, int], Log] = {}
    notes = []
    for folder in sorted({path.parent for path in files}):
        shown = folder.relative_to(shared)
        condition, number = _condition_and_seed(shown.parts)
        seed = number
        while (condition, seed) in logs:
            seed += 1
        if seed > number:
            notes.append(f"{shown}: seed {number} of {condition} is taken, so it is seed {seed}")
        own = sorted(path for path in files if path.parent == folder)
        logs[condition, seed] = (str(shown), condition, seed, own)
    return [logs[key] for key in sorted(logs)], notes


def _condition_and_seed(parts: tuple[str, ...]) -> tuple[str, int]:
    """Return a condition's name, and the seed that the last folder with a number tells."""
    name, seed = "/".join(parts), 0
    for place in reversed(range(len(parts))):
        cleanrl = re.fullmatch(r"(.+)__([0-9]{1,9})__[0-9]{9,}", parts[place])
        match = cleanrl or re.fullmatch(r"(.+)_([0-9]{1,18})", parts[place])
        if match:
            name, seed = "/".join((*parts[:place], match[1], *parts[place + 1 :])), int(match[2])
            break
    return name.lstrip("_/ ") or "run", seed  # legends leave out what begins with _


def _study_name(folders: Sequence[Path], name: str | None, store: Store) -> str:
    if name is None:
        shared = os.path.commonpath([folder.resolve() for folder in folders])
        name = re.sub(r"[^A-Za-z0-9._-]+", "-", Path(shared).name).strip("-.")
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}", name) or name.endswith(".toml"):
        raise UserError(f"--name {name}: a study's name is letters, digits, dots, - and _, and no file's")
    if split_world(name)[0] in list_studies():
        raise UserError(f"--name {name}: a shipped study is called that; give another")
    record = store.selection(name)
    if record and record.get("source") != SOURCE:
        raise UserError(f"--name {name}: a study of that name was run in {store.root}; give another")
    return name


# --- One log --------------------------------------------------------------------------------------


def _read_log(log: Log, store: Store) -> ImportedRun:
    shown, condition, seed, paths = log
    files: list[dict[str, Any]] = []
    damage: list[str] = []
    rows: list[tuple[int, *Scalar]] = []
    for place, path in enumerate(paths):
        try:
            data = read_whole(path)
            files.append({"bytes": len(data), "sha256": checksum(data)})
        except OSError as error:
            raise UserError(f"{path}: cannot be read ({error.strerror})") from None
        scalars, words = read_event_file(path)
        rows += [(place, *scalar) for scalar in scalars]
        damage += [f"{path.name}: {word}" for word in words]
    points = pd.DataFrame(rows, columns=["file", "tag", "step", "value", "second"])
    points["superseded"] = find_superseded(points)
    steps = points["step"][points["tag"].str.startswith(AGENT_STEPS) & ~points["superseded"]]
    seconds = points["second"][points["second"].between(0, 1e11)]  # later is no clock's: the year 5138
    first, last = (seconds.min(), seconds.max()) if len(seconds) else (0.0, 0.0)
    provenance = {
        "imported": SOURCE,
        "import_version": IMPORT_VERSION,
        "started": datetime.fromtimestamp(first, UTC).isoformat(timespec="seconds") if first else None,
        "wall_seconds": round(float(last - first), 3),
        "files": files,
        "damage": damage,
    }
    contents = "".join(file["sha256"] for file in files)
    run_id = checksum(f"{SOURCE} {IMPORT_VERSION}\0{contents}".encode())[:16]
    reached, new = int(max(steps, default=0)), not store.status(run_id).finished
    return ImportedRun(shown, condition, seed, run_id, max(reached, 0), points, provenance, new)


def read_event_file(path: Path) -> tuple[list[Scalar], list[str]]:
    """Read every scalar of an event file, in the order of writing.

    With the reader of TensorBoard's own EventAccumulator, which stops where a file is damaged. The
    accumulator itself does not say so, and forgets the order of tags, by which restarts are known.

    Returns:
        The scalars, and what could not be read, in words.

    Raises:
        UserError: without the `tensorboard` package.
    """
    try:
        from tensorboard.backend.event_processing.event_file_loader import RawEventFileLoader
        from tensorboard.compat.proto.event_pb2 import Event
    except ImportError:
        raise UserError(
            f"reading TensorBoard logs needs the tensorboard package: {install_extra('tensorboard')}"
        ) from None
    scalars: list[Scalar] = []
    plugins: dict[str, str] = {}
    odd: dict[str, None] = {}
    read, size = 0, path.stat().st_size
    with suppress(Exception):  # whatever a length or a message that was made up leads to is damage
        for record in RawEventFileLoader(str(path)).Load():
            event = Event.FromString(record)
            read += len(record) + FRAME_BYTES
            for value in event.summary.value:
                try:
                    number = _number(value, plugins)
                except Exception:  # as many kinds as there are kinds of tensors
                    odd[value.tag] = None
                    continue
                if number is not None:
                    scalars.append((value.tag, event.step, number, event.wall_time))
    damage = [f"values of {tag} are no numbers and are left out" for tag in odd]
    if read < size:
        damage.append(f"torn or damaged: the last {size - read:,} of {size:,} bytes are left out")
    return scalars, damage


def _number(value: Any, plugins: dict[str, str]) -> float | None:
    """Return the number of a summary's value; None for a text, a histogram and the like.

    `plugins` keeps by tag what shows a tensor: some writers tell it once.
    """
    from tensorboard.util.tensor_util import make_ndarray

    if value.HasField("simple_value"):
        return float(value.simple_value)
    plugin = plugins.setdefault(value.tag, value.metadata.plugin_data.plugin_name)
    if plugin != "scalars" or not value.HasField("tensor"):
        return None
    if value.tensor.tensor_shape.dim:  # not made, however large it says that it is
        raise ValueError
    return float(make_ndarray(value.tensor))


def find_superseded(points: pd.DataFrame) -> pd.Series:
    """Tell which scalars of a log, with file, tag and step in the order of writing, later ones stand in for.

    A logger that was restarted goes back in steps and writes anew. Where a tag goes back, what it had
    from there on is replaced. A file that begins before the end of the files before it replaces, of all
    tags whose steps are agent steps, what they hold from there on.
    """
    of_agent = points["tag"].str.startswith(AGENT_STEPS)
    begins = points[of_agent].groupby("file")["step"].first()
    later = {file: begins[begins.index > file].min() for file in begins.index}  # NaN for the last file
    gone = of_agent & (points["step"] >= points["file"].map(later))
    for _, steps in points.groupby("tag")["step"]:
        went_back = np.where(steps.diff() < 0, steps, np.inf)
        least_after = np.minimum.accumulate(np.append(went_back[1:], np.inf)[::-1])[::-1]
        gone[steps.index] |= steps >= least_after
    return gone
