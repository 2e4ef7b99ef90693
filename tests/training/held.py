"""A reward that lets a test kill a run between two of its steps, however busy the machine is.

Early on a run sleeps, so that a checkpoint is due. At step `LAST` it waits as long as there is a file `hold`
next to this module, which `commands.hold` copies.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

DUE, LAST = (2000, 4000), 10_000
SLEEP = 0.3
steps = 0


def paid(events: np.ndarray, players: np.ndarray, stats: np.ndarray) -> np.ndarray:
    global steps
    steps += 1
    if steps in DUE:
        time.sleep(SLEEP)
    while steps > LAST and Path(__file__).with_name("hold").exists():
        time.sleep(0.02)
    return events["xp_gained"]
