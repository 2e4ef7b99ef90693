"""How long somebody waits before the first step, each time in a process of its own."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile

IMPORT = """
from time import perf_counter
start = perf_counter()
import pneuma
print(perf_counter() - start)
"""

FIRST_STEP = """
import gymnasium, pneuma
from time import perf_counter
start = perf_counter()
env = gymnasium.make("pneuma/Pneuma-v0")
env.reset(seed=0)
env.step(0)
print(perf_counter() - start)
"""


def start_seconds(rounds: int = 3) -> dict[str, float]:
    """Return seconds until things are there: the import alone, then a made environment's first step.

    `cold` is with an empty compile cache, once; the others are medians of some rounds, `warm` with the
    cache that `cold` has filled.
    """
    with tempfile.TemporaryDirectory() as cache:
        cold = _seconds(FIRST_STEP, cache)
        warm = statistics.median(_seconds(FIRST_STEP, cache) for _ in range(rounds))
    imported = statistics.median(_seconds(IMPORT) for _ in range(rounds))
    return {
        "import_seconds": imported,
        "first_step_cold_seconds": cold,
        "first_step_warm_seconds": warm,
    }


def _seconds(code: str, cache: str | None = None) -> float:
    """Run code in another process, with a compile cache of its own if one is named, and read its number."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    if cache is not None:
        environment["NUMBA_CACHE_DIR"] = cache
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)
