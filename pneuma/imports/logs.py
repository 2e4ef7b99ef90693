"""What was read of logs becomes the runs of a study, which were not trained here.

    files → `tensorboard.py`, `csv_files.py` → `Log` → `store_logs` → run folders with rows, and their listing

An imported run holds `scalars.parquet` (tag, step, value, superseded) in place of an engine's records. Its id
is a hash of what was read, so importing twice changes nothing.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.errors import UserError
from pneuma.files import checksum, to_json
from pneuma.study.row_builder import cells_of_files
from pneuma.study.rows import encode_row
from pneuma.study.shipped import list_studies
from pneuma.study.store import ROW_FILE, SCALARS_FILE, Identity, Status, Store

AGENT_STEPS = ("rollout/", "train/", "time/", "eval/", "charts/", "losses/")
"""Tags of Stable-Baselines3 and CleanRL whose steps are agent steps."""
EMPTY = "holds no scalars of Stable-Baselines3 or CleanRL"


@dataclass
class Log:
    """One run as it was read.

    Attributes:
        parts: of its name, which tell condition and seed: the folders that it is in.
        points: tag, step, value and superseded (by a restart, or a step that came again), as written.
        identify: returns, for a condition and a seed, the text of which the run's id is a hash.
        provenance: what produced it, as far as that is known.
        notes: what is odd about it, in words.
    """

    parts: tuple[str, ...]
    points: pd.DataFrame
    identify: Callable[[str, int], str]
    provenance: dict[str, Any]
    notes: list[str] = field(default_factory=list)

    @property
    def shown(self) -> str:
        return "/".join(self.parts)

    @property
    def steps(self) -> int:
        """The last logged agent step; 0 if there is none."""
        counted = self.points["tag"].str.startswith(AGENT_STEPS) & ~self.points["superseded"]
        return int(max(0, self.points["step"][counted].max())) if counted.any() else 0


@dataclass(frozen=True)
class ImportedRun:
    """A run of an imported study; `new` if this call stored it."""

    log: Log
    run_id: str
    condition: str
    seed: int
    new: bool


def store_logs(
    read: Iterable[Log], store: Store, source: str, places: Sequence[Path], name: str | None
) -> tuple[str, list[ImportedRun], list[str]]:
    """Store logs as a study; return its name, the runs that have points, and notes for the user.

    They are read once the name is known to be free: without one, the study is called as the folder that
    contains all their places.
    """
    study = _find_study_name(places, name, store, source)
    logs = [*read]
    named, notes = name_runs([log.parts for log in logs])
    runs: dict[str, ImportedRun] = {}
    for (condition, seed), log in sorted(zip(named, logs, strict=True), key=lambda pair: pair[0]):
        notes += [f"{log.shown}: {note}" for note in log.notes]
        run_id = checksum(log.identify(condition, seed).encode())[:16]
        if not log.steps:
            notes.append(f"{log.shown}: {EMPTY} and is left out")
        elif run_id in runs:
            notes.append(f"{log.shown}: holds the same log as {runs[run_id].log.shown} and is left out")
        else:
            runs[run_id] = ImportedRun(log, run_id, condition, seed, not store.status(run_id).finished)
    if not runs:
        raise UserError(f"{logs[0].shown}: {EMPTY}")
    known = {(run["condition"], run["seed"]) for run in (store.listing(study) or {"runs": []})["runs"]}
    if known - {(run.condition, run.seed) for run in runs.values()}:
        raise UserError(f"--name {study}: a study of that name has runs of other logs; give another")
    store.check_writable()
    for run in runs.values():
        if run.new:
            _store_run(run, store, source)
    rows = [{key: getattr(run, key) for key in ("run_id", "condition", "seed")} for run in runs.values()]
    about = {"title": study, "baseline": rows[0]["condition"], "source": source, "runs": rows}
    store.save_listing(study, about)
    return study, [*runs.values()], notes


def _store_run(run: ImportedRun, store: Store, source: str) -> None:
    steps = run.log.steps
    fields = {"env": "Imported TensorBoard logs", "slots": None, "steps": steps}
    about = {"schema": 1, "run_id": run.run_id, "source": source, "run": fields}
    scalars = run.log.points[["tag", "step", "value", "superseded"]]
    files = {
        "run.json": to_json(about),
        "provenance.json": to_json(run.log.provenance),
        SCALARS_FILE: scalars.to_parquet(compression="zstd", index=False),
    }
    status = Status("done", steps, identity=Identity(run.run_id, run.seed, steps))
    files[ROW_FILE] = encode_row(cells_of_files(run.run_id, status, files))
    store.save_run(run.run_id, status, files)


def _find_study_name(folders: Sequence[Path], name: str | None, store: Store, source: str) -> str:
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


def name_runs(found: Sequence[tuple[str, ...]]) -> tuple[list[tuple[str, int]], list[str]]:
    """Return condition and seed of runs by the parts of their names, and notes on seeds that were taken.

    The condition is the name without the seed: Stable-Baselines3 calls folders NAME_SEED, CleanRL
    NAME__SEED__TIME. A name without a number is seed 0. Where two would be the same seed of a condition, one
    takes the next free number.
    """
    named: dict[tuple[str, int], None] = {}
    notes = []
    for parts in found:
        condition, number = _condition_and_seed(parts)
        seed = number
        while (condition, seed) in named:
            seed += 1
        if seed > number:
            notes.append(f"{'/'.join(parts)}: seed {number} of {condition} is taken, so it is seed {seed}")
        named[condition, seed] = None
    return [*named], notes


def _condition_and_seed(parts: tuple[str, ...]) -> tuple[str, int]:
    """Return a condition's name, and the seed from the last part that has a number."""
    name, seed = "/".join(parts), 0
    for place in reversed(range(len(parts))):
        cleanrl = re.fullmatch(r"(.+)__([0-9]{1,9})__[0-9]{9,}", parts[place])
        match = cleanrl or re.fullmatch(r"(.+)_([0-9]{1,18})", parts[place])
        if match:
            name, seed = "/".join((*parts[:place], match[1], *parts[place + 1 :])), int(match[2])
            break
    return name.lstrip("_/ ") or "run", seed  # legends leave out what begins with _


def file_facts(data: bytes) -> dict[str, Any]:
    return {"bytes": len(data), "sha256": checksum(data)}
