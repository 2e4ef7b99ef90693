"""Ctrl-C counted instead of thrown, so that what is being written gets written."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterable
from contextlib import suppress
from types import FrameType
from typing import Any

HANGUP = getattr(signal, "SIGHUP", None)
"""Of a terminal that was closed; the system and a shell may each send one."""
SIGNALS = tuple(number for number in (signal.SIGINT, signal.SIGTERM, HANGUP) if number)


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
        self._woken_before: int | None = None

    def __enter__(self) -> Interrupts:
        """Begin to count."""
        if threading.current_thread() is threading.main_thread():
            self._take(number for number in SIGNALS if not _is_ignored(number))
        return self

    def __exit__(self, *_: object) -> None:
        """Give the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._woken_before is not None:
            signal.set_wakeup_fd(self._woken_before)
        ends = self.wakeup, self._other_end
        self.wakeup = self._other_end = -1  # who interrupts too late is to write into nothing else
        for end in ends:
            os.close(end)

    def wake(self) -> None:
        """Take note of what made `wakeup` readable."""
        os.read(self.wakeup, 4096)

    def interrupt(self) -> None:
        """Count one more, which no signal told."""
        self.count += 1
        with suppress(OSError):
            os.write(self._other_end, b"!")

    def _take(self, numbers: Iterable[int]) -> None:
        """Have signals noted, at once.

        The kernel may hand a signal to a thread of a mathematical library, which does not interrupt the main
        thread's wait: the interpreter's own wake-up does.
        """
        self._before = {number: signal.signal(number, self._note) for number in numbers}
        self._woken_before = signal.set_wakeup_fd(self._other_end, warn_on_full_buffer=False)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if number == HANGUP and self.count:
            return
        if self.count == 0:
            with suppress(OSError):
                os.write(
                    2, b"Stopping: every run comes to a checkpoint first. Again, and all stop at once.\n"
                )
        self.interrupt()


def _is_ignored(number: int) -> bool:
    """Tell whether a closed terminal is to end nothing, as `nohup` asks."""
    return number == HANGUP and signal.getsignal(number) == signal.SIG_IGN
