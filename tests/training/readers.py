"""The storm of readers: two processes train, draw, summarize and delete runs of one study at once.

Only errors that name what is missing are allowed. Afterwards one more command makes the study whole again,
with the bits of one that nobody disturbed, and a second study in the same folder, whose runs nobody deletes,
has lost nothing.
"""

from __future__ import annotations

import os
import random
import re
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import chdir, suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

from pneuma.store.store import ROW_FILE, Store
from pneuma.training.executors.local import worker_environment

from ..cli.calls import call
from .commands import outcome
from .tiny import TINY_RUN

STUDY = f"""\
title = "Read by many"
worlds = ["text"]
{TINY_RUN}{{fields}}
[conditions.slow]
learning_rate = 0.0001
[conditions.fast]
learning_rate = 0.001
[presets.quick]
seeds = 3
steps = 256
"""
COMMANDS = {
    "run": ("study", "run", "mine.toml", "--workers", "1", "--quiet"),
    "plot": ("study", "plot", "mine.toml", "--format", "svg"),
    "summary": ("study", "summary", "mine.toml"),
    "status": ("study", "status", "mine.toml"),
    "list": ("run", "list"),
    "publish": ("study", "publish", "mine.toml"),
    "summary of the other": ("study", "summary", "kept.toml"),
}
DELETE, DELETE_ROW = "delete", "delete row"
DEEDS = (*COMMANDS, "run", DELETE, DELETE, DELETE_ROW)
NAMES_WHAT_IS_MISSING = re.compile(
    r"has no runs|no finished run|missing or damaged|train some before publishing|seed \d (running|damaged): "
)
"""The last: of a run that the other process deleted, and trains again."""


@dataclass
class Reading:
    """What was done, by name, and what was found that should not be."""

    done: Counter[str] = field(default_factory=Counter)
    found: list[str] = field(default_factory=list)


def read_and_delete(folder: Path, seconds: float, seed: int) -> Reading:
    """Do all things in a random order, and again in another, for so long."""
    os.chdir(folder)
    os.environ.update(worker_environment())
    dice, reading, ends = random.Random(seed), Reading(), time.monotonic() + seconds
    deeds = list[str]()
    while reading.done.total() < len(DEEDS) or time.monotonic() < ends:
        deeds = deeds or dice.sample(DEEDS, len(DEEDS))
        deed = deeds.pop()
        reading.done[deed] += 1
        try:
            if deed in COMMANDS:
                code, _, told = call(*COMMANDS[deed])
                missing = code in (1, 2) and NAMES_WHAT_IS_MISSING.search(told)
                reading.found += [] if code == 0 or missing else [f"{deed}: exit {code}: {told}"]
            else:
                _delete(Store("results"), dice, deed)
        except Exception:
            reading.found.append(f"{deed}: {traceback.format_exc()}")
    return reading


def _delete(store: Store, dice: random.Random, deed: str) -> None:
    """Delete a finished run of the study, at once, or the row of one."""
    kept = Path("kept-runs").read_text().split()
    finished = [name for name in store.runs() if name not in kept and store.status(name, quick=True).finished]
    if not finished:
        return
    run = store.run_folder(dice.choice(finished))
    with suppress(FileNotFoundError):  # the other process was quicker
        if deed == DELETE_ROW:
            (run / ROW_FILE).unlink()
        else:
            with tempfile.TemporaryDirectory(dir=".") as away:
                run.rename(Path(away) / run.name)


def storm_of_readers(seconds: float, processes: int = 2) -> Reading:
    """Let several processes read and delete at once; return what all did, and what was found."""
    with tempfile.TemporaryDirectory() as name, chdir(name):
        folder = Path(name)
        (folder / "mine.toml").write_text(STUDY.format(fields=""))
        (folder / "kept.toml").write_text(STUDY.format(fields="gamma = 0.5"))
        reading = Reading(found=_failures(("study", "run", "kept.toml", "--quiet")))
        (folder / "kept-runs").write_text("\n".join(Store("results").runs()))
        reading.found += _failures(COMMANDS["run"])
        undisturbed = outcome(folder / "results")
        with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
            for each in pool.map(
                read_and_delete, [folder] * processes, [seconds] * processes, range(processes)
            ):
                reading.done += each.done
                reading.found += each.found
        reading.found += _failures(COMMANDS["run"]) + _failures(COMMANDS["summary"])
        after = outcome(folder / "results")
        unlike = {file for file in {*undisturbed, *after} if undisturbed.get(file) != after.get(file)}
        unlike -= {file for file in unlike if file.endswith("/.lock")}  # of one who came to a finished run
        reading.found += [f"{file} is not as undisturbed" for file in sorted(unlike)]
    return reading


def _failures(words: tuple[str, ...]) -> list[str]:
    code, _, told = call(*words)
    return [f"{words}: exit {code}: {told}"] if code else []
