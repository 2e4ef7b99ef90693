"""Checkpoints of a run in the store: written while it trains, and read to resume it after a kill.

    results/runs/ID/checkpoints/STEP-CHECKSUM.safetensors

A file's name contains the checksum of its contents, so that a damaged file is never used. While a run
trains, its latest two are kept.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from safetensors.numpy import load, save

from pneuma.engines.loop import Progress
from pneuma.engines.records import (
    EPISODE_COLUMNS,
    EVALUATION_COLUMNS,
    METRIC_COLUMNS,
    VALUE_COLUMNS,
    Checkpoint,
    Records,
    Row,
)
from pneuma.errors import StorageError, UserError
from pneuma.files import SCHEMA, checksum, parse_json, read_stored, to_json
from pneuma.store.provenance import Attempt, AttemptRecord
from pneuma.store.store import CHECKPOINTS, CheckpointFile, Store, checkpoint_files
from pneuma.store.tables import from_parquet, to_parquet

LATEST_KEPT = 2
LARGEST_CHECKPOINT = 2**32
"""Most bytes of a checkpoint that is read; those of large networks have 600 MB."""
WRITE_SHARE = 40
"""The time between checkpoints is at least this many times the time to write the last one."""
TABLES = {"episodes": EPISODE_COLUMNS, "metrics": METRIC_COLUMNS, "evaluations": EVALUATION_COLUMNS}


_ATTEMPTS = TypeAdapter(list[AttemptRecord])


class RunCheckpoints:
    """The checkpoints of one run while it trains.

    Only the process that holds the run's lock may use this class. There are `seconds` between two of them.

    Attributes:
        attempts: the records of earlier attempts, up to the checkpoint from which this one resumes.
    """

    def __init__(self, store: Store, run_id: str, seconds: float, note: Callable[[str], None]) -> None:
        self._store, self._run_id, self._seconds, self._note = store, run_id, seconds, note
        self._folder = store.run_folder(run_id)
        self._next = time.monotonic() + self._seconds
        self.attempts: list[dict[str, Any]] = []
        for folder in (self._folder, self._folder / CHECKPOINTS):
            for stale_path in folder.glob(".*.*"):
                store.remove(stale_path)  # a temporary file of a process that was killed
        for stale_path in self._folder.glob("*"):
            if stale_path.is_dir() and stale_path.name != CHECKPOINTS:
                store.remove(stale_path)  # a folder in the place of a file

    def latest(self) -> Checkpoint | None:
        """Return the latest sound checkpoint and report damaged ones; None to start from the beginning."""
        self.attempts = []
        for checkpoint_file in checkpoint_files(self._folder):
            content = read_checkpoint(checkpoint_file)
            if content:
                checkpoint, self.attempts = content
                return checkpoint
            self._note(
                f"the checkpoint at step {checkpoint_file.step:,} is damaged: going on from the one before"
            )
            self._store.remove(checkpoint_file.path)
        return None

    def give_up(self, reason: Exception) -> bool:
        """Remove the latest checkpoint, which the engine cannot use; return whether there was one."""
        checkpoints = checkpoint_files(self._folder)
        if not checkpoints:
            return False
        self._note(f"the checkpoint at step {checkpoints[0].step:,} is given up: {reason}")
        self._store.remove(checkpoints[0].path)
        return True

    def update(self, progress: Progress, attempt: Attempt, at_once: bool) -> None:
        """Write a checkpoint if it is time, or `at_once`.

        If it cannot be written, a note is sent and training continues.
        """
        if progress.checkpoint is None:
            return
        start_clock = time.monotonic()
        if start_clock < self._next and not at_once:
            return
        history = {"attempts": self.attempts + [attempt.so_far(progress.step)]}
        try:
            contents = encode(progress.checkpoint(), history, self._run_id)
            self._store.write(self._folder / CHECKPOINTS / file_name(progress.step, contents), contents)
        except StorageError:
            raise
        except UserError as error:
            self._note(f"no checkpoint at step {progress.step:,}: {error}")
        for checkpoint_file in checkpoint_files(self._folder)[LATEST_KEPT:]:
            self._store.remove(checkpoint_file.path)
        write_seconds = time.monotonic() - start_clock
        self._next = start_clock + write_seconds + max(self._seconds, WRITE_SHARE * write_seconds)

    def finish(self) -> None:
        self._store.remove(self._folder / CHECKPOINTS)


# --- Files -----------------------------------------------------------------------------------------


def sound_checkpoint(folder: Path) -> Checkpoint | None:
    """Return the latest sound checkpoint in a run's folder; None if there is none."""
    for checkpoint_file in checkpoint_files(folder):
        content = read_checkpoint(checkpoint_file)
        if content:
            checkpoint, _ = content
            return checkpoint
    return None


def file_name(step: int, encoded_checkpoint: bytes) -> str:
    return f"{step:013}-{checksum(encoded_checkpoint)[:16]}.safetensors"


def read_checkpoint(checkpoint_file: CheckpointFile) -> tuple[Checkpoint, list[dict[str, Any]]] | None:
    """Read a checkpoint and its attempts; None if it is damaged or belongs to another run."""
    try:
        encoded_checkpoint = read_stored(checkpoint_file.path, LARGEST_CHECKPOINT)
        if checksum(encoded_checkpoint)[:16] != checkpoint_file.digest:
            return None
        checkpoint, metadata = decode(encoded_checkpoint)
        if metadata["run_id"] != checkpoint_file.path.parent.parent.name:
            return None
        attempts: list[dict[str, Any]] = metadata["history"]["attempts"]
        _ATTEMPTS.validate_python(attempts)
        parse_json(to_json({"attempts": attempts}))  # the finished run's provenance has them
        return checkpoint, attempts
    except Exception:  # untrusted bytes may raise any error
        return None


def encode(checkpoint: Checkpoint, history: Mapping[str, Any], run_id: str) -> bytes:
    """Return a checkpoint as safetensors, with the run's `attempts` so far.

    The file is rejected in the folder of another run.
    """
    bytes_by_table = table_files(checkpoint.records)
    record_arrays = {
        f"records/{name}": np.frombuffer(data, np.uint8) for name, data in bytes_by_table.items()
    }
    # safetensors needs at least one dimension
    arrays = {name: np.ascontiguousarray(array) for name, array in checkpoint.arrays.items()}
    metadata = {
        "schema": SCHEMA,
        "run_id": run_id,
        "step": checkpoint.step,
        "numbers": checkpoint.numbers,
        "history": history,
        "shapes": {name: list(array.shape) for name, array in checkpoint.arrays.items()},
    }
    return save({**arrays, **record_arrays}, metadata={"pneuma": json.dumps(metadata)})


def decode(encoded_checkpoint: bytes) -> tuple[Checkpoint, dict[str, Any]]:
    """Return a checkpoint and its metadata; other bytes may raise any error."""
    header_size = int.from_bytes(encoded_checkpoint[:8], "little")
    header = json.loads(encoded_checkpoint[8 : 8 + header_size])
    metadata: dict[str, Any] = json.loads(header["__metadata__"]["pneuma"])
    if metadata["schema"] != SCHEMA:
        raise ValueError(f"a checkpoint of schema {metadata['schema']}")
    arrays = load(encoded_checkpoint)
    rows = {}
    for table_name in TABLES:
        rows[table_name] = from_parquet(arrays[f"records/{table_name}"].tobytes()).to_pylist()
    shaped_arrays = {name: arrays[name].reshape(shape) for name, shape in metadata["shapes"].items()}
    return Checkpoint(metadata["step"], shaped_arrays, dict(metadata["numbers"]), Records(**rows)), metadata


def table_files(records: Records, without: Collection[str] = ()) -> dict[str, bytes]:
    """Return each table of records as a Parquet file, without some columns; `VALUE_COLUMNS` are last."""
    files = {}
    for table_name, columns in TABLES.items():
        rows: list[Row] = getattr(records, table_name)
        recorded_columns = list(columns) + [column for column in VALUE_COLUMNS if rows and column in rows[0]]
        files[table_name] = to_parquet(rows, [column for column in recorded_columns if column not in without])
    return files
