"""What is installed here, and does it work: the checks behind `pneuma doctor`.

Every check says what it found and, where that is not well, what to do about it. Whatever is heavy,
or could take this process down with it, is tried in a process of its own.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, install_extra
from pneuma.study.executors.local import one_thread_environment
from pneuma.study.provenance import available_cores
from pneuma.study.store import Store

GOOD, NOTE, BROKEN = "good", "note", "broken"
PYTHONS = ((3, 11), (3, 14))
"""From the first to before the second."""
LITTLE_BYTES = 2_000_000_000
SECONDS_TO_ANSWER = 300
REINSTALL = "pip install -c constraints.txt --force-reinstall . in a fresh environment"

EXTRAS = {
    "pygame": ("play", "a window to play and watch in"),
    "imageio_ffmpeg": ("video", "MP4 videos"),
    "onnx": ("onnx", "policies exported as ONNX"),
    "jax_cuda13_plugin": ("cuda", "updates of the engine batched on an NVIDIA GPU"),
    "ray": ("ray", "runs on a cluster (--executor ray)"),
    "submitit": ("slurm", "jobs in a queue (--executor slurm)"),
    "tensorboard": ("tensorboard", "importing old logs"),
}
"""What each extra is for, by the module that it brings."""

TRIALS = {
    "torch": "import torch; torch.ones(8, 8).matmul(torch.ones(8, 8)); print(torch.__version__)",
    "jax": (
        "import jax; jax.jit(lambda x: x + 1)(1.0).block_until_ready();"
        "print(jax.__version__, 'on', *jax.devices())"
    ),
    "the world": (
        "import gymnasium, pneuma, time; start = time.perf_counter();"
        "env = gymnasium.make('pneuma/Pneuma-v0'); env.reset(seed=0);"
        "[env.step(env.action_space.sample()) for _ in range(50)];"
        "print(f'50 steps, {time.perf_counter() - start:.1f} s with what had to be compiled')"
    ),
}
"""Small programs that only run where a part works; each prints what it found."""


@dataclass(frozen=True)
class Finding:
    """What a check found.

    Attributes:
        check: what was looked at.
        state: good; note, for what is worth knowing and stops nothing; or broken.
        told: what was found.
        mend: what to do about it, if anything.
    """

    check: str
    state: str
    told: str
    mend: str = ""


def examine(results: Path) -> Iterator[Finding]:
    """Yield a finding for everything that Pneuma stands on, from what is quick to what takes seconds."""
    told = f"{platform.python_version()}, {platform.machine()}, {available_cores()} cores"
    if PYTHONS[0] <= sys.version_info[:2] < PYTHONS[1]:
        yield Finding("python", GOOD, told)
    else:
        yield Finding("python", BROKEN, told, "use Python 3.11 to 3.13")
    yield _packages()
    for name, program in TRIALS.items():
        yield _trial(name, program)
    yield from _results(results)
    for module, (extra, use) in EXTRAS.items():
        if find_spec(module) is None:
            yield Finding(f"extra {extra}", NOTE, f"not installed; it is for {use}", install_extra(extra))
        else:
            yield Finding(f"extra {extra}", GOOD, f"for {use}")


def _packages() -> Finding:
    """Compare what is installed with what Pneuma needs."""
    try:
        from packaging.requirements import Requirement

        needed = [Requirement(text) for text in requires("pneuma") or ()]
    except (ImportError, PackageNotFoundError):  # run from a source tree, by `python cli.py`
        told = "Pneuma runs from its folder and is not installed: versions are not compared"
        return Finding("packages", NOTE, told, "pip install --constraint constraints.txt --editable .")
    wrong = []
    for need in needed:
        if need.marker is None or need.marker.evaluate({"extra": ""}):
            try:
                has = version(need.name)
            except PackageNotFoundError:
                has = ""
            if not has or not need.specifier.contains(has, prereleases=True):
                wrong.append((need, has or "not installed"))
    if not wrong:
        return Finding("packages", GOOD, "all that Pneuma needs, in versions it knows")
    told = "; ".join(f"{need.name}: {has}, needed is {need.name}{need.specifier}" for need, has in wrong)
    return Finding("packages", BROKEN, told, "pip install --constraint constraints.txt --editable .")


def _trial(name: str, program: str) -> Finding:
    """Run a small program in a process of its own; a crash there is a finding."""
    environment = {**os.environ, "PYTHONPATH": one_thread_environment()["PYTHONPATH"]}
    command = [sys.executable, "-c", program]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=SECONDS_TO_ANSWER, env=environment
        )
    except subprocess.TimeoutExpired:
        return Finding(name, BROKEN, f"no answer within {SECONDS_TO_ANSWER} s", REINSTALL)
    lines = (done.stderr if done.returncode else done.stdout).strip().splitlines()
    last = lines[-1] if lines else f"ended with code {done.returncode}"
    return Finding(name, BROKEN, last, REINSTALL) if done.returncode else Finding(name, GOOD, last)


def _results(folder: Path) -> Iterator[Finding]:
    """Look whether runs can be kept in the results folder, and whether those that are there are sound."""
    there = folder
    while not there.exists() and there != there.parent:
        there = there.parent
    if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        yield Finding("results", BROKEN, f"{folder}: cannot be written", "name another with --results")
        return
    free = shutil.disk_usage(there).free
    told = f"{folder}: {'' if folder.is_dir() else 'not made yet, '}{free / 1e9:.1f} GB free"
    if free < LITTLE_BYTES:
        yield Finding("results", NOTE, told, "free some space: `study plan` says how much runs take")
    else:
        yield Finding("results", GOOD, told)
    store = Store(folder)
    try:
        counts = Counter(store.status(run).name for run in store.runs())
    except UserError as error:
        yield Finding("runs", BROKEN, str(error), "name another folder with --results")
        return
    told = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
    if counts["damaged"]:
        yield Finding("runs", NOTE, told, "`pneuma study run` trains damaged runs again")
    elif counts:
        yield Finding("runs", GOOD, told)


def as_document(findings: list[Finding]) -> dict[str, Any]:
    """Return the findings as one JSON document."""
    ok = all(finding.state != BROKEN for finding in findings)
    return {"schema": 1, "ok": ok, "checks": [asdict(finding) for finding in findings]}
