"""Checkpoints of a run in the store: where to go on from after a kill.

    results/runs/ID/checkpoints/STEP-CHECKSUM.safetensors

A file's name tells the checksum of its contents, so that one damaged or cut short is never taken for
whole. The latest two are kept while a run trains, and those that a study asks to keep for forks.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load, save

from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.records import (
    EPISODE_COLUMNS,
    EVALUATION_COLUMNS,
    LEARNER_COLUMNS,
    METRIC_COLUMNS,
    VALUE_COLUMNS,
    Records,
    Row,
    columns_of,
)
from pneuma.study.files import CHECKPOINTS, SCHEMA, checksum, read_checkpoint_name, read_whole
from pneuma.study.tables import from_parquet, to_parquet

FOLDER = CHECKPOINTS
LATEST_KEPT = 2
TABLES = {
    "episodes": EPISODE_COLUMNS,
    "metrics": METRIC_COLUMNS,
    "evaluations": EVALUATION_COLUMNS,
    "learners": LEARNER_COLUMNS,
}
OPTIONAL_TABLES = ("learners",)
"""Those that are left out where they have no rows."""


@dataclass(frozen=True)
class CheckpointFile:
    """A checkpoint as it lies in a run's folder, told by its name."""

    path: Path
    step: int
    digest: str


def checkpoint_files(folder: Path) -> list[CheckpointFile]:
    """Return the checkpoints of a run's folder, the latest first, whole or not."""
    found = ((path, read_checkpoint_name(path.name)) for path in (folder / FOLDER).glob("*.safetensors"))
    files = [CheckpointFile(path, *told) for path, told in found if told]
    return sorted(files, key=lambda file: (file.step, file.digest), reverse=True)


def file_name(step: int, data: bytes) -> str:
    """Return what a checkpoint's file is called."""
    return f"{step:013}-{checksum(data)[:16]}.safetensors"


def read_checkpoint(file: CheckpointFile) -> tuple[Checkpoint, dict[str, Any]] | None:
    """Read a checkpoint and the history kept with it; None where it is not what was written there.

    That is a file that is damaged, no checkpoint at all, or one of another step or run.
    """
    try:
        data = read_whole(file.path)
    except OSError:
        return None
    if checksum(data)[:16] != file.digest:
        return None
    try:
        about = _about(data)
        checkpoint, history = _decoded(about, data)
    except Exception:  # whatever a stranger's bytes lead the readers of JSON, safetensors and Parquet to
        return None
    run = file.path.parent.parent.name
    whole = checkpoint.step == file.step and about.get("run_id") in (None, run) and _is_history(history)
    return (checkpoint, {"attempts": [], "resumes": [], **history}) if whole else None


def outdated(files: Iterable[CheckpointFile], kept: Iterable[int]) -> list[CheckpointFile]:
    """Return the checkpoints that nobody needs: neither the latest two nor at a step to keep."""
    steps = set(kept)
    return [file for i, file in enumerate(files) if i >= LATEST_KEPT and file.step not in steps]


def encode(checkpoint: Checkpoint, history: Mapping[str, Any], run_id: str | None = None) -> bytes:
    """Return a checkpoint, and what is to be kept with it, as safetensors.

    Args:
        checkpoint: of a run.
        history: its `attempts` and `resumes` so far.
        run_id: the run's, so that the file is of no use in the folder of another.
    """
    tables = {
        f"records/{name}": np.frombuffer(data, np.uint8)
        for name, data in table_files(checkpoint.records).items()
    }
    about = {
        "schema": SCHEMA,
        **({"run_id": run_id} if run_id else {}),
        "step": checkpoint.step,
        "numbers": checkpoint.numbers,
        "history": history,
    }
    # safetensors has no name for an array without dimensions that NumPy would keep so
    arrays = {name: np.ascontiguousarray(array) for name, array in checkpoint.arrays.items()}
    shapes = {name: list(array.shape) for name, array in checkpoint.arrays.items()}
    return save({**arrays, **tables}, metadata={"pneuma": json.dumps({**about, "shapes": shapes})})


def table_files(records: Records) -> dict[str, bytes]:
    """Return every table of records as a Parquet file."""
    return {
        name: to_parquet(rows, columns_of(rows, columns))
        for name, columns in TABLES.items()
        for rows in [getattr(records, name)]
        if rows or name not in OPTIONAL_TABLES
    }


def decode(data: bytes) -> tuple[Checkpoint, dict[str, Any]]:
    """Return what `encode` was given.

    Raises:
        ValueError: for bytes of another schema; other bytes may raise anything.
    """
    return _decoded(_about(data), data)


def _about(data: bytes) -> dict[str, Any]:
    """Return what a checkpoint says of itself."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    about: dict[str, Any] = json.loads(header["__metadata__"]["pneuma"])
    if about["schema"] != SCHEMA:
        raise ValueError(f"a checkpoint of schema {about['schema']}")
    return about


def _decoded(about: Mapping[str, Any], data: bytes) -> tuple[Checkpoint, dict[str, Any]]:
    arrays = load(data)
    rows = {
        name: _rows(arrays.pop(f"records/{name}").tobytes(), columns)
        for name, columns in TABLES.items()
        if f"records/{name}" in arrays or name not in OPTIONAL_TABLES
    }
    shaped = {name: arrays[name].reshape(shape) for name, shape in about["shapes"].items()}
    numbers, history = dict(about["numbers"]), dict(about["history"])
    return Checkpoint(about["step"], shaped, numbers, Records(**rows)), history


def _rows(data: bytes, columns: Sequence[str]) -> list[Row]:
    """Return the rows of a table that has the contract's columns, with those that it has on top."""
    table = from_parquet(data)
    own = [name for name in VALUE_COLUMNS if name in table.column_names]
    rows: list[Row] = table.select([*columns, *own]).to_pylist()
    return rows


def _is_history(history: Mapping[str, Any]) -> bool:
    """Tell whether a history is one, or none."""
    attempts, resumes = history.get("attempts", []), history.get("resumes", [])
    return (
        isinstance(attempts, list)
        and isinstance(resumes, list)
        and all(isinstance(each, dict) and _is_attempt(each) for each in attempts)
        and all(isinstance(each, dict) for each in resumes)
    )


def _is_attempt(attempt: Mapping[str, Any]) -> bool:
    timed = isinstance(attempt.get("wall_seconds"), int | float)
    return timed and isinstance(attempt.get("started"), str) and isinstance(attempt.get("machine"), dict)
