"""The journal of a search: lines of JSON as Optuna's own backend writes them, which Optuna's tools open.

An entry of several lines, such as a trial's suggestion, is there whole or not at all: all its lines but the
last have `more`. So a search that was killed, or that several processes run, goes on from whole entries.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from optuna.storages.journal import BaseJournalBackend, JournalFileSymlinkLock
from optuna.storages.journal._file import get_lock_file

from pneuma.errors import UserError
from pneuma.files import open_ordinary, parse_json, read_whole

LARGEST_LOG = 2**28
"""Most bytes of a log that is read."""


class Journal(BaseJournalBackend):
    """A file of entries, locked for others' writing as Optuna's programs lock it. It may be untrusted."""

    def __init__(self, path: Path) -> None:
        self.path, self._lock = path, JournalFileSymlinkLock(str(path))
        self._logs: list[dict[str, Any]] = []
        self._size, self._held = 0, list[str]()
        self._together = False

    def read_logs(self, log_number_from: int) -> Iterator[dict[str, Any]]:
        if not self._together:
            self._read()
        return iter([*self._logs, *map(json.loads, self._held)][log_number_from:])

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        self._held += [json.dumps(log, separators=(",", ":")) for log in logs]
        if not self._together:
            with self.together():
                pass

    @contextmanager
    def together(self) -> Iterator[None]:
        """Write what is appended meanwhile as one entry, after what others have written before.

        An entry that a killed process has not finished is cut off.
        """
        try:
            with get_lock_file(self._lock):
                self._read()
                if self.path.exists() and self.path.stat().st_size > self._size:
                    os.truncate(self.path, self._size)
                self._together = True
                yield
                self._write()
        except OSError as error:
            raise UserError(f"{self.path}: cannot be written ({error.strerror})") from None
        finally:
            self._together, self._held = False, []

    def _read(self) -> None:
        """Read the whole entries that were written since."""
        if not self.path.exists() or self.path.stat().st_size <= self._size:
            return
        data, entry = read_whole(self.path, LARGEST_LOG)[self._size :], list[dict[str, Any]]()
        if not self._size and not data.startswith(b'{"op_code"'):
            raise ValueError("is no journal")
        place = self._size
        for line in data[: data.rfind(b"\n") + 1].splitlines(keepends=True):
            entry.append(parse_json(line))
            place += len(line)
            if not entry[-1].get("more"):
                self._logs += entry
                self._size, entry = place, []

    def _write(self) -> None:
        lines = self._held
        if not lines:
            return
        more = [f'{line[:-1]},"more":true}}\n' for line in lines[:-1]]
        entry = "".join([*more, lines[-1] + "\n"]).encode()
        with open(self.path, "ab", opener=open_ordinary) as file:
            file.write(entry)
            file.flush()
            os.fsync(file.fileno())
        self._logs += map(json.loads, lines)
        self._size += len(entry)
