"""Checkpoints of a run in the store: where to go on from after a kill.

    results/runs/ID/checkpoints/STEP-CHECKSUM.safetensors

A file's name tells the checksum of its contents, so that one damaged or cut short is never taken for
whole. The latest two are kept while a run trains, and those that a study asks to keep for forks.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load, save

from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS, Records
from pneuma.study.files import SCHEMA, checksum
from pneuma.study.tables import from_parquet, to_parquet

FOLDER = "checkpoints"
LATEST_KEPT = 2
TABLES = {
    "episodes": EPISODE_COLUMNS,
    "metrics": METRIC_COLUMNS,
    "evaluations": EVALUATION_COLUMNS,
}
_NAME = re.compile(r"(\d{13})-([0-9a-f]{16})\.safetensors")


@dataclass(frozen=True)
class CheckpointFile:
    """A checkpoint as it lies in a run's folder, told by its name."""

    path: Path
    step: int
    digest: str


def checkpoint_files(folder: Path) -> list[CheckpointFile]:
    """Return the checkpoints of a run's folder, the latest first, whole or not."""
    found = ((path, _NAME.fullmatch(path.name)) for path in (folder / FOLDER).glob("*.safetensors"))
    files = [CheckpointFile(path, int(match[1]), match[2]) for path, match in found if match]
    return sorted(files, key=lambda file: (file.step, file.digest), reverse=True)


def file_name(step: int, data: bytes) -> str:
    """Return what a checkpoint's file is called."""
    return f"{step:013}-{checksum(data)[:16]}.safetensors"


def read_checkpoint(file: CheckpointFile) -> tuple[Checkpoint, dict[str, Any]] | None:
    """Read a checkpoint and the history kept with it; None where the file is not what was written."""
    try:
        data = file.path.read_bytes()
    except OSError:
        return None
    return decode(data) if checksum(data)[:16] == file.digest else None


def outdated(files: Iterable[CheckpointFile], kept: Iterable[int]) -> list[CheckpointFile]:
    """Return the checkpoints that nobody needs: neither the latest two nor at a step to keep."""
    steps = set(kept)
    return [file for i, file in enumerate(files) if i >= LATEST_KEPT and file.step not in steps]


def encode(checkpoint: Checkpoint, history: Mapping[str, Any]) -> bytes:
    """Return a checkpoint, and what is to be kept with it, as safetensors."""
    tables = {
        f"records/{name}": np.frombuffer(to_parquet(getattr(checkpoint.records, name), columns), np.uint8)
        for name, columns in TABLES.items()
    }
    about = {
        "schema": SCHEMA,
        "step": checkpoint.step,
        "numbers": checkpoint.numbers,
        "history": history,
    }
    # safetensors has no name for an array without dimensions that NumPy would keep so
    arrays = {name: np.ascontiguousarray(array) for name, array in checkpoint.arrays.items()}
    shapes = {name: list(array.shape) for name, array in checkpoint.arrays.items()}
    return save({**arrays, **tables}, metadata={"pneuma": json.dumps({**about, "shapes": shapes})})


def decode(data: bytes) -> tuple[Checkpoint, dict[str, Any]]:
    """Return what `encode` was given."""
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    about = json.loads(header["__metadata__"]["pneuma"])
    arrays = load(data)
    rows = {name: from_parquet(arrays.pop(f"records/{name}").tobytes()).to_pylist() for name in TABLES}
    shaped = {name: arrays[name].reshape(shape) for name, shape in about["shapes"].items()}
    checkpoint = Checkpoint(about["step"], shaped, about["numbers"], Records(**rows))
    return checkpoint, about["history"]
