"""Files: written whole or not at all, documents with a checksum, and what reading stored files may raise."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
import re
import stat
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.errors import StorageError, UserError

SCHEMA = 1
"""The version of all documents."""

MADE_BY = "made by pneuma"
"""Words in a report and in an exported policy, by which a command knows what it may replace."""

STALE_SECONDS = 600
"""Age from which no process writes a temporary file any more."""

LARGEST_FILE = 2**30
"""Most bytes of a file that is read: more than any run has, and less than a computer's memory."""

LONGEST_REASON = 100
LONGEST_INTEGER = 20
"""Characters of the least number of 64 bits."""


def shipped_folder(package: str, folder_name: str) -> Path:
    """Return a folder of data that comes with Pneuma: as a package, or at the top of the repository."""
    try:
        module = import_module(package)
    except ModuleNotFoundError:
        return Path(__file__).parents[1] / folder_name
    return Path(next(iter(module.__path__)))


def names_in(folder: Path) -> list[str]:
    """Return the names in a folder, sorted; none if there is no folder."""
    try:
        return sorted(os.listdir(folder))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from None


# --- Reading ----------------------------------------------------------------------------------------


@contextmanager
def stored_file(path: Path) -> Iterator[None]:
    """Turn whatever is raised while a stored file is read into a UserError that names the file.

    Stored files may be damaged or come from anybody, so there is no list of the errors that reading them, or
    calculating with their numbers, can raise.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        unreadable_file = getattr(error, "filename", None) or path
        raise UserError(f"{unreadable_file}: cannot be read ({_reason(error)})") from None


def open_regular(path: str, flags: int = os.O_RDONLY) -> int:
    """Open a regular file, as an `opener` of `open`; OSError for a pipe or a device, which may never end."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)  # minus the umask
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is not a regular file", path)
    return descriptor


def open_stored(path: str, flags: int = os.O_RDONLY) -> int:
    """Open a file below a results folder, as an `opener` of `open`; all of them are opened here.

    The folder may be anybody's, so that only a regular file is opened, and no link, which may lead out of it.
    """
    try:
        return open_regular(path, flags | os.O_NOFOLLOW)
    except OSError as error:
        if error.errno == errno.ELOOP and os.path.islink(path):
            raise OSError(errno.ELOOP, "is a link", path) from None
        raise


def read_stored(path: Path, most_bytes: int = LARGEST_FILE) -> bytes:
    """Return a file below a results folder; OSError for what `open_stored` refuses, or if it is too large."""
    return _read(path, open_stored, most_bytes)


def read_regular(path: Path, most_bytes: int = LARGEST_FILE) -> bytes:
    """Return the contents of a user's file, which may be a link."""
    return _read(path, open_regular, most_bytes)


def _read(path: Path, opener: Callable[[str, int], int], most_bytes: int) -> bytes:
    with open(path, "rb", opener=opener) as file:
        file_size = os.fstat(file.fileno()).st_size
        if file_size > most_bytes:
            largest_text = f"is larger than {round(most_bytes / 2**20, 1):,g} MB, the most that is read"
            raise OSError(errno.EINVAL, largest_text, str(path))
        return file.read(file_size)


def _reason(error: Exception) -> str:
    """Return why something cannot be read, in one line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    error_lines = str(error).splitlines() or [""]
    first_line = error_lines[0][:LONGEST_REASON]
    if isinstance(error, ValueError):
        return first_line
    return f"{type(error).__name__}: {first_line}"


def read_text(path: Path, most_bytes: int = LARGEST_FILE) -> str:
    """Return the text of a user's file, with all line ends as one character."""
    try:
        return io.TextIOWrapper(io.BytesIO(read_regular(path, most_bytes)), encoding="utf-8-sig").read()
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:
        raise UserError(f"{path}: is not UTF-8 text; save it as UTF-8") from None


# --- Writing ----------------------------------------------------------------------------------------

_STORAGE_PROBLEMS = (
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ENOMEM,
    errno.EIO, errno.EROFS, errno.ENODEV, errno.ENOTCONN, errno.ESTALE, errno.EHOSTDOWN,
)  # fmt: skip
"""There is no room, or the disk or the folder of a server is broken, read-only or gone."""
_TEMPORARY_NAME = re.compile(r"\..+\.[0-9a-f]{32}")


def write_whole(path: Path, contents: bytes) -> None:
    """Write a file whole or not at all, even if the process is killed meanwhile.

    A link is refused, by an OSError. A pipe, a terminal or the like is written to directly.
    """
    if path.is_symlink():
        raise OSError(errno.ELOOP, "is a link; name the file itself")
    if path.exists() and not path.is_file():
        path.write_bytes(contents)
    else:
        replace_files(path.parent, {path.name: contents})


def create_whole(path: Path, contents: bytes, lock: AbstractContextManager[bool] | None = None) -> None:
    """Write a file that does not exist yet, whole or not at all; leave one that exists as it is.

    FAT, exFAT and many shared folders have no hard links, by which two processes cannot both create it. There
    it is written with the lock, if no other process holds that.
    """
    temporary = _temporary_path(path)
    try:
        with _named_in_errors(path):
            temporary.write_bytes(contents)
            try:
                os.link(temporary, path)
            except FileExistsError:
                pass
            except OSError:
                with lock or nullcontext(True) as is_alone:
                    if is_alone and not os.path.lexists(path):
                        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def replace_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put new files into a folder in this order, each whole or not at all.

    All are on the disk before the first one replaces an existing file.
    """
    temporary_paths = {file_name: _temporary_path(folder / file_name) for file_name in files}
    try:
        for file_name, temporary in temporary_paths.items():
            with _named_in_errors(folder / file_name), open(temporary, "xb") as temporary_file:
                temporary_file.write(files[file_name])
        for file_name, temporary in temporary_paths.items():
            with _named_in_errors(folder / file_name), open(temporary, "rb") as temporary_file:
                os.fsync(temporary_file.fileno())
        for file_name, temporary in temporary_paths.items():
            with _named_in_errors(folder / file_name):
                os.replace(temporary, folder / file_name)
    except BaseException:
        for temporary in temporary_paths.values():
            temporary.unlink(missing_ok=True)
        raise


def _temporary_path(path: Path) -> Path:
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}")


@contextmanager
def _named_in_errors(path: Path) -> Iterator[None]:
    """Let an OSError name a file instead of the temporary one, or of none, as where the disk is full."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def stale_files(folder: Path, least_seconds: float = STALE_SECONDS) -> list[Path]:
    """Return the temporary files of at least an age that were left in a folder when a process was killed."""
    stale_paths = []
    for file_name in names_in(folder):
        if _TEMPORARY_NAME.fullmatch(file_name):
            file_path = folder / file_name
            with suppress(FileNotFoundError):  # its process has just moved it to its place
                age_seconds = time.time() - file_path.stat().st_mtime
                if age_seconds >= least_seconds:
                    stale_paths.append(file_path)
    return stale_paths


def write_error(path: Path, error: OSError) -> UserError:
    """Return the error for a file that cannot be written; a StorageError where no file could be."""
    message = f"{error.filename or path}: cannot be written ({error.strerror or error})"
    if is_storage_problem(error):
        return StorageError(f"{message}; once the disk can be written, the same command continues")
    return UserError(message)


def is_storage_problem(error: BaseException) -> bool:
    """Return whether the disk is to blame: it is full, over a quota, broken, read-only, or gone."""
    if isinstance(error, OSError):
        return error.errno in _STORAGE_PROBLEMS
    return isinstance(error, StorageError)


# --- Documents --------------------------------------------------------------------------------------

_CHECKSUM_LINE = ',\n  "sha256": "'
_END = "\n}\n"


def to_json(document: object) -> bytes:
    return (json.dumps(document, indent=2) + "\n").encode()


def parse_json(json_text: bytes | str) -> dict[str, Any]:
    """Parse a JSON object with finite numbers of at most 64 bits; ValueError for anything else."""
    try:
        document = _DECODER.decode(json_text if isinstance(json_text, str) else json_text.decode())
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    if not isinstance(document, dict):
        raise ValueError("is not a JSON object")
    return document


def _parse_integer(digits: str) -> int:
    if len(digits) > LONGEST_INTEGER or not -(2**63) <= int(digits) < 2**63:
        raise ValueError(f"the number {digits[:LONGEST_INTEGER]} … is too large")
    return int(digits)


def _parse_float(digits: str) -> float:
    if not math.isfinite(float(digits)):
        raise ValueError(f"the number {digits[:LONGEST_INTEGER]} is not finite")
    return float(digits)


# made once: `json.loads` makes one for each document, of which a results folder has thousands
_DECODER = json.JSONDecoder(parse_int=_parse_integer, parse_float=_parse_float, parse_constant=_parse_float)


def checksum(contents: bytes) -> str:
    return hashlib.sha256(contents).hexdigest()


def dump_checksummed(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON, with a schema number and, as its last line, a checksum."""
    document = {"schema": SCHEMA, **document}
    return to_json({**document, "sha256": checksum(to_json(document))})


def load_checksummed(path: Path) -> dict[str, Any] | None:
    """Return what `dump_checksummed` wrote; None if it is missing, damaged or of another schema."""
    try:
        contents = read_stored(path)
        document_start, _, checksum_text = contents.rpartition(_CHECKSUM_LINE.encode())
        without_checksum = document_start + _END.encode()
        if checksum_text.decode() != f'{checksum(without_checksum)}"{_END}':
            return None
        document = parse_json(without_checksum)
    except (OSError, ValueError):
        return None
    return document if document.pop("schema", None) == SCHEMA else None
