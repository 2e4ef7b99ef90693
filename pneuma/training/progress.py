"""The time of a study: an estimate before it runs, and its progress: a bar in a terminal, lines elsewhere.

The estimate of a run comes from finished runs like it.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

from pneuma.config import FIELDS, Run, as_fields
from pneuma.errors import UserError, print_aside
from pneuma.store.provenance import machine
from pneuma.store.store import FINISHED, Store
from pneuma.study.plan import Cell
from pneuma.training.execute import kept_step
from pneuma.training.executors.base import Event

SAMPLE = 100
START_SECONDS = 4.0
"""Seconds that a worker takes to start with compiled programs."""
PACE_FIELDS = tuple(field_name for field_name, declaration in FIELDS.items() if declaration.paces)
"""Fields that decide how long a step takes. The budget is one, because every run has the same number of
evaluations."""
LINE_SECONDS = 10.0
PACE_SECONDS = 600.0
"""Seconds of recent training from which the time left is estimated."""

Paces = Mapping[str, float]
"""Seconds per agent step of finished runs, by the fields that decide it."""


def duration(seconds: float) -> str:
    """Format a length of time: 45 s, 12 min, 3 h 20 min."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    if minutes < 100:
        return f"{minutes} min"
    return f"{minutes // 60} h {minutes % 60:02} min"


# --- Before it runs --------------------------------------------------------------------------------


def stored_paces(store: Store, names_first: Iterable[str]) -> Paces:
    """Return the paces of finished runs on a processor of this kind: those of a plan, and some others."""
    from pneuma.store.row_builder import stored_row  # safetensors, pyarrow: not for `--help`

    own_cpu = machine()["cpu"]
    paces_by_key: dict[str, list[float]] = {}
    for run_id in dict.fromkeys([*names_first, *store.runs()[:SAMPLE]]):
        try:
            run_row = stored_row(store, run_id)
            pace = (run_row.wall_seconds or 0) / run_row.end
            machines = [attempt["machine"] for attempt in run_row.provenance["attempts"]]
            processors = {(machine["cpu"], machine["device"]) for machine in machines}
        except (UserError, KeyError, TypeError, ValueError, ArithmeticError):
            continue  # an imported or damaged run
        if pace > 0 and processors == {(own_cpu, "cpu")}:
            paces_by_key.setdefault(_pace_key(run_row.fields), []).append(pace)
    return {pace_key: statistics.fmean(paces) for pace_key, paces in paces_by_key.items()}


def expected_seconds(paces: Paces, run: Run, steps: int) -> float | None:
    """Return the seconds that some steps of a run take; None if no run with its pace has finished."""
    pace = paces.get(_pace_key(as_fields(run)))
    return START_SECONDS + steps * pace if pace else None


def _pace_key(settings: Mapping[str, Any]) -> str:
    return repr([settings.get(field_name) for field_name in PACE_FIELDS])


# --- While it runs ---------------------------------------------------------------------------------


class ProgressDisplay:
    """Shows the progress of runs on standard error. A context manager.

    `until` has the steps at which runs pause; 0 is the end. Notes are shown even if it is quiet.
    """

    def __init__(
        self, to_train: Mapping[str, Run], store: Store, quiet: bool, until: Mapping[str, int] = {}
    ) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        self._until = until
        self._show = bool(to_train) and not quiet
        self._live = self._show and sys.stderr.isatty()
        self._budgets = {run_id: run.trained_steps for run_id, run in to_train.items()}
        self._steps = {run_id: kept_step(store.status(run_id, quick=True)) for run_id in to_train}
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
            disable=not self._live,
        )
        self._task = self._bar.add_task(
            self._ended_text(), total=sum(self._budgets.values()), completed=sum(self._steps.values())
        )
        self._next_line = time.monotonic() + LINE_SECONDS

    def __enter__(self) -> ProgressDisplay:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # the terminal was closed
            self._bar.stop()

    def update(self, cell: Cell, event: Event) -> None:
        cell_label = f"{cell.condition} seed {cell.seed}"
        if event["event"] in ("note", "status"):
            if self._show or event["event"] == "note":
                print_aside(f"{cell_label}: {event['text']}")
            return
        status = self._count(cell.run_id, event)
        steps_trained = sum(self._steps.values())
        self._bar.update(self._task, completed=steps_trained, description=self._ended_text())
        clock = time.monotonic()
        if self._show and not self._live and (status or clock >= self._next_line):
            self._next_line = clock + LINE_SECONDS
            print_aside(self._line(cell_label, status))

    def _count(self, run_id: str, event: Event) -> str:
        """Count the steps in a run's event; return the status with which it ended or paused, if any."""
        status: str = event.get("status", "")
        if status in FINISHED:
            self._steps[run_id] = self._budgets[run_id]  # even if it diverged before
        else:
            self._steps[run_id] = max(self._steps[run_id], event["step"])
        pauses_at = self._until.get(run_id) or self._budgets[run_id]
        if status in ("stopped", "partial") and self._steps[run_id] >= pauses_at:
            return "paused"
        if status not in ("", "stopped"):
            self._ended.add(run_id)
        return status

    def _line(self, cell_label: str, status: str) -> str:
        progress = self._bar.tasks[0]
        progress_line = f"{self._ended_text()} ended, {progress.percentage:.0f} % of all steps"
        if status:
            progress_line = f"{cell_label}: {status}; {progress_line}"
        if progress.time_remaining:
            progress_line += f", {duration(progress.time_remaining)} left"
        return progress_line

    def _ended_text(self) -> str:
        return f"{len(self._ended)}/{len(self._steps)} runs"
