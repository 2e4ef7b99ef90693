"""Store logs of other programs as a study.

    files -> `tensorboard.py`, `csv_files.py` -> `Log` -> `store_logs` -> run folders with rows, their listing

An imported run has `scalars.parquet` (tag, step, value, superseded) instead of an engine's records. Its id is
a hash of its files and of what selects their data, so that importing twice changes nothing.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.errors import Hint, Message, UserError, counted, print_aside
from pneuma.field_types import LONGEST_TEXT
from pneuma.files import checksum, to_json
from pneuma.store.row_builder import cells_of_files
from pneuma.store.rows import encode_row
from pneuma.store.store import ROW_FILE, SCALARS_FILE, Identity, Status, Store
from pneuma.study.shipped import list_studies

AGENT_STEPS = ("rollout/", "train/", "time/", "eval/", "charts/", "losses/")
"""Tags of Stable-Baselines3 and CleanRL whose steps are agent steps."""
LOG_KINDS = {"csv": "CSV files", "tensorboard": "TensorBoard logs"}
"""The kinds of logs. Messages name them instead of an environment, which logs do not contain."""
MOST_COLUMNS = 1_000
"""Most columns of a table, or tags of a log, all of which are kept in memory."""
SCALAR_COLUMNS = ["tag", "step", "value", "superseded"]


@dataclass
class Log:
    """One run as it was read.

    Attributes:
        name: its file or folder, for messages.
        condition: its condition in the study.
        seed: its seed.
        points: tag, step, value and superseded (by a restart), as written.
        identity: a text that names its files and what selects their data.
        provenance: what produced it, as far as that is known.
        notes: messages about points that are left out.
        new: whether it was not stored before.
    """

    name: str
    condition: str
    seed: int
    points: pd.DataFrame
    identity: str
    provenance: dict[str, Any]
    notes: list[str] = field(default_factory=list)
    new: bool = False

    @property
    def run_id(self) -> str:
        return checksum(self.identity.encode())[:16]

    @property
    def steps(self) -> int:
        """The last logged agent step; 0 if there is none."""
        counts = self.points["tag"].str.startswith(AGENT_STEPS) & ~self.points["superseded"]
        return int(self.points["step"][counts].max()) if counts.any() else 0


Import = tuple[str, list[Log], list[str]]
"""An imported study's name, its runs that were read, and notes for the user."""


def store_logs(
    logs: Sequence[Log], store: Store, log_kind: str, study_name: str, adds_runs: bool = False
) -> Import:
    """Store logs as the runs of a study.

    Args:
        logs: the runs that were read.
        store: where to store them.
        log_kind: the kind of logs.
        study_name: the study's name, as `choose_study_name` returns it.
        adds_runs: whether the study keeps its other runs.

    Raises:
        UserError: for two runs of one name or with the same data, or a study that has other runs.
    """
    notes: list[str] = []
    by_name: dict[object, Log] = {}
    by_id: dict[str, Log] = {}
    for log in sorted(logs, key=lambda log: (log.condition, log.seed)):
        notes += [f"{log.name}: {note}" for note in log.notes]
        if log.steps == 0:
            notes.append(f"{log.name}: has no values at agent steps, and is left out")
            continue
        if len(log.condition) > LONGEST_TEXT:
            raise UserError(f"{log.name}: the name of its condition has more than {LONGEST_TEXT} letters")
        first_log = by_name.setdefault((log.condition, log.seed), log)
        if first_log is not log:
            problem = f"{first_log.name} and {log.name} are two runs of one name, "
            raise UserError(f"{problem}{log.condition} with seed {log.seed}: give each another seed")
        first_log = by_id.setdefault(log.run_id, log)
        if first_log is not log:
            raise UserError(f"{first_log.name} and {log.name} contain the same data: import one of them")
    kept_logs = list(by_id.values())
    if not kept_logs:
        raise UserError(
            f"{logs[0].name}: has no values at agent steps as Stable-Baselines3 or CleanRL log them"
        )
    listing = store.listing(study_name) or {"baseline": kept_logs[0].condition, "runs": []}
    other_runs, replaced = [], 0
    for run in listing["runs"]:
        if (run["condition"], run["seed"]) not in by_name:
            other_runs.append(run)
        elif run["run_id"] not in by_id:
            replaced += 1
    if replaced:
        text = f"{counted(replaced, 'run')} of study {study_name} had other data before; another "
        notes.append(Message(text, Hint("name"), " keeps both"))
    if other_runs and not adds_runs:
        text = f"study {study_name} has other runs; give "
        raise UserError(text, Hint("name", study_name), " to add to them, or another name")
    store.check_writable()
    print_aside(f"Storing {counted(len(kept_logs), 'run')} as the study {study_name} in {store.root}.")
    for log in kept_logs:
        log.new = not store.status(log.run_id).finished
        if log.new:
            _store_run(log, store, log_kind)
    runs = [{"run_id": log.run_id, "condition": log.condition, "seed": log.seed} for log in kept_logs]
    store.save_listing(
        study_name, {"title": study_name, "source": log_kind, **listing, "runs": other_runs + runs}
    )
    return study_name, kept_logs, notes


def _store_run(log: Log, store: Store, log_kind: str) -> None:
    run_fields = {"env": f"Imported {LOG_KINDS[log_kind]}", "slots": None, "steps": log.steps}
    document = {"schema": 1, "run_id": log.run_id, "source": log_kind, "run": run_fields}
    files = {
        "run.json": to_json(document),
        "provenance.json": to_json(log.provenance),
        SCALARS_FILE: log.points[SCALAR_COLUMNS].to_parquet(compression="zstd", index=False),
    }
    status = Status("done", log.steps, identity=Identity(log.run_id, log.seed, log.steps))
    files[ROW_FILE] = encode_row(cells_of_files(log.run_id, status, files))
    with store.lock(log.run_id) as is_free:
        if is_free:  # or another import stores the same
            store.remove_temporary(log.run_id)
            store.save_run(log.run_id, status, files)


def choose_study_name(study_name: str | None, source_path: Path, store: Store, log_kind: str) -> str:
    """Return the name of the study to import into; the default is the name of the logs' folder or file."""
    if study_name is None:
        study_name = re.sub(r"[^A-Za-z0-9._-]+", "-", source_path.resolve().name).strip("-.")
    if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}", study_name) or study_name.endswith(".toml"):
        raise UserError(
            Hint("name", study_name), ": use only letters, digits, dots, - and _, and not the name of a file"
        )
    if study_name in list_studies():
        raise UserError(Hint("name", study_name), ": this is the name of a shipped study; give another")
    listing = store.listing(study_name)
    if listing and listing.get("source") != log_kind:
        raise UserError(
            Hint("name", study_name), f": a study with this name was run in {store.root}; give another"
        )
    return study_name


def condition_and_seed(folder_names: Sequence[str]) -> tuple[str, int]:
    """Return the condition and the seed in the names of a run's folders.

    Stable-Baselines3 calls folders CONDITION_SEED, CleanRL CONDITION__SEED__TIME. The seed is that of the
    last name with a number, 0 without one; the condition is all the names without it.
    """
    remaining_names, seed = list(folder_names), 0
    for position in reversed(range(len(remaining_names))):
        match = re.fullmatch(r"(.+)__([0-9]{1,9})__[0-9]{9,}", remaining_names[position])
        match = match or re.fullmatch(r"(.+)_([0-9]{1,18})", remaining_names[position])
        if match:
            remaining_names[position], seed = match[1], int(match[2])
            break
    return "/".join(remaining_names).lstrip("_/ ") or "run", seed  # legends leave out names that begin with _


def file_facts(file_bytes: bytes) -> dict[str, Any]:
    return {"bytes": len(file_bytes), "sha256": checksum(file_bytes)}
