"""A game ends with whoever started it, and so does what it started, however that one ends."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

WAITS = """
import signal, sys
from pneuma.godot.game import GodotGame
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # which `nohup` and the shell's & have the tests ignore
signal.signal(signal.SIGINT, signal.default_int_handler)
GodotGame(sys.argv[1])
"""
GAME = """#!/bin/sh
setsid sleep 600 &
echo $$ $! > {folder}/begun
setsid sh -c 'sleep 600 & echo $! >> {folder}/begun'  # whose parent is gone at once
mv {folder}/begun {folder}/pids
wait
"""


def _lives(pid: str) -> bool:
    status = Path("/proc") / pid / "stat"
    try:
        return status.read_text().rpartition(") ")[2][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):  # it may end while it is looked at
        return False


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("signals", [["SIGTERM"], ["SIGHUP"], ["SIGKILL"], ["SIGINT", "SIGINT"]])
def test_untrusted_a_game_that_never_connects_ends_with_its_study(tmp_path: Path, signals: list[str]) -> None:
    game = tmp_path / "game"
    game.write_text(GAME.format(folder=tmp_path))
    game.chmod(0o755)
    study = subprocess.Popen([sys.executable, "-c", WAITS, game], stderr=subprocess.DEVNULL)
    until = time.monotonic() + 30
    while not (tmp_path / "pids").exists() and time.monotonic() < until:
        time.sleep(0.05)
    pids = (tmp_path / "pids").read_text().split()
    assert len(pids) == 3 and all(map(_lives, pids))
    for name in signals:
        study.send_signal(signal.Signals[name])
    study.wait(10)
    while any(map(_lives, pids)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(_lives, pids))
