"""Calibration: how fast this machine trains a kind of runs that nobody has timed here.

The first seconds of a run are trained, into a folder that is thrown away. A slow run does not come to its
first evaluation in that time; then two updates are trained, and evaluated, as well.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

from pneuma.config import Run
from pneuma.engines.base import evaluation_updates
from pneuma.study.compiling import COMPILES, WAITS
from pneuma.study.executors.base import Event, Supervision
from pneuma.study.executors.local import run_groups
from pneuma.study.foresight import Pace, keep_calibration, kind
from pneuma.study.identity import run_id
from pneuma.study.store import Store

MEASURED_SECONDS = 4.0
COLD_SECONDS = 30.0
"""A start that takes longer may have compiled without a word; or drawn the weights of a big network."""
START_MATTERS = 0.1
"""A start that is less of the whole run than this is measured once, though it compiled: another takes
minutes with big networks, and without it a forecast is about a tenth too long at most."""
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
        pace, compiled = _measure(run)
        cold = compiled or (pace is not None and pace.start > COLD_SECONDS)  # later runs find it compiled
        if pace and cold and pace.start > START_MATTERS * pace.seconds(run.steps):
            say("it had to compile first; measuring once more …")
            pace = _measure(run)[0] or pace
        if pace:
            known[name] = _with_evaluations(run, pace)
            keep_calibration(store, name, known[name])
    return known


def _measure(run: Run) -> tuple[Pace | None, bool]:
    """Time the first seconds of a run, None where that fails; tell whether it had to compile."""
    timed = _time(run, MEASURED_SECONDS)
    if all(late <= early for (_, early), (_, late) in pairwise(timed.moments)):
        return None, timed.compiled
    first, early = timed.moments[0]
    per_step = _usual_pace(timed.moments)
    return Pace(max(0.0, first - timed.begun - early * per_step), per_step), timed.compiled


def _with_evaluations(run: Run, pace: Pace) -> Pace:
    """Return the pace of a run with its evaluations, if it was too slow to come to one while it was timed.

    Both updates of a run of two are evaluated; what the second takes beyond an update is an evaluation.
    """
    judged = evaluation_updates(run)
    if min(judged) * run.steps_per_update * pace.per_step <= MEASURED_SECONDS:
        return pace
    moments = _time(replace(run, steps=2 * run.steps_per_update), None).moments
    if len(moments) < 2:
        return pace
    evaluation = max(0.0, moments[1][0] - moments[0][0] - run.steps_per_update * pace.per_step)
    return Pace(pace.start, pace.per_step + len(judged) * evaluation / run.steps)


@dataclass
class _Timed:
    """A training that was watched.

    Attributes:
        begun: when, on the monotonic clock.
        moments: when it had taken how many steps.
        compiled: whether it had to compile its programs, or to wait for another to do so.
    """

    begun: float
    moments: list[tuple[float, int]] = field(default_factory=list)
    compiled: bool = False

    def note(self, event: Event) -> None:
        """Take an event of the training."""
        if event["event"] == "step":
            self.moments.append((time.monotonic(), event["step"]))
        self.compiled |= event.get("text") in (COMPILES, WAITS)


def _time(run: Run, seconds: float | None) -> _Timed:
    """Watch a run train, for so long at most."""
    timed = _Timed(time.monotonic())
    with tempfile.TemporaryDirectory() as folder:
        how = Supervision(workers=1, checkpoint_seconds=1e9, timeout_seconds=seconds)
        run_groups([{run_id(run): run}], Store(Path(folder)), how, timed.note)
    return timed


def _usual_pace(moments: Sequence[tuple[float, int]]) -> float:
    """Return the seconds that a step takes, but for those that waited for a program to be compiled."""
    paces = [
        (then - before) / (late - early)
        for (before, early), (then, late) in pairwise(moments)
        if late > early
    ]
    most = COMPILED * statistics.median(paces)
    return statistics.fmean(pace for pace in paces if pace <= most)
