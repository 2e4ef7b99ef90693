"""Foresight: how long runs take on this machine, and how much of a study is left.

A run's pace is judged by finished runs like it, or by what a calibration
(`pneuma.study.calibration`) measured on this machine.
"""

from __future__ import annotations

import hashlib
import heapq
import json
import statistics
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from pneuma.config import Run, as_fields
from pneuma.study.execute import Progress
from pneuma.study.files import read_sealed, seal
from pneuma.study.origins import processors, stored_origins
from pneuma.study.plan import Plan
from pneuma.study.provenance import machine
from pneuma.study.store import Status, Store

BYTES_PER_STEP = 3.0
"""Room that the records of one agent step take, compressed."""

_SCALARS = (
    "seed", "learning_rate", "clip_range", "gamma", "gae_lambda", "value_coefficient",
    "entropy_coefficient", "gradient_limit", "betas", "epsilon", "momentum", "dampening", "smoothing",
    "utility_decay", "noise",
    "weight_decay", "activation", "value_baseline", "target_kl", "exploration", "exploration_fraction",
    "learning_starts", "target_every", "action_slip", "reward_noise", "parent", "fork_step", "fork_reset",
)  # fmt: skip
"""Settings that hardly change how long a step takes. The budget does: a short run has as many evaluations."""


@dataclass(frozen=True)
class Pace:
    """How long a run takes: `start` seconds before its first update, then so long for each agent step."""

    start: float
    per_step: float

    def seconds(self, steps: int) -> float:
        """Return how long so many agent steps take, start included."""
        return self.start + steps * self.per_step


@dataclass(frozen=True)
class Measured:
    """A finished run: its kind, the seconds that a step took, and what it was trained on.

    Attributes:
        cpu: the processor's name.
        processor: that, or the GPU's where it computed on one.
    """

    kind: str
    per_step: float
    cpu: str
    processor: str


def measured_runs(plan: Plan, statuses: Mapping[str, Status], store: Store) -> list[Measured]:
    """Return how fast the finished runs of a plan were; not those that changed processors on their way."""
    runs = {cell.run_id: cell.run for cell in plan.cells if statuses[cell.run_id].finished}
    found = []
    for name, origin in stored_origins(store, runs):
        seconds, trained_on = origin.get("wall_seconds"), processors(origin)
        if isinstance(seconds, int | float) and seconds > 0 and len(trained_on) == 1:
            run = runs[name]
            trained = statuses[name].step - run.fork_step  # of a diverged run fewer than it was to train
            if trained > 0:
                found.append(Measured(kind(run), seconds / trained, str(origin.get("cpu")), trained_on[0]))
    return found


def known_paces(measured: Iterable[Measured], store: Store) -> dict[str, Pace]:
    """Return the pace of every kind of run that is known here, by `kind`.

    Runs that a processor like this one trained tell best, then a calibration here, then runs of others.
    """
    here = machine(threads=1)["cpu"]
    own, others = dict[str, list[float]](), dict[str, list[Measured]]()
    for each in measured:
        if each.cpu == here:
            own.setdefault(each.kind, []).append(each.per_step)
        else:
            others.setdefault(each.kind, []).append(each)
    elsewhere = {name: [statistics.fmean(r) for r in _rates(each).values()] for name, each in others.items()}
    calibrated = {name: Pace(*told) for name, told in _calibrations(store).items()}
    return _paces(elsewhere) | calibrated | _paces(own)


def processor_speeds(plan: Plan, measured: Iterable[Measured]) -> dict[str, dict[str, tuple[float, int]]]:
    """Return how fast each condition was trained where several kinds of processor trained runs like its own.

    That is, by condition and processor, steps a second and the number of runs.
    """
    by_kind: dict[str, list[Measured]] = {}
    for each in measured:
        by_kind.setdefault(each.kind, []).append(each)
    rates = {cell.condition: _rates(by_kind.get(kind(cell.run), ())) for cell in plan.cells}
    return {
        condition: {name: (1 / statistics.fmean(each), len(each)) for name, each in own.items()}
        for condition, own in rates.items()
        if len(own) > 1
    }


def _rates(measured: Iterable[Measured]) -> dict[str, list[float]]:
    """Return the seconds that a step took, by processor."""
    rates: dict[str, list[float]] = {}
    for each in measured:
        rates.setdefault(each.processor, []).append(each.per_step)
    return rates


def _paces(rates: Mapping[str, list[float]]) -> dict[str, Pace]:
    return {name: Pace(0.0, statistics.fmean(own)) for name, own in rates.items()}


def kind(run: Run) -> str:
    """Return a digest of all that decides how long a step of a run takes."""
    settings = {key: value for key, value in as_fields(run).items() if key not in _SCALARS}
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]


def keep_calibration(store: Store, name: str, pace: Pace) -> None:
    """Keep the pace of a kind of runs that was measured on this machine, beside what is kept already."""
    kept, here = _all_calibrations(store), _machine()
    paces = {**kept, here: {**kept.get(here, {}), name: [pace.start, pace.per_step]}}
    store.write(_calibration_path(store), seal({"paces": paces}))


def _calibration_path(store: Store) -> Path:
    return store.root / "calibration.json"


def _calibrations(store: Store) -> dict[str, list[float]]:
    """Return start and seconds a step of each kind of run that was measured on this machine."""
    return _all_calibrations(store).get(_machine(), {})


def _all_calibrations(store: Store) -> dict[str, dict[str, list[float]]]:
    """Return the calibrations of every machine that shares the results folder."""
    told = (read_sealed(_calibration_path(store)) or {}).get("paces")
    kept = (
        {name: own for name, own in told.items() if isinstance(own, dict)} if isinstance(told, dict) else {}
    )
    return {name: {kind: pace for kind, pace in own.items() if _is_pace(pace)} for name, own in kept.items()}


def _is_pace(told: object) -> bool:
    """Tell whether a calibration, which may be a stranger's, is of a start and a step."""
    return isinstance(told, list) and len(told) == 2 and all(type(own) in (int, float) for own in told)


def _machine() -> str:
    here = machine(threads=1)
    return hashlib.sha256(json.dumps([here["cpu"], here["packages"]]).encode()).hexdigest()[:16]


# --- Disk ----------------------------------------------------------------------------------------


def disk_bytes(run: Run, keep_checkpoints: int = 0) -> int:
    """Return about how much room a run takes when it has ended; while it trains, two checkpoints more."""
    weights = 0
    for hidden in (run.actor, run.critic):
        layers = [64, *hidden, 5]
        weights += sum(a * b for a, b in zip(layers, layers[1:], strict=False))
    records = BYTES_PER_STEP * run.steps * (1 + keep_checkpoints / 2)  # a checkpoint has those up to its step
    checkpoints = keep_checkpoints + bool(keep_checkpoints)  # and that of the first update
    return int(4 * weights * (1 + 3 * checkpoints) + records)


# --- Time left -----------------------------------------------------------------------------------


def wall_seconds(seconds: Iterable[float], workers: int) -> float:
    """Return how long runs of such lengths take, begun in this order by whichever worker is free."""
    free = [0.0] * max(workers, 1)
    for own in seconds:
        heapq.heappush(free, heapq.heappop(free) + own)
    return max(free)


class TimeLeft:
    """Judges from the progress of runs how long the rest of them takes.

    Args:
        runs: to be trained, by id, in the order in which they are begun.
        workers: how many at once.
        kept: the steps from which runs go on, where that is not 0: of a checkpoint, or of a fork's parent.
        clock: a monotonic clock in seconds.
    """

    def __init__(
        self,
        runs: Mapping[str, Run],
        workers: int,
        kept: Mapping[str, int] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._runs = dict(runs)
        self._kept = kept or {}
        self._workers = workers
        self._clock = clock
        self._begun = clock()
        self._first: dict[str, tuple[float, int]] = {}
        self._last: dict[str, tuple[float, int]] = {}
        self._ended: set[str] = set()
        self._kinds: dict[str, str] = {}

    def update(self, progress: Progress) -> None:
        """Take one event of `execute`."""
        name = progress.cell.run_id
        if progress.status:
            self._ended.add(name)
        elif progress.step:
            if progress.step < self._last.get(name, (0.0, 0))[1]:
                del self._first[name]  # it went back to a checkpoint
            self._first.setdefault(name, (self._clock(), progress.step))
            self._last[name] = (self._clock(), progress.step)

    def seconds(self) -> float | None:
        """Return how long all runs that have not ended still take; None before anything can be said."""
        paces = {name: pace for name in self._first if (pace := self._pace(name))}
        if not paces:
            return None
        usual, alike = statistics.fmean(paces.values()), self._paces_of_kinds(paces)
        earliest = next(iter(self._first))
        start = self._start(earliest, paces.get(earliest, usual))
        now = self._clock()
        running, waiting = [], []
        for name, run in self._runs.items():
            if name in self._ended:
                continue
            pace = paces[name] if name in paces else alike.get(self._kind(name), usual)
            if name in self._last:
                then, step = self._last[name]
                running.append(max(0.0, (run.steps - step) * pace - (now - then)))
            else:
                waiting.append(start + (run.steps - self._kept.get(name, 0)) * pace)
        return wall_seconds([*sorted(running), *waiting], self._workers)

    def _pace(self, name: str) -> float | None:
        """Return the seconds a step of a run takes; None before its second report."""
        (first, early), (last, late) = self._first[name], self._last[name]
        return (last - first) / (late - early) if late > early else None

    def _start(self, name: str, pace: float) -> float:
        """Return about how long a worker took before a run's first step."""
        first, step = self._first[name]
        return min(max(0.0, first - self._begun - (step - self._kept.get(name, 0)) * pace), 10.0)

    def _paces_of_kinds(self, paces: Mapping[str, float]) -> dict[str, float]:
        """Return the mean pace of the runs of each kind."""
        of_kinds: dict[str, list[float]] = {}
        for name, pace in paces.items():
            of_kinds.setdefault(self._kind(name), []).append(pace)
        return {own: statistics.fmean(together) for own, together in of_kinds.items()}

    def _kind(self, name: str) -> str:
        """Return the kind of a run, worked out once: this is asked for thousands of runs at every report."""
        if name not in self._kinds:
            self._kinds[name] = kind(self._runs[name])
        return self._kinds[name]
