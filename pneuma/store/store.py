"""The store: results of runs in a results folder.

    results/runs/ID/        run.json         the resolved configuration
                            provenance.json  what produced it, and how long that took
                            episodes.parquet, metrics.parquet, evaluations.parquet
                            row.arrow        the results of all that (`rows.py`)
                            policy.safetensors
                            error.txt        why it failed: a crash's traceback
                            status.json      status, step, configuration's id, and every file's checksum
                            checkpoints/     from which an unfinished run resumes
    results/published/      tables of rows, for version control
    results/studies/NAME.json  the runs of a study without a file: imported logs
                    NAME.toml  a user's own study as it was last run here
    results/last/NAME.json  the query of a study's last run here, by world

Every file is written whole or not at all, and status.json last. A run is used only if all checksums in
status.json are right. An untrusted folder is safe to read: names that lead out of it are refused, and nothing
in it is executed.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, NotRequired

from annotated_types import MinLen
from pydantic import StringConstraints, TypeAdapter, ValidationError
from typing_extensions import TypedDict

from pneuma.config import WORLD_FIELDS, Run, as_fields, is_gymnasium_id
from pneuma.errors import Hint, StorageError, UserError, shortened
from pneuma.field_types import LONGEST_TEXT
from pneuma.files import (
    SCHEMA,
    checksum,
    create_whole,
    dump_checksummed,
    is_storage_problem,
    load_checksummed,
    names_in,
    parse_json,
    read_stored,
    replace_files,
    stale_files,
    to_json,
    write_error,
)
from pneuma.store.locks import LOCK_FILE, is_held, run_lock
from pneuma.study.identity import config_id
from pneuma.study.shipped import shipped_tables

FINISHED = ("done", "diverged")
"""Statuses of runs that have results and are not trained again."""

SCALARS_FILE = "scalars.parquet"
ROW_FILE = "row.arrow"
"""A run's row. If it is missing or damaged, it is made again from the run's other files."""

PUBLISHED, TABLE_SUFFIX = "published", ".parquet"

CHECKPOINTS = "checkpoints"

LARGEST_ERROR = 2**16
"""Most bytes of what a run printed that are kept, the last ones."""

_RUN_ID = re.compile(r"[0-9a-f]{16}")
_CHECKPOINT_NAME = re.compile(r"([0-9]{13})-([0-9a-f]{16})\.safetensors")
_FILE_NAME = re.compile(r"[\w-]+\.[\w]+")


@dataclass(frozen=True)
class Identity:
    """What identifies a stored run: its configuration without seed and steps, its seed and its steps."""

    config_id: str
    seed: int
    steps: int


@dataclass(frozen=True)
class Status:
    """The status of a run, and the agent steps trained.

    Attributes:
        name: planned if nothing is stored; running while a process trains it; partial if there are only
            checkpoints; damaged if a file is not what was written.
        step: agent steps of the records, or of the latest checkpoint.
        detail: the file that is damaged.
        identity: None if it is not stored, or damaged.
        checksums: of the run's files, by name.
    """

    name: str
    step: int = 0
    detail: str = ""
    identity: Identity | None = field(default=None, compare=False)
    checksums: Mapping[str, str] = field(default_factory=dict, compare=False, repr=False)

    @property
    def finished(self) -> bool:
        return self.name in FINISHED

    @property
    def failed(self) -> bool:
        """Whether it is trained again only when asked for."""
        return self.name == "crashed"


class _Manifest(TypedDict):
    status: Literal["planned", "running", "partial", "done", "diverged", "crashed", "killed", "damaged"]
    step: int
    files: dict[str, str]
    config_id: NotRequired[str]
    seed: NotRequired[int]
    steps: NotRequired[int]


_Shown = Annotated[str, StringConstraints(max_length=LONGEST_TEXT)]


class _Listed(TypedDict):
    run_id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
    condition: _Shown
    seed: int


class _Listing(TypedDict):
    study: Annotated[str, StringConstraints(pattern=r"^[^./\\\x00][^/\\\x00]*$")]
    title: _Shown
    baseline: _Shown
    runs: Annotated[list[_Listed], MinLen(1)]
    source: NotRequired[_Shown]


_adapter = cache(TypeAdapter)


def _checked(document: object, document_type: type) -> Any:
    try:
        return _adapter(document_type).validate_python(document, strict=True)
    except ValidationError:
        return None


def checked_listing(document: object, study: str) -> Any:
    """Return a document if it is the record of this study; None if not."""
    listing = _checked(document, _Listing)
    if listing and listing["study"] == study:
        return listing
    return None


class Store:
    def __init__(self, root: str | os.PathLike[str]) -> None:
        self.root = Path(root)

    def check_writable(self) -> None:
        """Create the folder if needed; check that it can be written, and that no link leads out of it."""
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            for folder_name in ("runs", "studies", "searches"):
                self._check_within(self.root / folder_name)
            with tempfile.TemporaryFile(dir=self.root):
                pass
        except OSError as error:
            problem = f"cannot be written ({error.strerror})"
            if self.root.is_file():
                problem = "is not a folder"
            raise UserError(Hint("results", str(self.root)), f": {problem}; name another folder") from None

    def _check_within(self, folder: Path) -> None:
        """Refuse a folder from which a link leads out of the results, or in a circle."""
        try:
            is_within = folder.resolve().is_relative_to(self.root.resolve())
        except (OSError, RuntimeError):  # Python 3.11 and 3.12 raise RuntimeError for a ring of links
            is_within = False
        if not is_within:
            raise UserError(f"{folder}: is a link that leads out of the results folder; remove it")

    # --- Runs ---------------------------------------------------------------------------------

    def run_folder(self, run_id: str) -> Path:
        if not _RUN_ID.fullmatch(run_id):
            raise UserError(f"{run_id!r} is not a run id: 16 hexadecimal digits")
        return Path(self.root, "runs", run_id)

    def lock(self, run_id: str) -> AbstractContextManager[bool]:
        """Return the lock that a process must hold to train the run."""
        folder = self.run_folder(run_id)
        self._check_within(folder / CHECKPOINTS)
        return run_lock(folder)

    def publishing_lock(self, table_name: str) -> AbstractContextManager[bool]:
        """Return the lock that a process must hold to write a published table, which it reads before."""
        folder = self.root / ".publishing" / table_name
        self._check_within(folder)
        return run_lock(folder)

    def runs(self) -> list[str]:
        """Return the ids of all runs with anything stored, sorted."""
        return [run_id for run_id in names_in(self.root / "runs") if _RUN_ID.fullmatch(run_id)]

    def status(self, run_id: str, quick: bool = False) -> Status:
        """Return a run's status, judged by the checksums of its files; with `quick`, by their existence."""
        folder, stored_status = self.run_folder(run_id), self._stored(run_id)
        status = stored_status or Status("planned")
        names = names_in(folder) if stored_status else []
        for file_name, expected in status.checksums.items():
            if file_name == ROW_FILE:
                continue  # a missing one is made again
            if file_name not in names or not (quick or read_sound(folder, file_name, expected) is not None):
                return replace(status, name="damaged", step=0, detail=file_name)
        if status.finished:
            return status
        try:
            checkpoints = checkpoint_files(folder)
        except UserError as error:
            return replace(status, name="damaged", step=0, detail=str(error))
        steps = [status.step] + [checkpoint.step for checkpoint in checkpoints]  # a crash stores no step
        status = replace(status, step=max(steps))
        if is_held(folder):
            return replace(status, name="running")
        if stored_status is None and os.path.lexists(folder / "status.json"):
            return replace(status, name="damaged", detail="status.json")
        if status.name == "planned" and status.step:
            return replace(status, name="partial")
        return status

    def plan_run(self, run_id: str, identity: Identity) -> None:
        """Note that a run will be trained, unless it has a status."""
        folder = self.run_folder(run_id)
        document = _status_document(Status("planned", identity=identity))
        with self._writing(folder):
            create_whole(folder / "status.json", document, run_lock(folder))

    def delete_run(self, run_id: str) -> None:
        """Remove a run with all its files, while no other process trains it.

        Raises:
            UserError: if it is being trained, or cannot be removed.
        """
        folder = self.run_folder(run_id)
        with self._writing(folder), run_lock(folder) as is_free:
            if not is_free:
                raise UserError(f"run {run_id} is training now: stop its study first")
            self.remove(folder)

    def remove_temporary(self, run_id: str) -> None:
        """Remove what killed processes left in the folder of a run, whose lock this process must hold."""
        for stale_path in stale_files(self.run_folder(run_id), least_seconds=-math.inf):
            self.remove(stale_path)

    def save_row(self, run_id: str, encoded_row: bytes) -> None:
        """Write the row of a finished run that has none."""
        stored_status = self._stored(run_id)
        if stored_status and stored_status.finished:
            status = replace(
                stored_status, checksums={**stored_status.checksums, ROW_FILE: checksum(encoded_row)}
            )
            files = {ROW_FILE: encoded_row, "status.json": _status_document(status)}
            self._write_all(self.run_folder(run_id), files)

    def save_run(self, run_id: str, status: Status, files: Mapping[str, bytes]) -> None:
        """Write a run's files, then the status that lists their checksums; remove its other files.

        A finished run is never replaced by an unfinished one, because another process may have trained it.
        """
        folder, earlier_status = self.run_folder(run_id), self.status(run_id, quick=status.finished)
        if earlier_status.finished and not status.finished:
            return self.remove(folder / LOCK_FILE)
        checksums = {file_name: checksum(contents) for file_name, contents in files.items()}
        status = replace(status, identity=status.identity or earlier_status.identity, checksums=checksums)
        self._write_all(folder, {**files, "status.json": _status_document(status)})
        for file_path in folder.glob("[!.]*"):
            if file_path.name not in checksums and file_path.name != "status.json" and file_path.is_file():
                self.remove(file_path)
        if status.finished:  # a process that takes a new lock sees that the run has finished
            self.remove(folder / LOCK_FILE)

    def save_failure(self, run_id: str, run: Run, status: str, reason: str) -> None:
        last_part = reason.encode()[-LARGEST_ERROR:]
        files = {"run.json": run_document(run, run_id), "error.txt": last_part}
        self.save_run(run_id, Status(status), files)

    def failure(self, run_id: str) -> str:
        """Return the last line of a run's error; empty if it did not fail."""
        try:
            reason = self.read_file(run_id, "error.txt").decode(errors="replace")
        except UserError:
            return ""
        return shortened(reason.strip().rpartition("\n")[2])

    def read_file(self, run_id: str, file_name: str) -> bytes:
        """Return one file of a run, if it is what was written."""
        folder = self.run_folder(run_id)
        contents = read_sound(folder, file_name, self.checksums(run_id).get(file_name))
        if contents is None:
            raise UserError(
                f"{folder / file_name}: missing or damaged; run the study again to retrain this run"
            )
        return contents

    def read_document(self, run_id: str, file_name: str) -> dict[str, Any]:
        """Return a run's JSON file; empty if it is missing, damaged or not an object."""
        try:
            return parse_json(self.read_file(run_id, file_name))
        except (UserError, ValueError):
            return {}

    def checksums(self, run_id: str) -> Mapping[str, str]:
        """Return the checksum of each file of a run, by name."""
        stored_status = self._stored(run_id)
        return stored_status.checksums if stored_status else {}

    def _stored(self, run_id: str) -> Status | None:
        """Return the stored status without checking files; None if there is none, or it is damaged."""
        document = _checked(load_checksummed(self.run_folder(run_id) / "status.json"), _Manifest)
        if document is None:
            return None
        identity = None
        if document.keys() >= {"config_id", "seed", "steps"}:
            identity = Identity(document["config_id"], document["seed"], document["steps"])
        return Status(document["status"], document["step"], identity=identity, checksums=document["files"])

    # --- Studies without a file, and published tables ------------------------------------------

    @property
    def studies(self) -> Path:
        return self.root / "studies"

    def listing_path(self, study: str) -> Path:
        return self.studies / f"{study}.json"

    def save_listing(self, study: str, listing: Mapping[str, Any]) -> None:
        self.write(self.listing_path(study), dump_checksummed({"study": study, **listing}))

    def listing(self, study: str) -> Any:
        """Return the runs of a study without a file; None if there is none, or its record is damaged."""
        return checked_listing(load_checksummed(self.listing_path(study)), study)

    def listings(self) -> list[str]:
        """Return the names of the studies without a file that are recorded here."""
        file_names = names_in(self.studies)
        return [name.removesuffix(".json") for name in file_names if re.fullmatch(r"[^.].*\.json", name)]

    def last_path(self, study: str) -> Path:
        """Return where the last queries of a study are noted (`last_queries.py`)."""
        return self.root / "last" / f"{study}.json"

    def published_path(self, table_name: str) -> Path:
        return self.root / PUBLISHED / f"{table_name}{TABLE_SUFFIX}"

    def published(self, shipped: bool = True) -> list[Path]:
        """Return the published tables here; with `shipped`, also Pneuma's own of other names."""
        folders = [self.root / PUBLISHED]
        if shipped:
            folders.insert(0, shipped_tables())
        table_paths: dict[str, Path] = {}
        for folder in folders:
            for file_name in names_in(folder):
                if file_name.endswith(TABLE_SUFFIX):
                    table_paths[file_name] = folder / file_name
        return [table_paths[file_name] for file_name in sorted(table_paths)]

    # --- Writing ------------------------------------------------------------------------------

    def write(self, file_path: Path, contents: bytes) -> None:
        """Write a file into the results folder, whole or not at all, and create its folder if needed.

        A link at its path is replaced, never followed.
        """
        self._write_all(file_path.parent, {file_path.name: contents})

    def _write_all(self, folder: Path, files: Mapping[str, bytes]) -> None:
        """Write files into a folder in this order. If one fails, those before it may be there."""
        with self._writing(folder):
            replace_files(folder, files)
        for stale_path in stale_files(folder):
            self.remove(stale_path)

    def remove(self, path: Path) -> None:
        """Remove a file or a folder of the results, if it exists; of a link, the link itself.

        Nothing else removes files from a results folder.

        Raises:
            UserError: if it lies outside the results folder, or cannot be removed.
        """
        self._check_within(path.parent)
        try:
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)
        except FileNotFoundError:
            pass  # another process has removed a part of it
        except OSError as error:
            message = f"{path}: cannot be removed ({error.strerror or error})"
            if is_storage_problem(error):
                raise StorageError(message) from None
            raise UserError(message) from None

    @contextmanager
    def _writing(self, folder: Path) -> Iterator[None]:
        """Create a folder of the results to write into; an error names the file that cannot be written."""
        self._check_within(folder)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            yield
        except OSError as error:
            raise write_error(folder, error) from None


def read_sound(folder: Path, file_name: str, expected_checksum: str | None) -> bytes | None:
    """Return a file of a run; None if it lacks the checksum that the run's status lists."""
    if not expected_checksum or not _FILE_NAME.fullmatch(file_name):
        return None
    try:
        contents = read_stored(folder / file_name)
    except OSError:
        return None
    if checksum(contents) != expected_checksum:
        return None
    return contents


class CheckpointFile(NamedTuple):
    step: int
    digest: str
    path: Path


def checkpoint_files(folder: Path) -> list[CheckpointFile]:
    """Return the checkpoint files in a run's folder, the latest first; they may be damaged."""
    checkpoints = []
    for file_name in names_in(folder / CHECKPOINTS):
        match = _CHECKPOINT_NAME.fullmatch(file_name)
        if match:
            checkpoints.append(CheckpointFile(int(match[1]), match[2], folder / CHECKPOINTS / file_name))
    return sorted(checkpoints, reverse=True)


def run_identity(run: Run) -> Identity:
    return Identity(config_id(run), run.seed, run.steps)


def run_document(run: Run, run_id: str) -> bytes:
    """Return a run's configuration; in another environment without the fields of Pneuma's worlds."""
    fields = as_fields(run)
    if is_gymnasium_id(run.env):
        fields = {field_name: value for field_name, value in fields.items() if field_name not in WORLD_FIELDS}
    return to_json({"schema": SCHEMA, "run_id": run_id, "run": fields})


def _status_document(status: Status) -> bytes:
    document = {"status": status.name, "step": status.step, "files": status.checksums}
    if status.identity:
        document |= asdict(status.identity)
    return dump_checksummed(document)
