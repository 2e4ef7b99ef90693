"""Ctrl-C counted instead of thrown, so that what is being written gets written."""

from __future__ import annotations

import os
import signal
import threading
from contextlib import suppress
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupts:
    """Counts interrupts within a `with` block; outside the main thread there are none to count.

    Attributes:
        count: how many came.
        wakeup: a file descriptor that can be read from once one has come, for a selector.
    """

    def __init__(self) -> None:
        self.count = 0
        self.wakeup, self._other_end = os.pipe()
        os.set_blocking(self._other_end, False)
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupts:
        """Begin to count."""
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._note) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        """Give the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        os.close(self.wakeup)
        os.close(self._other_end)

    def wake(self) -> None:
        """Take note of what made `wakeup` readable."""
        os.read(self.wakeup, 4096)

    def interrupt(self) -> None:
        """Count one more, which no signal told."""
        self.count += 1
        os.write(self._other_end, b"!")

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.count == 0:
            with suppress(OSError):
                os.write(
                    2, b"Stopping: every run comes to a checkpoint first. Again, and all stop at once.\n"
                )
        self.interrupt()
