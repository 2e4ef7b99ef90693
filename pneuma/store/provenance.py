"""Provenance: the packages, machine, code and time that produced a run. Kept beside its records."""

from __future__ import annotations

import math
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any, NamedTuple

from pneuma.config import Run, as_fields
from pneuma.study.identity import own_names

PACKAGES = (
    "torch", "stable-baselines3", "sb3-contrib", "gymnasium", "numpy", "numba", "jax", "jaxlib", "pyarrow",
)  # fmt: skip
SIMULATORS = ("Box2D", "mujoco", "ale_py")
"""Modules in which Gymnasium's environments are simulated."""
CARRIED_CODE = "PNEUMA_CODE"
"""Environment variable with the version and commit of code that was sent to another machine."""
SOURCE = Path(__file__).parents[2]
"""The folder of this code, from which child processes import it even if it is not installed."""
QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Linux's (cgroups v2) limit of a container's CPU time per period: '150000 100000' or 'max 100000'."""
ARM = ("CPU implementer", "CPU part", "CPU variant", "CPU revision")
THREADS = 1


class Attempt:
    """One attempt to train a run, timed, from step `start`: 0 or that of a checkpoint."""

    def __init__(self, start: int = 0) -> None:
        self._started = datetime.now(UTC).isoformat(timespec="seconds")
        self._start_clock = time.perf_counter()
        self._start = start
        self._evaluation_seconds = 0.0
        self._first_update: _Moment | None = None

    def update(self, step: int, evaluation_seconds: float = 0.0) -> None:
        """Note the time of the first update, before which programs are compiled, and that of evaluations."""
        self._evaluation_seconds = evaluation_seconds
        if self._first_update is None:
            self._first_update = _Moment(step, time.perf_counter(), time.process_time())

    def so_far(self, step: int) -> dict[str, Any]:
        """Return the record of this attempt up to a step.

        `training_seconds` is the time without start-up: the number of updates times the pace of all updates
        after the first. `processor_share` is the share of a core that these had; None on a GPU.
        """
        clock = time.perf_counter()
        wall_seconds = clock - self._start_clock
        training_seconds, processor_share = wall_seconds, None
        first = self._first_update
        if first and step > first.step:
            seconds = clock - first.clock
            training_seconds = seconds * (step - self._start) / (step - first.step)
            if _device() == "cpu" and seconds > 0:
                processor_share = round((time.process_time() - first.processor_clock) / seconds, 3)
        return {
            "started": self._started,
            "wall_seconds": round(wall_seconds, 3),
            "training_seconds": round(training_seconds, 3),
            "evaluation_seconds": round(self._evaluation_seconds, 3),
            "processor_share": processor_share,
            "step": step,
            "machine": machine(),
        }


class _Moment(NamedTuple):
    step: int
    clock: float
    processor_clock: float


def finished_provenance(attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe how a run was trained: the machine of the last attempt, and all attempts."""
    wall_seconds = sum(attempt["wall_seconds"] for attempt in attempts)
    training_seconds = sum(attempt["training_seconds"] for attempt in attempts)
    evaluation_seconds = sum(attempt.get("evaluation_seconds", 0.0) for attempt in attempts)
    shares = [attempt["processor_share"] for attempt in attempts]
    return {
        "started": attempts[0]["started"],
        "wall_seconds": round(wall_seconds, 3),
        "training_seconds": round(training_seconds, 3),
        "evaluation_share": round(evaluation_seconds / max(wall_seconds, 1e-9), 3),
        "processor_share": None if None in shares else min(shares),
        **attempts[-1]["machine"],
        "attempts": attempts,
    }


# --- This machine ----------------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """Return everything about this process and machine that may affect a run's last bits."""
    version, _, commit = code().partition(" ")
    packages = {"pneuma": version}
    for name in PACKAGES:
        if _version(name):
            packages[name] = _version(name)
    return {
        "threads": THREADS,
        "python": platform.python_version(),
        "packages": packages,
        "commit": commit or None,
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "device": _device(),
    }


def available_cores() -> int:
    """Return how many cores this process may use, by its affinity and its container's limit."""
    if not hasattr(os, "sched_getaffinity"):
        return os.cpu_count() or 1
    cores = len(os.sched_getaffinity(0))
    try:
        quota, period = map(int, QUOTA.read_text().split())
        return min(cores, max(1, math.ceil(quota / period)))
    except (OSError, ValueError, ZeroDivisionError):  # no container, or one without a limit
        return cores


def _device() -> str:
    """Return the device that JAX uses in this process; the processor if JAX was not loaded."""
    jax = sys.modules.get("jax")
    if jax is None or jax.default_backend() == "cpu":
        return "cpu"
    return f"{jax.default_backend()}: {jax.devices()[0].device_kind}"


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


@cache
def code() -> str:
    """Return the code's version, and for a source tree its git commit, marked if it has changes."""
    if CARRIED_CODE in os.environ:
        return os.environ[CARRIED_CODE]
    text = _version("pneuma-rl") or "unknown"
    if _is_repository(SOURCE):
        text += f" {_commit(SOURCE)}"
    return text.rstrip()


def uncommitted(source: Path = SOURCE) -> list[str]:
    """Return files of a tree's code and studies that differ from the commit; none without a commit."""
    if not _is_repository(source):
        return []
    lines = _git(source, "status", "--porcelain", "--", "pneuma", "studies").splitlines()
    return [line[3:] for line in lines]


@cache
def file_at(path: Path, commit: str, line: str) -> str | None:
    """Return the text of a file with a line as it was at a commit, where it may have had another name.

    None without a checkout that has the commit, or where no such file was there.
    """
    if not re.fullmatch("[0-9a-f]{40}", commit):
        return None
    names = _git(path.parent, "grep", "--full-name", "-lFe", line, commit, "--", f":/*{path.suffix}")
    if not names:
        return None
    return _git(path.parent, "show", names.splitlines()[0])


def line_at(path: Path, commit: str, beginning: str, folder: str) -> str:
    """Return the first line with a text in a folder of the checkout of a file, at a commit; may be empty."""
    if not re.fullmatch("[0-9a-f]{40}", commit):
        return ""
    lines = _git(path.parent, "grep", "-hF", beginning, commit, "--", f":/{folder}")
    return lines.partition("\n")[0]


def project(study: Path, files: Iterable[Path] = ()) -> dict[str, str]:
    """Return a user's study file by its name, and the commit of the repository that it is in, if any.

    The commit is marked as dirty where its files have changed, and where it lacks the study's file or one of
    the files that its runs use.
    """
    folder = study.resolve().parent
    repository, commit = _git(folder, "rev-parse", "--show-toplevel").strip(), _commit(folder)
    if not (repository and commit):
        return {"study": study.name}
    paths = {path.resolve() for path in (study, *files)}
    paths_within = [str(path) for path in paths if path.is_relative_to(repository)]
    tracked = _git(folder, "ls-files", "--", *paths_within).splitlines()
    if len(tracked) < len(paths_within) and not commit.endswith("-dirty"):
        commit += "-dirty"
    return {"study": study.name, "commit": commit}


def packages_of(run: Run) -> dict[str, str]:
    """Return the versions of the packages that a run's environment and its own modules come from."""
    from gymnasium.envs.registration import registry  # workers have it, commands need not

    modules = [name for names in own_names(as_fields(run)).values() for name in names]
    spec = registry.get(run.env)
    if spec and isinstance(spec.entry_point, str):
        modules.append(spec.entry_point)
    elif spec:
        modules.append(str(getattr(spec.entry_point, "__module__", "")))
    modules += [name for name in SIMULATORS if name in sys.modules]
    packages = {re.split(r"[.:]", module)[0] for module in modules} - {"gymnasium", "pneuma"}
    versions: dict[str, str] = {}
    if not packages:
        return versions
    distributions = packages_distributions()
    for package in sorted(packages):
        for name in distributions.get(package, ()):
            versions[name] = version(name)
    return versions


def _is_repository(source: Path) -> bool:
    """Return whether a source tree is a repository of its own; installed, it may lie in another one."""
    return (source / ".git").exists()


def _commit(folder: Path) -> str:
    """Return the commit of the repository that a folder is in, marked if files changed; "" without one."""
    return _git(folder, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*").strip()


def _git(folder: Path, *words: str) -> str:
    """Return what git prints in a folder; nothing where it fails, or is not installed."""
    command = ["git", "-C", str(folder), *words]
    try:
        return subprocess.check_output(command, text=True, stderr=subprocess.DEVNULL)
    except (OSError, subprocess.CalledProcessError):
        return ""


@cache
def _cpu() -> str:
    """Return the processor's model name, or its ARM numbers."""
    values: dict[str, str] = {}
    if sys.platform == "linux":
        first_core = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
        values = dict(re.findall(r"^([^\t:]+)\t*: (.*)$", first_core, re.MULTILINE))
    if values.get("model name"):
        return values["model name"]
    numbers = [f"{key.removeprefix('CPU ')} {values[key]}" for key in ARM if key in values]
    if numbers:
        return f"ARM {', '.join(numbers)}"
    return platform.processor() or "unknown"


# --- Of stored runs --------------------------------------------------------------------------------


def processors(origin: Mapping[str, Any]) -> tuple[str, ...]:
    """Return on what a run was trained; some published rows of older versions list it themselves."""
    listed = origin.get("processors")
    if isinstance(listed, list) and listed:
        return tuple(sorted({str(name) for name in listed}))
    machines = [origin]
    attempts = origin.get("attempts")
    if isinstance(attempts, list):
        for attempt in attempts:
            if isinstance(attempt, dict) and isinstance(attempt.get("machine"), dict):
                machines.append(attempt["machine"])
    names = set()
    for about in machines:
        name = about.get("device") or "cpu"
        if name == "cpu":
            name = about.get("cpu")
        names.add(str(name))
    return tuple(sorted(names))
