"""Provenance: the packages, machine, code and time that produced a run."""

from __future__ import annotations

import math
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

from pydantic import FiniteFloat
from typing_extensions import TypedDict

from pneuma.config import CPU, Run, as_fields
from pneuma.study.identity import own_names

PACKAGES = (
    "torch", "stable-baselines3", "sb3-contrib", "gymnasium", "numpy", "numba", "llvmlite", "pyarrow",
)  # fmt: skip
SIMULATORS = ("Box2D", "mujoco", "ale_py")
"""Modules in which Gymnasium's environments are simulated."""
CARRIED_CODE = "PNEUMA_CODE"
"""Environment variable with the version and commit of code that was sent to another machine."""
SOURCE = Path(__file__).parents[2]
"""The folder of this code, from which child processes import it even if it is not installed."""
VECTOR_FEATURES = ("+avx", "+avx2", "+avx512f", "+fma", "+neon", "+sve")
"""LLVM's names of a processor's widths of vectors, and of fused operations."""
QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Linux's (cgroups v2) limit of a container's CPU time per period: '150000 100000' or 'max 100000'."""
THREADS = 1


class AttemptRecord(TypedDict):
    """The record of an attempt, as checkpoints and provenance have it."""

    started: str
    wall_seconds: FiniteFloat
    training_seconds: FiniteFloat
    evaluation_seconds: FiniteFloat
    step: int
    machine: dict[str, Any]


class Attempt:
    """One attempt to train a run on a device, timed, from step `start_step`: 0 or that of a checkpoint."""

    def __init__(self, start_step: int = 0, device: str = CPU) -> None:
        self._device = device
        self._started = datetime.now(UTC).isoformat(timespec="seconds")
        self._start_clock = time.perf_counter()
        self._start = start_step
        self._evaluation_seconds = 0.0
        self._first_update: tuple[int, float] | None = None

    def update(self, step: int, evaluation_seconds: float = 0.0) -> None:
        """Note the time of the first update, before which programs are compiled, and that of evaluations."""
        self._evaluation_seconds = evaluation_seconds
        if self._first_update is None:
            self._first_update = step, time.perf_counter()

    def so_far(self, step: int) -> dict[str, Any]:
        """Return the record of this attempt up to a step.

        `training_seconds` is the time without start-up: the number of updates times the pace of all updates
        after the first.
        """
        clock = time.perf_counter()
        training_seconds = wall_seconds = clock - self._start_clock
        first_step, first_clock = self._first_update or (step, clock)
        if step > first_step:
            training_seconds = (clock - first_clock) * (step - self._start) / (step - first_step)
        return {
            "started": self._started,
            "wall_seconds": round(wall_seconds, 3),
            "training_seconds": round(training_seconds, 3),
            "evaluation_seconds": round(self._evaluation_seconds, 3),
            "step": step,
            "machine": machine(self._device),
        }


def finished_provenance(attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe how a run was trained: the machine of the last attempt, and all attempts."""
    total_seconds = {}
    for time_name in ("wall_seconds", "training_seconds", "evaluation_seconds"):
        total_seconds[time_name] = round(sum(attempt[time_name] for attempt in attempts), 3)
    evaluation_share = total_seconds.pop("evaluation_seconds") / max(total_seconds["wall_seconds"], 1e-9)
    return {
        "started": attempts[0]["started"],
        **total_seconds,
        "evaluation_share": round(evaluation_share, 3),
        **attempts[-1]["machine"],
        "attempts": attempts,
    }


# --- This machine ----------------------------------------------------------------------------------


def machine(device: str = CPU) -> dict[str, Any]:
    """Return everything about this process and machine that may affect the last bits of a run on a device."""
    version, _, commit = code().partition(" ")
    packages = {"pneuma": version}
    for package in PACKAGES:
        if _version(package):
            packages[package] = _version(package)
    return {
        "threads": THREADS,
        "python": platform.python_version(),
        "packages": packages,
        "commit": commit or None,
        "system": f"{platform.system()} {platform.machine()}",
        "cpu": _cpu(),
        "target": _target(),
        "cores": os.cpu_count(),
        "device": _device_name(device),
    }


def _device_name(device: str) -> str:
    """Return a device, with the name of its processor if it is not the CPU: cuda: NVIDIA H200."""
    if device == CPU:
        return device
    import torch  # which loads slowly

    return f"{device}: {torch.cuda.get_device_name()}"


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


def _target() -> str | None:
    """Return the processor for which numba compiles in this process, as LLVM calls it, with its vectors.

    None where numba was not loaded.
    """
    registry, config = sys.modules.get("numba.core.registry"), sys.modules.get("numba.core.config")
    if registry is None or config is None:
        return None
    # what numba's cache on disk distinguishes machine code by
    _, cpu_name, features = registry.cpu_target.target_context.codegen().magic_tuple()
    chosen_by = []
    if config.CPU_NAME is not None:
        chosen_by.append("NUMBA_CPU_NAME")
    if config.CPU_FEATURES is not None:
        chosen_by.append("NUMBA_CPU_FEATURES")
    else:
        vector_features = [feature for feature in features.split(",") if feature in VECTOR_FEATURES]
        features = ",".join(vector_features)
    target = f"{cpu_name} {features}".rstrip()
    return f"{target} (set by {' and '.join(chosen_by)})" if chosen_by else target


@cache
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


@cache
def code() -> str:
    """Return the code's version, and for a source tree its git commit, marked if it has changes."""
    if CARRIED_CODE in os.environ:
        return os.environ[CARRIED_CODE]
    code_version = _version("pneuma-rl") or "unknown"
    if _is_repository(SOURCE):
        code_version += f" {_commit(SOURCE)}"
    return code_version.rstrip()


def uncommitted(source: Path = SOURCE) -> list[str]:
    """Return files of a tree's code and studies that differ from the commit; none without a commit."""
    if not _is_repository(source):
        return []
    status_lines = _git(source, "status", "--porcelain", "--", "pneuma", "studies").splitlines()
    return [status_line[3:] for status_line in status_lines]


@cache
def file_at(file_path: Path, commit: str, searched_line: str) -> str | None:
    """Return a file as it was at a commit, when it may have had another name; a line of it finds it.

    None without a checkout that has the commit, or if no file had the line.
    """
    file_names = _grep_at(file_path, commit, searched_line, f"*{file_path.suffix}", "--full-name", "-l")
    return _git(file_path.parent, "show", file_names[0]) if file_names else None


def line_at(file_path: Path, commit: str, beginning: str, folder: str) -> str:
    """Return the first line with a text in a folder of the checkout of a file, at a commit; may be empty."""
    return "".join(_grep_at(file_path, commit, beginning, folder, "-h")[:1])


def _grep_at(path: Path, commit: str, text: str, file_pattern: str, *options: str) -> list[str]:
    """Return what `git grep` finds in files of the checkout of a file, at a commit."""
    if not re.fullmatch("[0-9a-f]{40}", commit):
        return []
    return _git(path.parent, "grep", *options, "-Fe", text, commit, "--", f":/{file_pattern}").splitlines()


def project(study_file: Path, own_files: Iterable[Path] = ()) -> dict[str, str]:
    """Return a user's study file by its name, and the commit of the repository that it is in, if any.

    The commit is marked as dirty where its files have changed, and where it lacks the study's file or one of
    the files that its runs use.
    """
    folder = study_file.resolve().parent
    commit = _commit(folder)
    if not commit:
        return {"study": study_file.name}
    for file_path in (study_file, *own_files):
        if _git(folder, "status", "--porcelain", "--ignored", "--", str(file_path.resolve())):
            commit = commit.removesuffix("-dirty") + "-dirty"
    return {"study": study_file.name, "commit": commit}


def packages_of(run: Run) -> dict[str, str]:
    """Return the versions of the packages that contain a run's environment and the user's modules."""
    from gymnasium.envs.registration import registry  # workers have it, commands need not

    modules = [name for name in SIMULATORS if name in sys.modules]
    for user_modules in own_names(as_fields(run)).values():
        modules += user_modules
    if run.env in registry:
        entry_point = registry[run.env].entry_point
        modules.append(str(getattr(entry_point, "__module__", entry_point)))
    packages = {re.split(r"[.:]", module)[0] for module in modules} - {"gymnasium", "pneuma"}
    versions: dict[str, str] = {}
    if packages:
        distributions = packages_distributions()  # takes long
        for package in sorted(packages):
            for name in distributions.get(package, ()):
                versions[name] = version(name)
    return versions


def _is_repository(source: Path) -> bool:
    """Return whether a folder is the root of a repository; an installed package may be inside another one."""
    return (source / ".git").exists()


def _commit(folder: Path) -> str:
    """Return the commit of the repository that a folder is in, marked if files changed; "" without one."""
    return _git(folder, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*").strip()


def _git(folder: Path, *git_words: str) -> str:
    """Return what git prints in a folder; nothing where it fails, or is not installed."""
    command = ["git", "-C", str(folder), *git_words]
    try:
        return subprocess.check_output(command, text=True, stderr=subprocess.DEVNULL)
    except (OSError, subprocess.CalledProcessError):
        return ""


@cache
def _cpu() -> str:
    """Return the processor's model name; ARM processors have numbers instead."""
    model_names = []
    if sys.platform == "linux":
        first_core = Path("/proc/cpuinfo").read_text().split("\n\n")[0]
        model_names = re.findall(r"^(?:model name|CPU \w+)\t*: (.*)$", first_core, re.MULTILINE)
    return ", ".join(model_names) or platform.processor() or "unknown"
