"""What produced a run: packages, machine, code and time. Kept beside it, never part of its records."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("pneuma", "torch", "stable-baselines3", "gymnasium", "numpy", "numba", "pyarrow")


@dataclass(frozen=True)
class Attempt:
    """One go at training a run, from its start or from a checkpoint.

    Attributes:
        started: when.
        clock: `time.perf_counter` then.
        threads: of each worker.
    """

    started: datetime
    clock: float
    threads: int

    def so_far(self, step: int) -> dict[str, Any]:
        """Return what a checkpoint at a step is to tell of this attempt."""
        return {
            "started": self.started.astimezone(UTC).isoformat(timespec="seconds"),
            "wall_seconds": round(time.perf_counter() - self.clock, 3),
            "step": step,
            "machine": machine(self.threads),
        }

    @staticmethod
    def now() -> str:
        """Return the time as provenance writes it."""
        return datetime.now(UTC).isoformat(timespec="seconds")


def finished_provenance(attempt: Attempt, history: Mapping[str, Any]) -> dict[str, Any]:
    """Describe what a run was trained by, over all attempts.

    Args:
        attempt: the last one, which ends now.
        history: `attempts` that left a checkpoint, and `resumes` where the next ones went on.
    """
    first = history["attempts"][0]["started"] if history["attempts"] else attempt.so_far(0)["started"]
    before = sum(earlier["wall_seconds"] for earlier in history["attempts"])
    return {
        "started": first,
        "wall_seconds": round(before + time.perf_counter() - attempt.clock, 3),
        **machine(attempt.threads),
        "resumes": history["resumes"],
    }


def machine(threads: int) -> dict[str, Any]:
    """Return all of this process and machine that may decide over a run's last bits."""
    return {
        "threads": threads,
        "python": platform.python_version(),
        "packages": _packages(),
        "commit": _commit(),
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu(),
        "cores": os.cpu_count(),
    }


def differences(earlier: Mapping[str, Any]) -> list[str]:
    """Say in what this machine and its packages differ from earlier ones, so that bits may differ."""
    here = machine(earlier.get("threads", 1))
    changed = [
        f"{key} ({earlier.get(key)}, now {here[key]})"
        for key in ("python", "system", "cpu")
        if earlier.get(key) != here[key]
    ]
    before = earlier.get("packages", {})
    return changed + [
        f"{name} ({before.get(name, 'none')}, now {now})"
        for name, now in here["packages"].items()
        if before.get(name) != now
    ]


@cache
def _packages() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@cache
def _commit() -> str | None:
    """Return the git commit of the source tree that this code lies in, marked when it was changed."""
    source = Path(__file__).parents[2]
    if not (source / ".git").exists():
        return None
    command = ["git", "-C", str(source), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


@cache
def _cpu() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"
