"""What is installed here, and does it work: the checks behind `pneuma doctor`.

Every check says what it found and, where that is not well, what to do about it. Whatever is heavy,
or could take this process down with it, is tried in a process of its own.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import cache_from_source, find_spec
from pathlib import Path
from typing import Any

from pneuma.analysis.checksums import is_whole
from pneuma.errors import UserError, install_extra
from pneuma.study import spec
from pneuma.study.executors.local import one_thread_environment
from pneuma.study.provenance import available_cores
from pneuma.study.store import Store, read_whole

GOOD, NOTE, BROKEN = "good", "note", "broken"
PYTHONS = ((3, 11), (3, 14))
"""From the first to before the second."""
LITTLE_BYTES = 2_000_000_000
SECONDS_TO_ANSWER = 300

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

PROGRAMS = {
    "git": "names the commit that trained a run",
    "chromium": "tests the report in a real browser",
}

TRIALS = {
    "torch": (
        "import torch, json; torch.zeros(8, 8).matmul(torch.ones(8, 8)); n = torch.cuda.device_count();"
        "print(json.dumps(f'{torch.__version__}, {torch.get_num_threads()} threads, '"
        "+ (f'{n} GPUs, which the engine sb3 does not use' if n else 'CPU')))"
    ),
    "jax": (
        "import jax, json; jax.jit(lambda x: x + 1)(1.0).block_until_ready();"
        "print(json.dumps(f'{jax.__version__} on ' + ', '.join(str(d) for d in jax.devices())))"
    ),
    "stable_baselines3": "import stable_baselines3, json; print(json.dumps(stable_baselines3.__version__))",
    "the world": (
        "import gymnasium, pneuma, json, time; start = time.perf_counter();"
        "env = gymnasium.make('pneuma/Pneuma-v0'); env.reset(seed=0);"
        "[env.step(env.action_space.sample()) for _ in range(50)];"
        "print(json.dumps(f'50 steps, {time.perf_counter() - start:.1f} s with what had to be compiled'))"
    ),
    "tables and figures": (
        "import pandas, pyarrow.parquet, matplotlib.figure, safetensors.numpy, json;"
        "print(json.dumps(f'pandas {pandas.__version__}, matplotlib {matplotlib.__version__}'))"
    ),
}
"""Small programs that only run where a part works; each prints what it found, as JSON."""


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
    yield _python()
    yield _cores()
    yield from _packages()
    yield _pins()
    yield _studies()
    yield _kernel_cache()
    yield _jax_cache()
    for name, program in TRIALS.items():
        yield _trial(name, program)
    yield from _results(results)
    yield from map(_extra, EXTRAS)
    yield from map(_program, PROGRAMS)


# --- Python and packages ---------------------------------------------------------------------------


def _python() -> Finding:
    told = f"{platform.python_version()}, {platform.system()} {platform.machine()}"
    if PYTHONS[0] <= sys.version_info[:2] < PYTHONS[1]:
        return Finding("python", GOOD, told)
    return Finding("python", BROKEN, told, "use Python 3.11 to 3.13")


def _cores() -> Finding:
    cores = available_cores()
    return Finding("cores", GOOD, f"{cores}: `study run` trains as many runs at once, on one thread each")


def _packages() -> list[Finding]:
    """Return one finding for all packages that are as needed, and one for each that is not."""
    needed = [text.partition(";")[0].strip() for text in _requirements() if "extra ==" not in text]
    if not needed:
        told = "Pneuma runs from its folder and is not installed: versions are not compared"
        return [Finding("packages", NOTE, told, "pip install --constraint constraints.txt --editable .")]
    found = [(text, _installed(_name_of(text))) for text in needed]
    wrong = [(text, has) for text, has in found if has is None or not satisfies(has, text)]
    findings = [
        Finding(
            "packages",
            BROKEN,
            f"{_name_of(text)}: {'not installed' if has is None else has}, needed is {text}",
            f"pip install '{text}'",
        )
        for text, has in wrong
    ]
    if not findings:
        findings = [Finding("packages", GOOD, f"all {len(needed)} that Pneuma needs, in versions it knows")]
    return findings


def _requirements() -> list[str]:
    try:
        return requires("pneuma") or []
    except PackageNotFoundError:  # run from a source tree, by `python cli.py`
        return []


def satisfies(installed: str, requirement: str) -> bool:
    """Tell whether a version lies in the bounds of a requirement, as numpy>=2.1,<3.

    Knows the two signs that Pneuma's own requirements use; what follows a version's numbers is left out.
    """
    for sign, bound in re.findall(r"(>=|<)\s*([\d.]+)", requirement):
        below = _numbers(installed) < _numbers(bound)
        if below != (sign == "<"):
            return False
    return True


def _numbers(text: str) -> tuple[int, ...]:
    match = re.match(r"\d+(\.\d+)*", text)
    numbers = [int(part) for part in match[0].split(".")] if match else []
    return (*numbers, *[0] * (6 - len(numbers)))


def _name_of(requirement: str) -> str:
    match = re.match(r"[\w.-]+", requirement)
    return match[0] if match else requirement


def _installed(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _pins() -> Finding:
    """Compare what is installed with the versions that the tests ran with, where these are at hand."""
    path = Path(__file__).parents[1] / "constraints.txt"
    if not path.is_file():
        return Finding("pins", GOOD, "no constraints.txt here: installed apart from the source tree")
    lines = [line.split("#")[0].strip().partition("==") for line in path.read_text().splitlines()]
    pins = {name: pinned for name, sign, pinned in lines if sign}
    other = [
        f"{name} {has} (not {pinned})"
        for name, pinned in pins.items()
        if (has := _installed(name)) and has.partition("+")[0] != pinned
    ]
    if not other:
        return Finding("pins", GOOD, "every package as in constraints.txt")
    few = ", ".join(other[:5]) + (f" and {len(other) - 5} more" if len(other) > 5 else "")
    mend = "others may change last bits; pip install -c constraints.txt . brings what the tests ran with"
    return Finding("pins", NOTE, few, mend)


def _studies() -> Finding:
    try:
        names = spec.list_studies()
        for name in names:
            spec.load_study(name)
    except UserError as error:
        return Finding("studies", BROKEN, str(error), "install Pneuma again: its own files were changed")
    if not names:
        return Finding("studies", BROKEN, "none shipped", "install Pneuma again: its study files are missing")
    return Finding("studies", GOOD, f"{len(names)} shipped: {', '.join(names)}")


# --- What is compiled, and kept --------------------------------------------------------------------


def _kernel_cache() -> Finding:
    """Look for numba's compiled kernels: where the environment says, beside the code, or the user's own."""
    own = os.environ.get("NUMBA_CACHE_DIR")
    beside = Path(cache_from_source(str(Path(__file__).parent / "env" / "rules.py"))).parent
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
    folder = Path(own) if own else beside if can_write(beside) else users
    warm = any(folder.rglob("rules.*.nbi")) if folder.is_dir() else False
    return _cache("compiled world", folder, warm, "the first step compiles for some seconds")


def _jax_cache() -> Finding:
    folder = Path(one_thread_environment()["JAX_COMPILATION_CACHE_DIR"])
    warm = folder.is_dir() and any(folder.iterdir())
    return _cache("compiled engine", folder, warm, "the first study compiles for half a minute or so")


def _cache(what: str, folder: Path, warm: bool, cold: str) -> Finding:
    told = f"{folder}: " + ("warm" if warm else f"empty, so {cold}")
    if not can_write(folder):
        mend = "make it writable, or set NUMBA_CACHE_DIR and XDG_CACHE_HOME; else every start compiles"
        return Finding(what, NOTE, f"{told}; cannot be written", mend)
    return Finding(what, GOOD, told)


def can_write(folder: Path) -> bool:
    """Tell whether a folder can be written, or made, without doing either."""
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


# --- What is heavy ---------------------------------------------------------------------------------


def _trial(name: str, program: str) -> Finding:
    """Run a small program in a process of its own; a crash there is a finding."""
    mend = "pip install -c constraints.txt --force-reinstall . in a fresh environment"
    environment = {**os.environ, "PYTHONPATH": one_thread_environment()["PYTHONPATH"]}
    try:
        done = subprocess.run(
            [sys.executable, "-c", program],
            capture_output=True,
            text=True,
            timeout=SECONDS_TO_ANSWER,
            env=environment,
        )
    except subprocess.TimeoutExpired:
        return Finding(name, BROKEN, f"no answer within {SECONDS_TO_ANSWER} s", mend)
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"])[-1]
        return Finding(name, BROKEN, last, mend)
    return Finding(name, GOOD, str(json.loads(done.stdout.splitlines()[-1])))


# --- Results ---------------------------------------------------------------------------------------


def _results(folder: Path) -> list[Finding]:
    """Look whether runs can be kept in the results folder, and whether those that are there are sound."""
    if not can_write(folder):
        return [Finding("results", BROKEN, f"{folder}: cannot be written", "name another with --results")]
    there = folder
    while not there.exists():
        there = there.parent
    free = shutil.disk_usage(there).free
    state, mend = (GOOD, "") if free >= LITTLE_BYTES else (NOTE, "free some space: `study plan` foretells it")
    known = "" if folder.is_dir() else "not made yet, "
    return [
        Finding("results", state, f"{folder}: {known}{free / 1e9:.1f} GB free", mend),
        *_runs(folder),
        *_tables(folder),
    ]


def _runs(folder: Path) -> list[Finding]:
    store = Store(folder)
    try:
        counted = Counter(store.status(run).name for run in store.runs())
    except UserError as error:
        return [Finding("runs", BROKEN, str(error), "name another folder with --results")]
    if not counted:
        return []
    told = ", ".join(f"{count} {status}" for status, count in sorted(counted.items()))
    if counted["damaged"]:
        return [Finding("runs", NOTE, told, "`pneuma study run` trains damaged runs again")]
    return [Finding("runs", GOOD, told)]


def _tables(folder: Path) -> list[Finding]:
    """Look whether published tables are what was written."""
    tables = sorted((folder / "published").rglob("*.parquet"))
    damaged = [path for path in tables if not _is_whole(path)]
    if damaged:
        mend = "take them from version control again, or remove them and publish these studies anew"
        return [Finding("tables", NOTE, f"damaged: {', '.join(map(str, damaged))}", mend)]
    return [Finding("tables", GOOD, f"{len(tables)} published")] if tables else []


def _is_whole(path: Path) -> bool:
    try:
        return is_whole(read_whole(path))
    except OSError:
        return False


# --- Extras ----------------------------------------------------------------------------------------


def _extra(module: str) -> Finding:
    extra, use = EXTRAS[module]
    if find_spec(module) is None:
        return Finding(f"extra {extra}", NOTE, f"not installed; it is for {use}", install_extra(extra))
    return Finding(f"extra {extra}", GOOD, f"for {use}")


def _program(name: str) -> Finding:
    path = shutil.which(name) or (shutil.which(f"{name}-browser") if name == "chromium" else None)
    if path is None:
        return Finding(name, NOTE, f"not found; it {PROGRAMS[name]}", f"install {name}, if you want that")
    return Finding(name, GOOD, f"{path}: {PROGRAMS[name]}")


def as_document(findings: list[Finding]) -> dict[str, Any]:
    """Return the findings as one JSON document."""
    rows = [{"check": f.check, "state": f.state, "told": f.told, "mend": f.mend} for f in findings]
    return {"schema": 1, "ok": all(f.state != BROKEN for f in findings), "checks": rows}
