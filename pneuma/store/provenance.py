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
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

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
        self._begun = time.perf_counter()
        self._start = start
        self._evaluating = 0.0
        self._first: tuple[float, float, int] | None = None  # both clocks and the step, programs compiled

    def update(self, step: int, evaluation_seconds: float = 0.0) -> None:
        """Note the time of the first update, before which programs are compiled, and that of evaluations."""
        self._evaluating = evaluation_seconds
        self._first = self._first or (time.perf_counter(), time.process_time(), step)

    def so_far(self, step: int) -> dict[str, Any]:
        """Return the record of this attempt up to a step.

        `training_seconds` is the time without start-up: the number of updates times the pace of all updates
        after the first. `processor_share` is the share of a core that these had; None on a GPU.
        """
        now = time.perf_counter()
        training, share = now - self._begun, None
        if self._first and step > self._first[2]:
            clock, processor, first = self._first
            training = (now - clock) * (step - self._start) / (step - first)
            if _device() == "cpu" and now > clock:
                share = round((time.process_time() - processor) / (now - clock), 3)
        return {
            "started": self._started,
            "wall_seconds": round(now - self._begun, 3),
            "training_seconds": round(training, 3),
            "evaluation_seconds": round(self._evaluating, 3),
            "processor_share": share,
            "step": step,
            "machine": machine(),
        }


def finished_provenance(attempts: list[dict[str, Any]]) -> dict[str, Any]:
    """Describe how a run was trained: the machine of the last attempt, and all attempts."""
    shares = [each["processor_share"] for each in attempts]
    known = [share for share in shares if share is not None]
    seconds = sum(each["wall_seconds"] for each in attempts)
    evaluating = sum(each.get("evaluation_seconds", 0.0) for each in attempts)
    return {
        "started": attempts[0]["started"],
        "wall_seconds": round(seconds, 3),
        "training_seconds": round(sum(each["training_seconds"] for each in attempts), 3),
        "evaluation_share": round(evaluating / max(seconds, 1e-9), 3),
        "processor_share": min(known) if len(known) == len(shares) else None,
        **attempts[-1]["machine"],
        "attempts": attempts,
    }


# --- This machine ----------------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """Return everything about this process and machine that may affect a run's last bits."""
    version, _, commit = code().partition(" ")
    return {
        "threads": THREADS,
        "python": platform.python_version(),
        "packages": {
            "pneuma": version,
            **{name: found for name in PACKAGES if (found := _version(name))},
        },
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
        most, period = map(int, QUOTA.read_text().split())
        return min(cores, max(1, math.ceil(most / period)))
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
    commit = _git(SOURCE, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    return " ".join([_version("pneuma-rl") or "unknown", *commit])


def uncommitted(source: Path = SOURCE) -> list[str]:
    """Return files of a tree's code and studies that differ from the commit; none without a commit."""
    return [line[3:] for line in _git(source, "status", "--porcelain", "--", "pneuma", "studies")]


def file_at(path: Path, commit: str, line: str) -> str | None:
    """Return the text of a file with a line as it was at a commit, where it may have had another name.

    None without a checkout that has the commit, or where no such file was there.
    """
    if not re.fullmatch("[0-9a-f]{40}", commit):
        return None
    git: Any = {"text": True, "stderr": subprocess.DEVNULL, "cwd": path.parent}
    with suppress(OSError, subprocess.CalledProcessError):
        words = ["git", "grep", "--full-name", "-lFe", line, commit, "--", f":/*{path.suffix}"]
        names = subprocess.check_output(words, **git).splitlines()
        return subprocess.check_output(["git", "show", names[0]], **git)
    return None


def line_at(path: Path, commit: str, beginning: str, folder: str) -> str:
    """Return the first line with a text in a folder of the checkout of a file, at a commit; may be empty."""
    if not re.fullmatch("[0-9a-f]{40}", commit):
        return ""
    words = ["git", "grep", "-hF", beginning, commit, "--", f":/{folder}"]
    with suppress(OSError, subprocess.CalledProcessError):
        lines = subprocess.check_output(words, text=True, stderr=subprocess.DEVNULL, cwd=path.parent)
        return lines.partition("\n")[0]
    return ""


def project(study: Path, files: Iterable[Path] = ()) -> dict[str, str]:
    """Return a user's study file by its name, and the commit of the repository that it is in, if any.

    The commit is marked as dirty where its files have changed, and where it lacks the study's file or one of
    the files that its runs use.
    """
    about = {"study": study.name}
    folder = study.resolve().parent
    top = _git(folder, "rev-parse", "--show-toplevel", own=False)
    commit = _git(folder, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*", own=False)
    if not (top and commit):
        return about
    used = {path.resolve() for path in (study, *files)}
    within = [str(path) for path in used if path.is_relative_to(top[0])]
    tracked = _git(folder, "ls-files", "--", *within, own=False)
    untracked = len(tracked) < len(within)
    dirty = untracked and not commit[0].endswith("-dirty")
    return {**about, "commit": commit[0] + ("-dirty" if dirty else "")}


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
    distributions = packages_distributions() if packages else {}
    versions = {}
    for package in sorted(packages):
        for name in distributions.get(package, ()):
            versions[name] = version(name)
    return versions


def _git(source: Path, *words: str, own: bool = True) -> list[str]:
    """Return the lines that git prints about a source tree; none without a repository, or without git.

    Pneuma's `own` is a repository as a whole: installed, it may lie in one of somebody else.
    """
    command = ["git", "-C", str(source), *words]
    if not own or (source / ".git").exists():
        with suppress(OSError, subprocess.CalledProcessError):
            return subprocess.check_output(command, text=True, stderr=subprocess.DEVNULL).splitlines()
    return []


@cache
def _cpu() -> str:
    """Return the processor's model name, or its ARM numbers."""
    text = Path("/proc/cpuinfo").read_text().split("\n\n")[0] if sys.platform == "linux" else ""
    lines = dict(re.findall(r"^([^\t:]+)\t*: (.*)$", text, re.MULTILINE))
    arm = [f"{key[4:]} {lines[key]}" for key in ARM if key in lines]
    named = lines.get("model name") or (f"ARM {', '.join(arm)}" if arm else "")
    return named or platform.processor() or "unknown"


# --- Of stored runs --------------------------------------------------------------------------------


def processors(origin: Mapping[str, Any]) -> tuple[str, ...]:
    """Return on what a run was trained; some published rows of older versions list it themselves."""
    listed = origin.get("processors")
    if isinstance(listed, list) and listed:
        return tuple(sorted({str(name) for name in listed}))
    listed = origin.get("attempts")
    attempts = [each for each in listed if isinstance(each, dict)] if isinstance(listed, list) else []
    machines = [origin, *(each["machine"] for each in attempts if isinstance(each.get("machine"), dict))]
    devices = [(each, each.get("device") or "cpu") for each in machines]
    return tuple(sorted({str(each.get("cpu") if device == "cpu" else device) for each, device in devices}))
