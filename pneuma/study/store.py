"""The store: what runs left behind, in a results folder.

    results/runs/ID/        run.json         the resolved configuration
                            provenance.json  what produced it, and how long that took
                            episodes.parquet, metrics.parquet, evaluations.parquet
                            policy.safetensors
                            error.txt        a crash's traceback
                            status.json      status, step, and the checksum of every other file
    results/studies/NAME.json  the latest selection of a study and its run ids

Every file appears whole or not at all, and status.json comes last: a run that it does not vouch
for, checksum by checksum, is not there.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.config import Run, as_settings
from pneuma.errors import UserError

SCHEMA = 1
STATUSES = ("planned", "done", "diverged", "crashed", "killed", "damaged")
FINISHED = ("done", "diverged")
"""Statuses that are results: such a run is not trained again."""


@dataclass(frozen=True)
class Status:
    """Where a run stands, one of `STATUSES`, and agent steps trained."""

    name: str
    step: int = 0

    @property
    def finished(self) -> bool:
        """Whether there is nothing left to train."""
        return self.name in FINISHED


class Store:
    """A results folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def check_writable(self) -> None:
        """Make the folder if need be and try to write there.

        Raises:
            UserError: when that fails.
        """
        try:
            if any(path.is_file() for path in (self.root, *self.root.parents)):
                raise OSError(0, "there is a file in its place")
            self.root.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.root):
                pass
        except OSError as error:
            raise UserError(
                f"--results {self.root}: cannot be written ({error.strerror}); name another folder"
            ) from None

    # --- Runs ---------------------------------------------------------------------------------

    def run_folder(self, run_id: str) -> Path:
        """Return the folder of a run."""
        return self.root / "runs" / run_id

    def status(self, run_id: str) -> Status:
        """Return how far a run is; 'planned' where nothing is stored, 'damaged' where a checksum is wrong."""
        manifest = self._manifest(run_id)
        if manifest is None:
            return Status("planned")
        try:
            for name in manifest["files"]:
                self.read_file(run_id, name)
        except UserError:
            return Status("damaged")
        return Status(manifest["status"], manifest["step"])

    def save_run(self, run_id: str, status: Status, files: Mapping[str, bytes]) -> None:
        """Write a run's files, then the status that vouches for them; other files of the run go.

        A finished run is never replaced by one that is not: another process may have trained it.
        """
        if not status.finished and self.status(run_id).finished:
            return
        folder = self.run_folder(run_id)
        folder.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            write_whole(folder / name, data)
        checksums = {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        manifest = {"schema": SCHEMA, "status": status.name, "step": status.step, "files": checksums}
        write_whole(folder / "status.json", to_json(manifest))
        for path in folder.glob("[!.]*"):
            if path.name not in (*files, "status.json"):
                path.unlink(missing_ok=True)

    def read_file(self, run_id: str, name: str) -> bytes:
        """Return one file of a run.

        Raises:
            UserError: when it is missing or not what was written.
        """
        manifest = self._manifest(run_id) or {"files": {}}
        path = self.run_folder(run_id) / name
        data = path.read_bytes() if path.is_file() else b""
        if hashlib.sha256(data).hexdigest() != manifest["files"].get(name):
            raise UserError(f"{path}: missing or damaged; run the study again to retrain this run")
        return data

    def _manifest(self, run_id: str) -> dict[str, Any] | None:
        manifest = _read_document(self.run_folder(run_id) / "status.json")
        return manifest if manifest and {"status", "step", "files"} <= manifest.keys() else None

    # --- Studies ------------------------------------------------------------------------------

    def save_selection(self, study: str, record: Mapping[str, Any]) -> None:
        """Record a study's latest selection and its run ids."""
        folder = self.root / "studies"
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / f"{study}.json", to_json({"schema": SCHEMA, **record}))

    def selection(self, study: str) -> dict[str, Any] | None:
        """Return a study's latest record, or None when it was never run here."""
        record = _read_document(self.root / "studies" / f"{study}.json")
        return record if record and {"study", "runs", "selection"} <= record.keys() else None

    def studies(self) -> list[str]:
        """Return the names of the studies that were run here."""
        return sorted(path.stem for path in (self.root / "studies").glob("*.json"))


def _read_document(path: Path) -> dict[str, Any] | None:
    """Return a JSON document of this schema, or None where there is no sound one."""
    try:
        document = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    sound = isinstance(document, dict) and document.get("schema") == SCHEMA
    return document if sound else None


def run_document(run: Run, run_id: str) -> bytes:
    """Return the contents of run.json."""
    return to_json({"schema": SCHEMA, "run_id": run_id, "run": as_settings(run)})


def to_json(value: object) -> bytes:
    """Return a value as indented JSON with a final newline."""
    return (json.dumps(value, indent=2) + "\n").encode()


def write_whole(path: Path, data: bytes) -> None:
    """Write a file so that it is there whole or not at all, whatever happens meanwhile.

    A link is followed; what is no ordinary file, such as a pipe or a terminal, is written to.
    """
    path = path.resolve()
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
