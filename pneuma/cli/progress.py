"""Progress of a study: a bar per condition on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from pneuma.study.execute import Progress
from pneuma.study.plan import Plan

LINE_SECONDS = 10.0
"""How often a plain line is printed."""


class ProgressDisplay:
    """Shows on standard error how far a plan's runs are; use as a context manager."""

    def __init__(self, plan: Plan, to_train: set[str], quiet: bool) -> None:
        self._cells = [cell for cell in plan.cells if cell.run_id in to_train]
        self._steps = dict.fromkeys((cell.run_id for cell in self._cells), 0)
        self._ended: dict[str, str] = {}
        self._show = bool(self._cells) and not quiet
        self._live = self._show and sys.stderr.isatty()
        self._next_line = time.monotonic() + LINE_SECONDS

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
            self._bars.stop()

    def update(self, progress: Progress) -> None:
        """Take one event of `execute`."""
        name = progress.cell.run_id
        if progress.status:
            self._ended[name] = progress.status
        self._steps[name] = progress.cell.run.steps if progress.status else progress.step
        if self._live:
            self._move_bar(progress.cell.condition)
        elif self._show:
            self._print_line(progress)

    def _start_bars(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[runs]} runs"),
            MofNCompleteColumn(),
            TextColumn("steps"),
            TimeRemainingColumn(compact=True),
            console=Console(stderr=True),
        )
        self._tasks = {}
        for condition in dict.fromkeys(cell.condition for cell in self._cells):
            runs = [cell for cell in self._cells if cell.condition == condition]
            total = sum(cell.run.steps for cell in runs)
            self._tasks[condition] = self._bars.add_task(condition, total=total, runs=f"0/{len(runs)}")
        self._bars.start()

    def _move_bar(self, condition: str) -> None:
        runs = [cell.run_id for cell in self._cells if cell.condition == condition]
        ended = sum(name in self._ended for name in runs)
        self._bars.update(
            self._tasks[condition],
            completed=sum(self._steps[name] for name in runs),
            runs=f"{ended}/{len(runs)}",
        )

    def _print_line(self, progress: Progress) -> None:
        now = time.monotonic()
        if not progress.status and now < self._next_line:
            return
        self._next_line = now + LINE_SECONDS
        total = sum(cell.run.steps for cell in {cell.run_id: cell for cell in self._cells}.values())
        share = sum(self._steps.values()) / total
        ended = f"{len(self._ended)}/{len(self._steps)} runs ended"
        what = (
            f"{progress.cell.condition} seed {progress.cell.seed}: {progress.status}; "
            if progress.status
            else ""
        )
        print(f"{what}{ended}, {share:.0%} of all steps", file=sys.stderr, flush=True)
