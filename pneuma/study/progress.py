"""Progress of a study: a progress bar in a terminal, lines of text elsewhere, and the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from contextlib import suppress

from pneuma.config import Run
from pneuma.errors import plain
from pneuma.study.execute import kept_step
from pneuma.study.executors.base import Event
from pneuma.study.plan import Cell, Plan
from pneuma.study.store import FINISHED, Store

LINE_SECONDS = 10.0
"""Seconds between lines of text."""
PACE_SECONDS = 600.0
"""Seconds of training from which the time left is estimated."""


def duration(seconds: float) -> str:
    """Format a length of time: 45 s, 12 min, 3 h 20 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02} min"


class ProgressDisplay:
    """Shows on standard error how far a plan's runs are. A context manager.

    Args:
        plan: the plan.
        to_train: the runs that are missing, by id.
        store: the store, in which some of them may have begun.
        quiet: whether to show nothing but notes.
    """

    def __init__(self, plan: Plan, to_train: Mapping[str, Run], store: Store, quiet: bool) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._steps = {name: kept_step(run, store.status(name, quick=True)) for name, run in to_train.items()}
        self._ended: set[str] = set()
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("steps"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            speed_estimate_period=PACE_SECONDS,
            get_time=lambda: time.monotonic(),
        )
        steps = sum(run.steps for run in to_train.values())
        self._task = self._bar.add_task(self._runs(), total=steps, completed=sum(self._steps.values()))
        self._show = bool(to_train) and not quiet
        self._live = self._show and sys.stderr.isatty()
        self._next_line = time.monotonic() + LINE_SECONDS

    def __enter__(self) -> ProgressDisplay:
        """Start showing."""
        if self._live:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last state on the screen."""
        if self._live:
            with suppress(OSError):  # the terminal was closed
                self._bar.stop()

    def update(self, cell: Cell, event: Event) -> None:
        """Take one event of `execute`."""
        name, label, status = cell.run_id, f"{cell.condition} seed {cell.seed}", event.get("status", "")
        if event["event"] in ("note", "passing"):
            if self._show or event["event"] == "note":
                _print(f"{label}: {event['text']}")
            return
        if status and status != "stopped":
            self._ended.add(name)
        self._steps[name] = cell.run.steps if status in FINISHED else max(self._steps[name], event["step"])
        self._bar.update(self._task, completed=sum(self._steps.values()), description=self._runs())
        now = time.monotonic()
        if self._show and not self._live and (status or now >= self._next_line):
            self._next_line = now + LINE_SECONDS
            whole = self._bar.tasks[0]
            left = f", {duration(whole.time_remaining)} left" if whole.time_remaining else ""
            what = f"{label}: {status}; " if status else ""
            _print(f"{what}{self._runs()} ended, {whole.percentage:.0f}% of all steps{left}")

    def _runs(self) -> str:
        return f"{len(self._ended)}/{len(self._steps)} runs"


def _print(line: str) -> None:
    """Print a line on standard error, above the bar. Training goes on if nobody can read it."""
    with suppress(OSError):
        print(plain(line), file=sys.stderr, flush=True)
