"""Reading files that may be untrusted, without waiting for pipes and with a limit on their size."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

from pneuma.errors import UserError

LARGEST_BYTES = 512 * 2**20
"""Most bytes of a file that is read whole."""
LARGEST_TEXT = 2**20
"""Most bytes of a TOML file; a study of a thousand conditions has a tenth of it."""


def read_whole(path: Path, most: int = LARGEST_BYTES) -> bytes:
    """Return the contents of a file.

    Raises:
        OSError: when it cannot be read, is no ordinary file, or is larger than `most` bytes.
    """
    try:
        with open(path, "rb", opener=_open_ordinary) as file:
            data = file.read(most + 1) if os.fstat(file.fileno()).st_size <= most else None
    except MemoryError:
        raise OSError(errno.ENOMEM, "does not fit into memory") from None
    if data is None or len(data) > most:
        raise OSError(errno.EFBIG, f"is larger than {most / 2**20:.0f} MB, the most that is read")
    return data


def read_text(path: Path, most: int = LARGEST_TEXT) -> str:
    """Return the text of a user's file, with all line ends as one character.

    Raises:
        UserError: when it cannot be read, is too large, or no text in UTF-8.
    """
    try:
        text = read_whole(path, most).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UserError(f"{path}: cannot be read: {reason}") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _open_ordinary(path: str, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "is no ordinary file")
    return descriptor
