"""What commands share that write where a person says: a file by --out, or a folder."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from tempfile import TemporaryFile

from pneuma.errors import UserError, nearest_name
from pneuma.study.files import write_whole


def check_file(out: Path, endings: Collection[str]) -> None:
    """Refuse a file that cannot be written, or ends otherwise, before any work is done.

    Raises:
        UserError: saying what is wrong with it.
    """
    if out.suffix.lower() not in endings:
        hint = nearest_name(out.suffix, endings) if out.suffix else ""
        raise UserError(f"--out {out}: must end in {' or '.join(endings)}{hint}")
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if not out.parent.is_dir():
        raise UserError(f"--out {out}: there is no folder {out.parent}")
    _try(f"--out {out}", out.parent)


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder that cannot be written, or made, before any work is done; make none yet.

    Raises:
        UserError: saying why it cannot.
    """
    there = next((path for path in (folder, *folder.resolve().parents) if path.exists()), folder)
    _try(f"{option} {folder}", there)


def write_file(out: Path, data: bytes) -> None:
    """Write a file whole or not at all, and its folder if need be.

    Raises:
        UserError: where it cannot be written.
    """
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, data)
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None


def _try(told: str, there: Path) -> None:
    try:
        TemporaryFile(dir=there).close()
    except OSError as error:
        raise UserError(f"{told}: cannot be written ({error.strerror})") from None
