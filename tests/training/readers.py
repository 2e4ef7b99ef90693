"""The storm of readers: two processes train, draw, summarize and delete runs of one study at once.

Only errors that name what is missing are allowed. Afterwards one more command completes the study, with the
bits of one that nobody disturbed. A second study in the same folder, whose runs nobody deletes, has lost
nothing.
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
from functools import partial
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
TASKS = (*COMMANDS, "run", DELETE, DELETE, DELETE_ROW)
NAMES_WHAT_IS_MISSING = re.compile(
    r"has no runs|no finished run|missing or damaged|train some before publishing"
    r"|seed \d (planned|running|damaged): "
)
"""The last: of a run that the other process deleted, and trains again."""


def read_and_delete(folder: Path, seconds: float, seed: int) -> tuple[Counter[str], list[str]]:
    """Do all tasks in one random order after another; return how often each was done, and the faults."""
    os.chdir(folder)
    os.environ.update(worker_environment())
    dice, end_time = random.Random(seed), time.monotonic() + seconds
    tasks_done, faults, tasks = Counter[str](), list[str](), list[str]()
    while tasks_done.total() < len(TASKS) or time.monotonic() < end_time:
        tasks = tasks or dice.sample(TASKS, len(TASKS))
        task = tasks.pop()
        tasks_done[task] += 1
        try:
            if task in COMMANDS:
                faults += _failures(task)
            else:
                _delete(Store("results"), dice, task)
        except Exception:
            faults.append(f"{task}: {traceback.format_exc()}")
    return tasks_done, faults


def _failures(command: str, allowed: re.Pattern[str] = NAMES_WHAT_IS_MISSING) -> list[str]:
    exit_code, printed, errors = call(*COMMANDS[command])
    if exit_code == 0 or (exit_code in (1, 2) and allowed.search(printed + errors)):
        return []
    return [f"{command}: exit {exit_code}: {printed}{errors}"]


def _delete(store: Store, dice: random.Random, task: str) -> None:
    """Delete a finished run of the study, at once, or the row of one."""
    kept = Path("kept-runs").read_text().split()
    run_ids = [
        run_id for run_id in store.runs() if run_id not in kept and store.status(run_id, True).finished
    ]
    if not run_ids:
        return
    folder = store.run_folder(dice.choice(sorted(run_ids)))
    with suppress(FileNotFoundError):  # the other process was quicker
        if task == DELETE_ROW:
            (folder / ROW_FILE).unlink()
        else:
            with tempfile.TemporaryDirectory(dir=".") as trash:
                folder.rename(Path(trash) / folder.name)


def storm_of_readers(seconds: float, processes: int = 2) -> tuple[Counter[str], list[str]]:
    """Let several processes read and delete at once; return how often each task was done, and the faults."""
    with tempfile.TemporaryDirectory() as folder_name, chdir(folder_name):
        folder = Path(folder_name)
        (folder / "mine.toml").write_text(STUDY.format(fields=""))
        (folder / "kept.toml").write_text(STUDY.format(fields="gamma = 0.5"))
        assert call("study", "run", "kept.toml", "--quiet").code == 0
        (folder / "kept-runs").write_text("\n".join(Store("results").runs()))
        assert call(*COMMANDS["run"]).code == 0
        undisturbed = outcome(folder / "results")
        tasks_done, faults = Counter[str](), list[str]()
        with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
            for done, found in pool.map(partial(read_and_delete, folder, seconds), range(processes)):
                tasks_done += done
                faults += found
        for command in ("run", "summary"):
            faults += _failures(command, allowed=re.compile("(?!)"))  # which nothing matches
        files = outcome(folder / "results")
        for name in {*undisturbed, *files}:
            is_lock = name.endswith("/.lock")  # of one who came to a finished run
            if undisturbed.get(name) != files.get(name) and not is_lock:
                faults.append(f"{name} differs")
    return tasks_done, faults
