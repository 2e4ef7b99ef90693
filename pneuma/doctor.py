"""Checks of the installation, for `pneuma doctor`.

Every check says what it found and, where that is not well, what to do about it.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from pneuma.errors import UserError, install_extra
from pneuma.study.executors.local import worker_environment
from pneuma.study.store import Store

GOOD, NOTE, BROKEN = "good", "note", "broken"
PYTHONS = ((3, 11), (3, 14))
"""Supported versions: from the first up to but excluding the second."""
INSTALL = "pip install --constraint constraints.txt --editable . in Pneuma's folder"
EXTRAS = {
    "pygame": ("play", "a window to play and watch in"),
    "imageio_ffmpeg": ("video", "MP4 videos"),
    "onnx": ("onnx", "policies exported as ONNX"),
    "jax_cuda13_plugin": ("cuda", "updates of the engine batched on an NVIDIA GPU"),
    "ray": ("ray", "runs on a cluster (--executor ray)"),
    "tensorboard": ("tensorboard", "importing old logs"),
    "minatar": ("minatar", "the MinAtar games"),
    "minigrid": ("minigrid", "MiniGrid's worlds"),
}
"""By module: the extra that installs it, and its use."""
TRIAL = (
    "import gymnasium, jax, pneuma, torch; torch.ones(8, 8).matmul(torch.ones(8, 8));"
    "jax.jit(lambda x: x + 1)(1.0).block_until_ready();"
    "env = gymnasium.make('pneuma/Pneuma-v0'); env.reset(seed=0); env.step(0);"
    "print('a step of the world, PyTorch, and JAX on', *jax.devices())"
)
"""A program that runs only if all parts work. It has its own process, because a library may crash it."""


@dataclass(frozen=True)
class Finding:
    """The result of a check: good; a note, of what is worth knowing and stops nothing; or broken."""

    check: str
    state: str
    found: str
    fix: str = ""


def examine(results: Path) -> Iterator[Finding]:
    sound = PYTHONS[0] <= sys.version_info[:2] < PYTHONS[1]
    fix = "" if sound else "use Python 3.11 to 3.13"
    yield Finding("python", GOOD if sound else BROKEN, platform.python_version(), fix)
    command, path = [sys.executable, "-P", "-c", TRIAL], worker_environment()["PYTHONPATH"]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": path})
    last = (done.stderr if done.returncode else done.stdout).strip().rpartition("\n")[2]
    if done.returncode:
        yield Finding("a trial", BROKEN, last or f"ended with code {done.returncode}", INSTALL)
    else:
        yield Finding("a trial", GOOD, last)
    yield _results(results)
    for module, (extra, use) in EXTRAS.items():
        if find_spec(module) is None:
            yield Finding(f"extra {extra}", NOTE, f"not installed; it is for {use}", install_extra(extra))
        else:
            yield Finding(f"extra {extra}", GOOD, f"for {use}")


def _results(folder: Path) -> Finding:
    """Check that the results folder can be written and that its runs are sound."""
    nearest = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not (nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK)):
        return Finding("results", BROKEN, f"{folder}: cannot be written", "name another with --results")
    store = Store(folder)
    try:
        counts = Counter(store.status(run).name for run in store.runs())
    except UserError as error:
        return Finding("results", BROKEN, str(error), "name another folder with --results")
    summary = ", ".join(f"{count} {status}" for status, count in sorted(counts.items())) or "no runs yet"
    state, fix = (NOTE, "`pneuma study run` trains damaged runs again") if counts["damaged"] else (GOOD, "")
    return Finding("results", state, f"{folder}: {summary}", fix)
