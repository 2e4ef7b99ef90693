"""How a study of thousands of runs is stored, listed, summarised and drawn: time and memory of each command.

The runs are drawn, not trained (`synthetic.py`). Every command is a process of its own, so that its memory
is its own too.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pneuma.errors import UserError

STUDY = "bench-scaling"
COMMANDS: dict[str, tuple[str, ...]] = {
    "study plan": ("study", "plan", "{file}", "--no-calibrate"),
    "study run, all stored": ("study", "run", "{file}", "--quiet"),
    "study status": ("study", "status", STUDY),
    "run list": ("run", "list"),
    "study summary": ("study", "summary", STUDY),
    "study collapse": ("study", "collapse", STUDY),
    "study plot": ("study", "plot", STUDY),
    "study plot, summary": ("study", "plot", STUDY, "--figure", "summary"),
    "study export, evaluations": ("study", "export", STUDY, "--table", "evaluations", "--out", "{out}"),
    "study publish": ("study", "publish", STUDY),
}


def bench_scaling(runs: int, conditions: int, steps: int, folder: Path | None) -> Iterator[dict[str, Any]]:
    """Yield what storing a study, and each command on it, took: seconds, and megabytes at the peak.

    Args:
        runs: how many, over all conditions; at least one of each, and as many of one as of another.
        conditions: how many; the runs of each differ in their seeds.
        steps: that each run says to have trained, of which its records' size follows.
        folder: where the results lie meanwhile; they go at the end.

    Raises:
        UserError: when a command fails, as where there is no room.
    """
    with tempfile.TemporaryDirectory(dir=folder) as own:
        results = Path(own) / "results"
        file = Path(own) / f"{STUDY}.toml"
        file.write_text(study_file(max(1, runs // conditions), conditions, steps), encoding="utf-8")
        row, printed = _measured("store", ["-m", "pneuma.bench.synthetic", str(file), str(results)])
        stored = json.loads(printed)
        yield {**row, **stored, "runs_per_second": stored["runs"] / stored["seconds"]}
        for case, words in COMMANDS.items():
            filled = [word.format(file=file, out=Path(own) / "table.parquet") for word in words]
            row, _ = _measured(case, ["-m", "pneuma", *filled, "--results", str(results)])
            yield row


def study_file(seeds: int, conditions: int, steps: int) -> str:
    """Return a study's file: conditions that differ in their learning rate."""
    head = f'title = "Scaling"\nbase = "table-6-2"\n[presets.quick]\nseeds = {seeds}\nsteps = {steps}\n'
    rates = [f"[conditions.rate-{i}]\nlearning_rate = {1e-5 * (i + 1):.5f}\n" for i in range(conditions)]
    return head + "".join(rates)


def _measured(case: str, words: list[str]) -> tuple[dict[str, Any], str]:
    """Run Python in a process of its own; return seconds and peak memory, and what it printed."""
    begun = time.perf_counter()
    with tempfile.TemporaryFile() as printed, tempfile.TemporaryFile() as said:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        process = subprocess.Popen([sys.executable, *words], stdout=printed, stderr=said, env=environment)
        _, code, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(code)
        seconds = time.perf_counter() - begun
        said.seek(0)
        if process.returncode:
            raise UserError(f"{case} failed: {said.read().decode().strip()[-500:]}")
        printed.seek(0)
        row = {"case": case, "seconds": seconds, "peak_megabytes": usage.ru_maxrss * 1024 / 1e6}
        return row, printed.read().decode()
