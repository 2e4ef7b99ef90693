"""The store: results of runs in a results folder.

    results/runs/ID/        run.json         the resolved configuration
                            provenance.json  what produced it, and how long that took
                            episodes.parquet, metrics.parquet, evaluations.parquet
                            policy.safetensors
                            error.txt        why it failed, a crash's traceback
                            status.json      status, step, and the checksum of every other file
                            checkpoints/     where a run that has not ended goes on from
    results/studies/NAME.json  what was selected of a study, and its run ids

Every file is written whole or not at all, and status.json last. A run is used only if all checksums in
status.json are right. An untrusted folder is safe to read: names that would lead out of it are refused, and
nothing in it is ever run.
"""

from __future__ import annotations

import errno
import os
import re
import tempfile
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.config import Run, as_fields
from pneuma.errors import UserError
from pneuma.files import (
    SCHEMA,
    checksum,
    names_in,
    parse_json,
    read_sealed,
    read_whole,
    replace_files,
    seal,
    to_json,
)
from pneuma.study.locks import is_held, run_lock, short_lock

STATUSES = (
    "planned", "running", "partial", "done", "diverged", "crashed", "killed", "timeout", "damaged",
)  # fmt: skip
FINISHED = ("done", "diverged")
"""Statuses of runs that have results and are not trained again."""
FAILED = ("crashed", "timeout")
"""Statuses of failed runs, which are trained again only when asked for."""

SCALARS_FILE = "scalars.parquet"
"""The file of an imported run: every value in its logs."""

PUBLISHED, TABLE_SUFFIX = "published", ".parquet"
"""The folder of published tables in a results folder, and the ending of their names."""

CHECKPOINTS = "checkpoints"
"""The folder of a run's checkpoints."""

_RUN_ID = re.compile(r"[0-9a-f]{16}")
_CHECKPOINT_NAME = re.compile(r"([0-9]{13})-([0-9a-f]{16})\.safetensors")
_FILE_NAME = re.compile(r"[\w-]+\.[\w]+")


@dataclass(frozen=True)
class Status:
    """The status of a run, and the agent steps trained.

    Attributes:
        name: planned if nothing is stored; running while a process trains it or its group; partial if there
            are only checkpoints; damaged if a file is not what was written.
        step: agent steps of the records, or of the latest checkpoint.
        detail: the file that is damaged.
    """

    name: str
    step: int = 0
    detail: str = ""

    @property
    def finished(self) -> bool:
        """Whether nothing is left to train."""
        return self.name in FINISHED

    @property
    def failed(self) -> bool:
        """Whether the run failed and is trained again only when asked for."""
        return self.name in FAILED


class Store:
    """A results folder."""

    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = Path(root)

    def check_writable(self) -> None:
        """Create the folder if needed and check that it can be written.

        Raises:
            UserError: when that fails, or a part of it is no folder, or a link that leads out.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            for folder in (self.root / part for part in ("runs", "studies", "searches")):
                self._check_within(folder)
            with tempfile.TemporaryFile(dir=self.root):
                pass
        except OSError as error:
            problem = "is not a folder" if self.root.is_file() else f"cannot be written ({error.strerror})"
            raise UserError(f"--results {self.root}: {problem}; name another folder") from None

    def _check_within(self, folder: Path) -> None:
        """Refuse a folder from which a link leads out of the results, or in a circle."""
        try:
            within = folder.resolve().is_relative_to(self.root.resolve())
        except (OSError, RuntimeError):  # Python 3.11 and 3.12 say of a ring of links: RuntimeError
            within = False
        if not within:
            raise UserError(f"{folder}: a link leads out of the results folder; remove it")

    # --- Runs ---------------------------------------------------------------------------------

    def run_folder(self, run_id: str) -> Path:
        """Return the folder of a run.

        Raises:
            UserError: for an invalid id.
        """
        if not _RUN_ID.fullmatch(run_id):
            raise UserError(f"{run_id!r} is no run's id: 16 hexadecimal digits")
        return self.root / "runs" / run_id

    def lock(self, run_id: str) -> AbstractContextManager[bool]:
        """Return the lock that a process must hold to train the run.

        Raises:
            OSError: when the run's folder is a link, which may lead elsewhere.
        """
        folder = self.run_folder(run_id)
        for part in (folder, folder / CHECKPOINTS):
            if part.is_symlink():
                raise OSError(errno.ELOOP, f"{part.name} is a link; remove it")
        return run_lock(folder)

    def runs(self) -> list[str]:
        """Return the ids of all runs with anything stored, sorted."""
        return [name for name in names_in(self.root / "runs") if _RUN_ID.fullmatch(name)]

    def status(self, run_id: str, quick: bool = False) -> Status:
        """Return a run's status, judged by the checksums of its files; with `quick`, by their existence."""
        folder, manifest = self.run_folder(run_id), self._manifest(run_id)
        recorded = Status(manifest["status"], manifest["step"]) if manifest else Status("planned")
        for name, expected in manifest["files"].items() if manifest else ():
            sound = (folder / name).is_file() if quick else read_sound(folder, name, expected) is not None
            if not sound:
                return Status("damaged", 0, name)
        if recorded.finished:
            return recorded
        try:
            checkpoints = [*map(read_checkpoint_name, names_in(folder / CHECKPOINTS))]
        except UserError as error:
            return Status("damaged", 0, str(error))
        steps = [named[0] for named in checkpoints if named]  # a crash does not know its step
        step = max(recorded.step, 0, *steps)
        if is_held(folder):
            return Status("running", step)
        if manifest is None and os.path.lexists(folder / "status.json"):
            return Status("damaged", step, "status.json")
        return Status("partial" if step and not manifest else recorded.name, step)

    def save_run(self, run_id: str, status: Status, files: Mapping[str, bytes]) -> None:
        """Write a run's files, then the status that lists their checksums; remove its other files.

        A finished run is never replaced by an unfinished one, because another process may have trained it.

        Raises:
            UserError: when the folder cannot be written.
        """
        if not status.finished and self.status(run_id).finished:
            return
        folder = self.run_folder(run_id)
        checksums = {name: checksum(data) for name, data in files.items()}
        manifest = {"status": status.name, "step": status.step, "files": checksums}
        self._write_all(folder, {**files, "status.json": seal(manifest)})
        for path in folder.glob("[!.]*"):
            if path.name not in (*files, "status.json") and path.is_file():
                path.unlink(missing_ok=True)
        if status.finished:  # whoever takes the lock from now on sees that nothing is left to train
            with suppress(OSError):
                (folder / ".lock").unlink()

    def save_failure(self, run_id: str, run: Run, status: str, why: str) -> None:
        """Write how a run failed, and why.

        Raises:
            UserError: when the folder cannot be written.
        """
        files = {"run.json": run_document(run, run_id), "error.txt": why.encode()}
        self.save_run(run_id, Status(status), files)

    def failure(self, run_id: str) -> str:
        """Return the last line of why a run failed; empty if it did not."""
        with suppress(UserError):
            return self.read_file(run_id, "error.txt").decode(errors="replace").strip().rpartition("\n")[2]
        return ""

    def read_file(self, run_id: str, name: str) -> bytes:
        """Return one file of a run.

        Raises:
            UserError: when it is missing or not what was written.
        """
        folder = self.run_folder(run_id)
        data = read_sound(folder, name, self.checksums(run_id).get(name))
        if data is None:
            raise UserError(f"{folder / name}: missing or damaged; run the study again to retrain this run")
        return data

    def read_document(self, run_id: str, name: str) -> dict[str, Any]:
        """Return a run's JSON file; empty if it is missing, damaged or no object."""
        try:
            return parse_json(self.read_file(run_id, name))
        except (UserError, ValueError):
            return {}

    def checksums(self, run_id: str) -> dict[str, str]:
        """Return the checksums of the files that a run's status lists, by their names."""
        files: dict[str, str] = (self._manifest(run_id) or {"files": {}})["files"]
        return files

    def _manifest(self, run_id: str) -> dict[str, Any] | None:
        manifest = read_sealed(self.run_folder(run_id) / "status.json")
        from pneuma.study.documents import Manifest, fits  # pydantic: not for `--help`

        return manifest if manifest and fits(manifest, Manifest) else None

    # --- Studies ------------------------------------------------------------------------------

    def selecting(self) -> AbstractContextManager[None]:
        """Return the lock to hold from reading a study's record until its next one is saved."""
        folder = self.root / "studies"
        folder.mkdir(parents=True, exist_ok=True)
        return short_lock(folder / ".lock")

    def save_selection(self, study: str, record: Mapping[str, Any]) -> None:
        """Record a study's latest selection and its run ids.

        Raises:
            UserError: when the folder cannot be written.
        """
        self.write(self.selection_path(study), seal(record))

    def selection(self, study: str) -> dict[str, Any] | None:
        """Return a study's latest selection; None if it was never run here or its record is damaged."""
        return next(iter(self.selections(study)), None)

    def selections(self, study: str) -> list[dict[str, Any]]:
        """Return a study's selections with different budgets, engines or files, the latest first."""
        from pneuma.study.documents import Record, fits

        latest = read_sealed(self.selection_path(study)) or {}
        if not fits(latest, Record) or "selection" not in latest or latest["study"] != study:
            return []
        earlier = latest.pop("earlier", [])
        others = ({**latest, **record} for record in earlier if isinstance(record, dict))
        return [latest, *(record for record in others if fits(record, Record))]

    def check_same_file(self, record: Mapping[str, Any], path: Path) -> None:
        """Refuse a study's file if the record of its name was made from another file.

        If the recorded file no longer exists, it may have moved, and the new one is accepted. So is Pneuma's
        own file of a search's winners, whose folder may have been copied.

        Raises:
            UserError: for another file.
        """
        other = record.get("path")
        if isinstance(other, str) and (Path(other) == path.resolve() or not os.path.isfile(other)):
            return
        copied = isinstance(other, str) and Path(other).parts[-2:] == ("searches", path.name)
        if copied and path.resolve().parent == (self.root / "searches").resolve():
            return
        of = other or "no file (imported, published or forked)"
        mend = "give the file another name, or --results another folder"
        raise UserError(f"{path}: the runs of study {record['study']} in {self.root} are of {of}; {mend}")

    def finished(self, record: Mapping[str, Any]) -> int:
        """Return how many runs of a selection have finished."""
        return sum(self.status(run["run_id"], quick=True).finished for run in record["runs"])

    def selection_path(self, study: str) -> Path:
        """Return the path of a study's record."""
        return self.root / "studies" / f"{study}.json"

    def published_path(self, study: str, shipped: bool = True) -> Path:
        """Return the path of a study's published table: here, or with `shipped` among Pneuma's own."""
        own_path, of_pneuma = (
            folder / f"{study}{TABLE_SUFFIX}" for folder in (self.root / PUBLISHED, shipped_tables())
        )
        return of_pneuma if shipped and of_pneuma.exists() and not os.path.lexists(own_path) else own_path

    def published(self, shipped: bool = True) -> list[str]:
        """Return the names of studies with a published table here; with `shipped`, also Pneuma's own."""
        folders = [self.root / PUBLISHED, *([shipped_tables()] if shipped else [])]
        paths = (Path(name) for folder in folders for name in names_in(folder))
        return [*dict.fromkeys(path.stem for path in paths if path.suffix == TABLE_SUFFIX)]

    def studies(self) -> list[str]:
        """Return the names of the studies that were run here."""
        names = names_in(self.root / "studies")
        return [name.removesuffix(".json") for name in names if re.fullmatch(r"[^.].*\.json", name)]

    # --- Writing ------------------------------------------------------------------------------

    def write(self, path: Path, data: bytes) -> None:
        """Write a file into the results folder, whole or not at all, and create its folder if needed.

        A link at its path is replaced, never followed.

        Raises:
            UserError: when that fails, or leads out of the results folder.
        """
        self._write_all(path.parent, {path.name: data})

    def _write_all(self, folder: Path, files: Mapping[str, bytes]) -> None:
        """Write files into a folder in this order. If one fails, those before it may be there."""
        self._check_within(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            replace_files(folder, files)
        except OSError as error:
            raise UserError(
                f"{folder / next(iter(files))}: cannot be written ({error.strerror or error})"
            ) from None


def read_sound(folder: Path, name: str, expected: str | None) -> bytes | None:
    """Return a file of a run; None if it lacks the checksum that the run's status lists."""
    with suppress(OSError):
        if expected and _FILE_NAME.fullmatch(name):
            data = read_whole(folder / name)
            return data if checksum(data) == expected else None
    return None


def read_checkpoint_name(name: str) -> tuple[int, str] | None:
    """Return the step and checksum in a checkpoint's file name; None for any other file."""
    match = _CHECKPOINT_NAME.fullmatch(name)
    return (int(match[1]), match[2]) if match else None


def shipped_tables() -> Path:
    """Return the folder of published tables that come with Pneuma, in a package or a source tree."""
    try:
        return Path(next(iter(import_module("pneuma.published").__path__)))
    except ModuleNotFoundError:
        return Path(__file__).parents[2] / "results" / "published"


def run_document(run: Run, run_id: str) -> bytes:
    """Return the contents of run.json."""
    return to_json({"schema": SCHEMA, "run_id": run_id, "run": as_fields(run)})
