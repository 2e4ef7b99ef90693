"""Progress of a study: a bar per condition on a terminal, plain lines elsewhere, and the time left."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from types import TracebackType

from pneuma.config import Run
from pneuma.study.execute import Progress
from pneuma.study.foresight import TimeLeft
from pneuma.study.plan import Plan
from pneuma.study.store import FINISHED

LINE_SECONDS = 10.0
"""How often a plain line is printed."""

LEFT_SECONDS = 1.0
"""How often the time left is judged anew beside bars, which move with every update of any run."""


def duration(seconds: float) -> str:
    """Return a length of time for people: 45 s, 12 min, 3 h 20 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02} min"


class ProgressDisplay:
    """Shows on standard error how far a plan's runs are; use as a context manager.

    Args:
        plan: what is executed.
        to_train: the runs that are missing, by id.
        workers: how many train at once.
        quiet: whether to show nothing but notes.
        kept: the steps from which runs go on, where that is not 0.
    """

    def __init__(
        self,
        plan: Plan,
        to_train: Mapping[str, Run],
        workers: int,
        quiet: bool,
        kept: Mapping[str, int] | None = None,
    ) -> None:
        self._cells = [cell for cell in plan.cells if cell.run_id in to_train]
        self._steps = {cell.run_id: (kept or {}).get(cell.run_id, 0) for cell in self._cells}
        self._total = sum(run.steps for run in to_train.values())
        self._ended: dict[str, str] = {}
        self._left = TimeLeft(to_train, workers, kept)
        self._show = bool(self._cells) and not quiet
        self._live = self._show and sys.stderr.isatty()
        self._next_line = time.monotonic() + LINE_SECONDS
        self._next_left, self._told_left = 0.0, ""

    def __enter__(self) -> ProgressDisplay:
        """Start showing."""
        if self._live:
            self._start_bars()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the last state on the screen."""
        if self._live:
            with suppress(OSError):  # the terminal was closed
                self._bars.stop()

    def update(self, progress: Progress) -> None:
        """Take one event of `execute`."""
        name = progress.cell.run_id
        self._left.update(progress)
        if progress.note and not progress.status:
            if self._show or not progress.passing:
                self._print_note(progress)
            return
        if progress.status and progress.status != "stopped":
            self._ended[name] = progress.status
        over = progress.status in FINISHED
        self._steps[name] = progress.cell.run.steps if over else max(self._steps[name], progress.step)
        if self._live:
            self._move_bar(progress.cell.condition, ended=bool(progress.status))
        elif self._show:
            self._print_line(progress)

    def _start_bars(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[runs]}"),
            MofNCompleteColumn(),
            TextColumn("{task.fields[left]}"),
            console=Console(stderr=True),
        )
        self._tasks = {}
        self._runs_of: dict[str, list[str]] = {}
        totals: Counter[str] = Counter()
        for cell in self._cells:
            self._runs_of.setdefault(cell.condition, []).append(cell.run_id)
            totals[cell.condition] += cell.run.steps
        for condition, runs in self._runs_of.items():
            told = f"0/{len(runs)} runs"
            self._tasks[condition] = self._bars.add_task(
                condition, total=totals[condition], runs=told, left="steps"
            )
        self._whole = self._bars.add_task("all", total=self._total, runs="", left="steps")
        self._bars.start()

    def _move_bar(self, condition: str, ended: bool) -> None:
        runs = self._runs_of[condition]
        over = sum(name in self._ended for name in runs)
        done = sum(self._steps[name] for name in runs)
        self._bars.update(self._tasks[condition], completed=done, runs=f"{over}/{len(runs)} runs")
        if (now := time.monotonic()) >= self._next_left or ended:
            self._next_left, self._told_left = now + LEFT_SECONDS, self._time_left()
        self._bars.update(self._whole, completed=sum(self._steps.values()), left=f"steps{self._told_left}")

    def _time_left(self) -> str:
        seconds = self._left.seconds()
        return f", {duration(seconds)} left" if seconds else ""

    def _print_note(self, progress: Progress) -> None:
        line = f"{progress.cell.condition} seed {progress.cell.seed}: {progress.note}"
        if self._live:
            with suppress(OSError):  # training goes on when its terminal was closed
                self._bars.console.print(line, highlight=False, markup=False)
        else:
            _tell(line)

    def _print_line(self, progress: Progress) -> None:
        now = time.monotonic()
        if not progress.status and now < self._next_line:
            return
        self._next_line = now + LINE_SECONDS
        share = sum(self._steps.values()) / self._total
        ended = f"{len(self._ended)}/{len(self._steps)} runs ended"
        what = (
            f"{progress.cell.condition} seed {progress.cell.seed}: {progress.status}; "
            if progress.status
            else ""
        )
        _tell(f"{what}{ended}, {share:.0%} of all steps{self._time_left()}")


def _tell(line: str) -> None:
    """Print a line on standard error; if nobody reads that any more, training goes on all the same."""
    with suppress(OSError):
        print(line, file=sys.stderr, flush=True)
