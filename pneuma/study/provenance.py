"""What produced a run: packages, machine, code and time. Kept beside it, never part of its records.

And which of several runs were trained on something else than most: their last bits may differ.
"""

from __future__ import annotations

import json
import math
import os
import platform
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pneuma.study.store import Store

PACKAGES = (
    "pneuma", "torch", "stable-baselines3", "sb3-contrib", "gymnasium", "numpy", "numba", "jax", "jaxlib",
    "pyarrow",
)  # fmt: skip
CARRIED_CODE = "PNEUMA_CODE"
"""Environment variable of a process whose code was carried to its machine: its version and its commit."""
QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""What a container may spend in a period, as Linux (cgroups v2) tells it: '150000 100000' or 'max 100000'."""


@dataclass(frozen=True)
class Attempt:
    """One go at training a run, from its start or from a checkpoint.

    Attributes:
        started: when.
        clock: `time.perf_counter` then.
        threads: of each worker.
        start: the step that it went on from.
        first: `time.perf_counter`, the step and `time.process_time` after its first update, before which
            programs are loaded and compiled; None until then.
    """

    started: datetime
    clock: float
    threads: int
    start: int = 0
    first: tuple[float, int, float] | None = None

    def updated(self, step: int) -> Attempt:
        """Return the attempt after an update, the first of which is noted."""
        return self if self.first else replace(self, first=(time.perf_counter(), step, time.process_time()))

    @property
    def seconds(self) -> float:
        """How long it has trained since its first update."""
        return time.perf_counter() - self.first[0] if self.first else 0.0

    def so_far(self, step: int | None) -> dict[str, Any]:
        """Return what is recorded of this attempt at a step, None where that stands elsewhere."""
        return {
            "started": self.started.astimezone(UTC).isoformat(timespec="seconds"),
            "wall_seconds": round(time.perf_counter() - self.clock, 3),
            "training_seconds": round(self._training_seconds(step), 3),
            "processor_share": self._processor_share(),
            "step": step,
            "machine": machine(self.threads),
        }

    def _training_seconds(self, step: int | None) -> float:
        """Return the time without start-up: of all updates at the pace that those after the first had."""
        if self.first is None or step is None or step <= self.first[1]:
            return time.perf_counter() - self.clock
        return self.seconds * (step - self.start) / (step - self.first[1])

    def _processor_share(self) -> float | None:
        """Return how much of a core the updates after the first had: less than 1 beside other programs.

        None on a GPU, or where no update was made.
        """
        if self.first is None or _device() != "cpu" or self.seconds <= 0:
            return None
        return round((time.process_time() - self.first[2]) / self.seconds, 3)


def finished_provenance(
    attempt: Attempt, history: Mapping[str, Any], step: int | None = None
) -> dict[str, Any]:
    """Describe what a run was trained by: the machine of the last attempt, and every attempt with its own.

    The last attempt ends now, at a step; `history` has the `attempts` before that left a checkpoint, and as
    `resumes` where the next ones went on.
    """
    attempts = [*history["attempts"], attempt.so_far(step)]
    shares = [each.get("processor_share") for each in attempts]  # of an older version's attempt none
    known = [share for share in shares if share is not None]
    timed = [each.get("training_seconds", each["wall_seconds"]) for each in attempts]
    return {
        "started": attempts[0]["started"],
        "wall_seconds": round(sum(each["wall_seconds"] for each in attempts), 3),
        "training_seconds": round(sum(timed), 3),
        "processor_share": min(known) if len(known) == len(shares) else None,
        **attempts[-1]["machine"],
        "resumes": history["resumes"],
        "attempts": attempts,
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
        "device": _device(),
    }


def differences(earlier: Mapping[str, Any], but: str = "") -> list[str]:
    """Say in what this machine, its packages and its code differ from earlier ones, so that bits may differ.

    A commit is marked where files were changed on top of it (`-dirty`); two such are taken for the same. The
    key `but` is not compared.
    """
    here, told = machine(1), earlier.get("packages")
    pairs = {
        key: (earlier.get(key), here[key])
        for key in ("python", "commit", "system", "cpu", "device")
        if key != but
    }
    before = told if isinstance(told, dict) else {}
    pairs |= {name: (before.get(name), now) for name, now in here["packages"].items()}
    return [f"{key} ({_short(old)}, now {_short(now)})" for key, (old, now) in pairs.items() if old != now]


def _short(told: object) -> str:
    """Return a value for people, a commit by its first digits."""
    return re.sub(r"^([0-9a-f]{7})[0-9a-f]{33}", r"\1", str(told or "none"))


def available_cores() -> int:
    """Return how many cores this process may use: those it is bound to, as far as its container may."""
    if not hasattr(os, "sched_getaffinity"):
        return os.cpu_count() or 1
    cores = len(os.sched_getaffinity(0))
    try:
        most, period = map(int, QUOTA.read_text().split())
        return min(cores, max(1, math.ceil(most / period)))
    except (OSError, ValueError, ZeroDivisionError):  # no container, or one without a limit
        return cores


def _device() -> str:
    """Return what JAX computes on in this process; the processor where it was never loaded."""
    jax = sys.modules.get("jax")
    if jax is None or jax.default_backend() == "cpu":
        return "cpu"
    return f"{jax.default_backend()}: {jax.devices()[0].device_kind}"


@cache
def _packages() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    carried = os.environ.get(CARRIED_CODE, "").split()
    return {**found, "pneuma": carried[0]} if carried else found


def carried_code() -> str:
    """Return what `CARRIED_CODE` is to say of this process's code."""
    return f"{_packages().get('pneuma', 'unknown')} {_commit() or ''}".strip()


@cache
def _commit() -> str | None:
    """Return the git commit of the source tree that this code lies in, marked when it was changed."""
    carried = os.environ.get(CARRIED_CODE, "").split()
    if carried:
        return carried[1] if len(carried) > 1 else None
    source = Path(__file__).parents[2]
    if not (source / ".git").exists():
        return None
    command = ["git", "-C", str(source), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


_ARM = ("CPU implementer", "CPU part", "CPU variant", "CPU revision")


@cache
def _cpu() -> str:
    told = _read_cpu(Path("/proc/cpuinfo").read_text()) if sys.platform == "linux" else ""
    return told or platform.processor() or "unknown"


def _read_cpu(text: str) -> str:
    """Return the model of Linux's first processor, or ARM's numbers; empty where it tells neither."""
    pairs = [line.partition(":")[::2] for line in text.split("\n\n")[0].splitlines()]
    told = {key.strip(): value.strip() for key, value in pairs}
    numbers = [f"{key.removeprefix('CPU ')} {told[key]}" for key in _ARM if key in told]
    return told.get("model name") or (f"ARM {', '.join(numbers)}" if numbers else "")


# --- Of stored runs --------------------------------------------------------------------------------


def stored_origins(store: Store, run_ids: Iterable[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the ids of those runs that have a provenance, each with it; it may be untrusted.

    One at a time: a run that was requeued every hour tells of hundreds of machines.
    """
    for name in run_ids:
        if (told := store.read_document(name, "provenance.json")) and "imported" not in told:
            yield name, told


def unusual_origins(origins: Iterable[tuple[str, Mapping[str, Any]]]) -> dict[str, str]:
    """Say in a word which runs were trained on another kind of processor, or with other packages, than most.

    Of two that are as frequent the one of the run that was begun first counts as the usual.
    """
    rows = sorted(
        (str(own.get("started")), name, processors(own), _packages_of(own)) for name, own in origins
    )
    marks: dict[str, list[str]] = {}
    for word, place in (("other processor", 2), ("other packages", 3)):
        for usual, _ in Counter(row[place] for row in rows).most_common(1):
            for row in rows:
                if row[place] != usual:
                    marks.setdefault(row[1], []).append(word)
    return {name: ", ".join(words) for name, words in marks.items()}


def processors(origin: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the processors of every attempt, each once: told outright, or by its attempts."""
    told = origin.get("processors")
    if isinstance(told, list) and told:
        return tuple(sorted({str(name) for name in told}))
    told = origin.get("attempts")
    attempts = [each for each in told if isinstance(each, dict)] if isinstance(told, list) else []
    machines = [origin, *(each["machine"] for each in attempts if isinstance(each.get("machine"), dict))]
    return tuple(sorted({processor(machine) for machine in machines}))


def other_processors(origin: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return `processors` to be told beside a `cpu` that was not all: a GPU's, or of an attempt elsewhere."""
    found = processors(origin)
    return {} if found == (str(origin.get("cpu")),) else {"processors": list(found)}


def processor(machine: Mapping[str, Any]) -> str:
    """Return the kind of processor, or GPU, that a machine of a provenance computed on."""
    device = machine.get("device") or "cpu"
    return str(machine.get("cpu") if device == "cpu" else device)


def _packages_of(origin: Mapping[str, Any]) -> str:
    return json.dumps([origin.get("python"), origin.get("packages")], sort_keys=True)
