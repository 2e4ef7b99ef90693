"""Files: written whole or not at all, documents with a checksum, and what reading stored files may raise."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import stat
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.errors import StorageError, UserError

SCHEMA = 1
_CHECKSUM, _END = "sha256", b"\n}\n"

MADE_BY = "made by pneuma"
"""Words in a report and in an exported policy, by which a command knows what it may replace."""
LONGEST_REASON = 100
LONGEST_INTEGER = 20
"""Characters of the least number of 64 bits."""
_STORAGE_PROBLEMS = (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS)
_TEMPORARY = re.compile(r"\..+\.[0-9a-f]{32}")
STALE_SECONDS = 600
"""Age from which no process writes a temporary file any more."""


def shipped_folder(package: str, place: str) -> Path:
    """Return a folder of data that comes with Pneuma: as a package, or at its place in the repository."""
    try:
        return Path(next(iter(import_module(package).__path__)))
    except ModuleNotFoundError:
        return Path(__file__).parents[1] / place


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
        raise UserError(f"{path}: cannot be read ({_reason(error)})") from None


def _reason(error: Exception) -> str:
    """Return why something cannot be read, in one line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    lines = str(error).splitlines() or [""]
    if isinstance(error, ValueError):
        return lines[0][:LONGEST_REASON]
    return f"{type(error).__name__}: {lines[0][:LONGEST_REASON]}"


def read_text(path: Path) -> str:
    """Return the text of a user's file, with all line ends as one character."""
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UserError(f"{path}: cannot be read: {reason}") from None


def read_whole(path: Path, most: int) -> bytes:
    """Return the contents of a search's log of at most so many bytes."""
    with open(path, "rb", opener=open_ordinary) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise OSError(errno.EFBIG, f"is larger than {most / 2**20:.0f} MB", str(path))
        return file.read(size)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, even if the process is killed meanwhile.

    A link is refused, by an OSError. A pipe, a terminal or the like is written to directly.
    """
    if path.is_symlink():
        raise OSError(errno.ELOOP, "is a link; name the file itself")
    if path.exists() and not path.is_file():
        path.write_bytes(data)
        return
    replace_files(path.parent, {path.name: data})


def replace_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Put new files into a folder in this order, each whole or not at all.

    All are on the disk before the first one replaces an existing file.
    """
    written = {name: folder / f".{name}.{uuid.uuid4().hex}" for name in files}
    try:
        for name, path in written.items():
            with _errors_name(folder / name), open(path, "xb") as file:
                file.write(files[name])
        for name, path in written.items():
            with _errors_name(folder / name), open(path, "rb") as file:
                os.fsync(file.fileno())
        for name, path in written.items():
            with _errors_name(folder / name):
                os.replace(path, folder / name)
    except BaseException:
        for path in written.values():
            path.unlink(missing_ok=True)
        raise


@contextmanager
def _errors_name(path: Path) -> Iterator[None]:
    """Let an OSError name a file instead of the temporary one, or of none, as where the disk is full."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def stale_files(folder: Path) -> list[Path]:
    """Return the temporary files of a folder that `replace_files` left behind when it was killed."""
    stale = []
    for name in names_in(folder):
        path = folder / name
        if _TEMPORARY.fullmatch(name):
            with suppress(FileNotFoundError):  # it is in its place now
                if time.time() - path.stat().st_mtime > STALE_SECONDS:
                    stale.append(path)
    return stale


def write_error(path: Path, error: OSError) -> UserError:
    """Return the error for a file that cannot be written; a StorageError where no file could be."""
    text = f"{error.filename or path}: cannot be written ({error.strerror or error})"
    if is_storage_problem(error):
        return StorageError(f"{text}; once the disk can be written, the same command continues")
    return UserError(text)


def is_storage_problem(error: BaseException) -> bool:
    """Return whether the disk is to blame: it is full, over a quota, broken, or read-only."""
    return isinstance(error, StorageError) or (
        isinstance(error, OSError) and error.errno in _STORAGE_PROBLEMS
    )


def create_whole(path: Path, data: bytes) -> None:
    """Write a file that does not exist yet, whole or not at all; leave one that exists as it is."""
    written = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with _errors_name(path):
            written.write_bytes(data)
        with suppress(FileExistsError):
            os.link(written, path)
    finally:
        written.unlink(missing_ok=True)


def parse_json(data: bytes | str) -> dict[str, Any]:
    """Parse a JSON object whose numbers are finite and of at most 64 bits, as all that is written here.

    Raises:
        ValueError: for anything else.
    """
    try:
        document = json.loads(
            data, parse_int=_parse_integer, parse_float=_parse_float, parse_constant=_parse_float
        )
    except (RecursionError, MemoryError) as error:
        raise ValueError(str(error)) from None
    if not isinstance(document, dict):
        raise ValueError("is no JSON object")
    return document


def _parse_integer(text: str) -> int:
    if len(text) > LONGEST_INTEGER or not -(2**63) <= int(text) < 2**63:
        raise ValueError(f"the number {text[:LONGEST_INTEGER]} … is too large")
    return int(text)


def _parse_float(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"the number {text[:LONGEST_INTEGER]} is not finite")
    return number


def names_in(folder: Path) -> list[str]:
    """Return the names in a folder, sorted; none if there is no folder."""
    try:
        return sorted(os.listdir(folder))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise UserError(f"{folder}: cannot be read ({error.strerror})") from None


def to_json(value: object) -> bytes:
    return (json.dumps(value, indent=2) + "\n").encode()


def dump_checksummed(document: Mapping[str, Any]) -> bytes:
    """Return a document as JSON, with a schema number and a checksum."""
    whole = {"schema": SCHEMA, **document}
    return to_json({**whole, _CHECKSUM: checksum(to_json(whole))})


def load_checksummed(path: Path) -> dict[str, Any] | None:
    """Return a document that `dump_checksummed` wrote; None if it is missing or damaged."""
    try:
        data = path.read_bytes()
        head, found, tail = data.rpartition(f',\n  "{_CHECKSUM}": "'.encode())
        if not found or tail != f'{checksum(head + _END)}"'.encode() + _END:
            return None
        document = parse_json(head + _END)
    except (OSError, ValueError):
        return None
    return document if document.get("schema") == SCHEMA else None


def checksum(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def open_ordinary(path: str, flags: int) -> int:
    """Open an ordinary file, as an `opener`; what is none, as a pipe, would be waited for."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is no ordinary file", path)
    return descriptor
