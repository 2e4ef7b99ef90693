"""How many cores a process may use."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path

QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""What a container may spend in a period, as Linux (cgroups v2) tells it: '150000 100000' or 'max 100000'."""


def available_cores() -> int:
    """Return how many cores this process may use: those that it is bound to, as far as its container may."""
    if hasattr(os, "sched_getaffinity"):
        return min(len(os.sched_getaffinity(0)), _quota())
    return os.cpu_count() or 1


def _quota() -> int:
    """Return a container's share in whole cores, rounded up; endless where it has no limit."""
    try:
        most, period = map(int, QUOTA.read_text().split())
        return max(1, math.ceil(most / period))
    except (OSError, ValueError, ZeroDivisionError):
        return sys.maxsize
