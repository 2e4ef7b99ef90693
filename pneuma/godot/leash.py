"""Runs a game until it ends, or until standard input does: `python leash.py GAME ARGUMENT...`.

Standard input is a pipe that Pneuma holds open and never writes to. When it closes, however Pneuma ended,
everything is killed that the game has started: on Linux also what left its group, session or parent.
"""

import ctypes
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

PR_SET_CHILD_SUBREAPER = 36


def main() -> None:
    if sys.platform == "linux":  # who loses its parent becomes a child of this process
        ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    game = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    threading.Thread(target=_end_with_pneuma, daemon=True).start()
    code = game.wait()
    _kill_children()
    os._exit(code & 255)


def _end_with_pneuma() -> None:
    sys.stdin.buffer.read()
    _kill_children()
    os.killpg(0, signal.SIGKILL)


def _kill_children() -> None:
    while children := [
        int(pid)
        for own in Path("/proc/self/task").glob("*/children")
        for pid in own.read_text(encoding="ascii").split()
    ]:
        for pid in children:
            with suppress(OSError):
                os.kill(pid, signal.SIGKILL)
            with suppress(OSError):
                os.waitpid(pid, 0)


main()
