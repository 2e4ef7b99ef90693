"""Calibration: how fast this machine trains a kind of runs that nobody has timed here.

The first seconds of a run are trained, into a folder that is thrown away. A slow run does not come to its
first evaluation in that time; then one update and one evaluation are trained as well.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

from pneuma.config import Run
from pneuma.engines.base import evaluation_updates
from pneuma.study.executors.base import Event, Supervision
from pneuma.study.executors.local import run_groups
from pneuma.study.foresight import Pace, keep_calibration, kind
from pneuma.study.identity import run_id
from pneuma.study.store import Store

MEASURED_SECONDS = 4.0
COLD_SECONDS = 20.0
"""A start that takes longer has compiled programs, which runs to come find compiled."""
COMPILED = 10.0
"""How many times as long as most steps took one is not a step's time; an evaluation adds less."""


def calibrate(
    runs: Iterable[Run], store: Store, paces: Mapping[str, Pace], say: Callable[[str], None]
) -> dict[str, Pace]:
    """Return paces by kind, with those measured that are missing; each is kept for this machine at once."""
    unknown = {own: run for run in runs if (own := kind(run)) not in paces}
    if unknown:
        store.check_writable()  # before the time is spent
    known = dict(paces)
    for i, (name, run) in enumerate(unknown.items()):
        say(f"measuring how fast this machine trains ({i + 1} of {len(unknown)}) …")
        pace = _measure(run)
        if pace and pace.start > COLD_SECONDS:
            say("it had to compile first; measuring once more …")
            pace = _measure(run) or pace
        if pace:
            known[name] = _with_evaluations(run, pace)
            keep_calibration(store, name, known[name])
    return known


def _measure(run: Run) -> Pace | None:
    """Train the first seconds of a run and time them; None where that fails."""
    begun, moments = _moments(run, MEASURED_SECONDS)
    if all(late <= early for (_, early), (_, late) in pairwise(moments)):
        return None
    first, early = moments[0]
    per_step = _usual_pace(moments)
    return Pace(max(0.0, first - begun - early * per_step), per_step)


def _with_evaluations(run: Run, pace: Pace) -> Pace:
    """Return the pace of a run with its evaluations, if it was too slow to come to one while it was timed.

    An evaluation takes what a run of a single update takes beyond that update.
    """
    judged = evaluation_updates(run)
    if min(judged) * run.steps_per_update * pace.per_step <= MEASURED_SECONDS:
        return pace
    begun, moments = _moments(replace(run, steps=run.steps_per_update), None)
    if not moments:
        return pace
    evaluation = max(0.0, moments[0][0] - begun - pace.seconds(run.steps_per_update))
    return Pace(pace.start, pace.per_step + len(judged) * evaluation / run.steps)


def _moments(run: Run, seconds: float | None) -> tuple[float, list[tuple[float, int]]]:
    """Train a run, for so long at most; return when that began, and when it had taken how many steps."""
    moments: list[tuple[float, int]] = []
    begun = time.monotonic()

    def note(event: Event) -> None:
        if event["event"] == "step":
            moments.append((time.monotonic(), event["step"]))

    with tempfile.TemporaryDirectory() as folder:
        how = Supervision(workers=1, checkpoint_seconds=1e9, timeout_seconds=seconds)
        run_groups([{run_id(run): run}], Store(Path(folder)), how, note)
    return begun, moments


def _usual_pace(moments: Sequence[tuple[float, int]]) -> float:
    """Return the seconds that a step takes, but for those that waited for a program to be compiled."""
    paces = [
        (then - before) / (late - early)
        for (before, early), (then, late) in pairwise(moments)
        if late > early
    ]
    most = COMPILED * statistics.median(paces)
    return statistics.fmean(pace for pace in paces if pace <= most)
