"""Environments with a process of their own, as simulators have, of several kinds.

Each writes its helper's process id into the folder in which training was started.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any, cast

import gymnasium
from gymnasium.envs.classic_control import CartPoleEnv
from gymnasium.vector import AsyncVectorEnv


def _note(process_id: int | None) -> None:
    with Path("helpers").open("a") as file:
        file.write(f"{process_id}\n")


class Forked(CartPoleEnv):
    """Has a helper made by `fork`, which ends only if it is closed, and ends or sleeps in its 40th step."""

    def __init__(self, in_step_40: str = "") -> None:
        super().__init__()
        self._in_step_40, self._taken = in_step_40, 0
        self._helper = multiprocessing.get_context("fork").Process(target=time.sleep, args=(600,))
        self._helper.start()
        _note(self._helper.pid)

    def step(self, action: Any) -> Any:
        self._taken += 1
        if self._taken == 40 and self._in_step_40 == "sleep":
            Path("sleeps").touch()
            time.sleep(600)
        if self._taken == 40 and self._in_step_40 == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        step: Any = super().step
        return step(action)

    def close(self) -> None:
        self._helper.terminate()
        self._helper.join()


class Subprocess(CartPoleEnv):
    """Has a program as its helper, and a vector of environments, which it all terminates and waits for."""

    def __init__(self) -> None:
        super().__init__()
        self._helper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        _note(self._helper.pid)
        self._vector = AsyncVectorEnv([CartPoleEnv])

    def close(self) -> None:
        self._helper.terminate()
        self._helper.wait()
        self._vector.close(terminate=True)


class Possessive(CartPoleEnv):
    """Takes the process for its own: goes to another folder, ignores signals, has a thread without an end."""

    def __init__(self) -> None:
        super().__init__()
        os.chdir("/")
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        threading.Thread(target=time.sleep, args=(600,)).start()


for own_class in (Forked, Subprocess, Possessive):
    gymnasium.register(f"{own_class.__name__}-v0", cast(Any, own_class), max_episode_steps=100)
