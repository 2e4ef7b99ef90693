"""Runtime estimate: how long runs take here and how much disk, from earlier runs or a table by network size.

A run like it that finished tells best, on a processor like this one if any; else what the table says for its
engine and network, times how much slower than the table this machine's other runs were.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from pneuma.config import Run, as_fields
from pneuma.study.provenance import machine, processors, stored_origins
from pneuma.study.store import Store
from pneuma.study.stored_runs import stored_settings

SECONDS_PER_STEP = {
    "batched": ((1e3, 1.5e-4), (3e4, 2.5e-4), (1e5, 5e-4), (1e6, 1.5e-3), (1e7, 8e-3)),
    "sb3": ((1e3, 1.2e-3), (1e5, 1.8e-3), (1e6, 5e-3), (1e7, 4e-2)),
    "tabular": ((1e3, 2e-5),),
}
"""By engine: what an agent step takes on a usual core, evaluations included, with so many weights."""
SAMPLE = 100
"""Of how many other runs in the results folder the pace is read."""
START_SECONDS = 4.0
"""What a worker takes to start, programs being compiled."""
BYTES_PER_STEP = 3.0
"""Room that the records of one agent step take, compressed."""
OF_PACE = (
    "engine", "algorithm", "env", "level", "players", "slots", "horizon", "minibatch", "epochs",
    "actor", "critic", "optimizer", "steps", "evaluation_episodes", "episode_steps", "observation", "reward",
    "random_levels", "magic", "classes", "buffer_size",
)  # fmt: skip
"""Fields that decide how long a step takes. The budget is one: a short run has as many evaluations."""


@dataclass
class Paces:
    """How long agent steps took, in seconds, of runs that were timed.

    Attributes:
        like: by what decides how long a step takes.
        slower: by engine, how many times as long as the table says.
    """

    like: dict[str, list[float]] = field(default_factory=dict)
    slower: dict[str, list[float]] = field(default_factory=dict)

    def add(self, settings: Mapping[str, Any], seconds: float) -> None:
        """Take a run's fields, and the seconds that a step of it took."""
        slower = seconds / _usual(settings)
        self.like.setdefault(_kind(settings), []).append(seconds)
        self.slower.setdefault(settings["engine"], []).append(slower)

    def knows(self, run: Run) -> bool:
        """Tell whether a run like this one was timed."""
        return _kind(as_fields(run)) in self.like

    def seconds(self, run: Run, steps: int) -> float:
        """Return about how long a run takes for so many agent steps."""
        settings = as_fields(run)
        like, slower = self.like.get(_kind(settings)), self.slower.get(run.engine, [1.0])
        pace = statistics.fmean(like) if like else _usual(settings) * statistics.median(slower)
        return START_SECONDS + steps * pace


def stored_paces(store: Store, own: Iterable[str]) -> Paces:
    """Return the paces of runs that have ended: a plan's own, by id, and some others of the store."""
    names = [*dict.fromkeys([*own, *store.runs()[:SAMPLE]])]
    here, elsewhere, cpu = Paces(), Paces(), machine()["cpu"]
    for name, origin in stored_origins(store, names):
        try:
            settings = stored_settings(store, name)
            seconds = origin.get("training_seconds", origin["wall_seconds"])
            pace = seconds / (origin["attempts"][-1]["step"] - settings["fork_step"])
            if pace > 0 and len(processors(origin)) == 1:
                (here if origin.get("cpu") == cpu else elsewhere).add(settings, pace)
        except (KeyError, TypeError, ValueError, IndexError, ArithmeticError):
            continue  # a diverged, damaged or untrusted run tells nothing
    return here if here.like else elsewhere


def total_seconds(seconds: Iterable[float], workers: int) -> float:
    """Return about how long runs of such lengths take together, so many at once."""
    each = [*seconds]
    return max(sum(each) / max(workers, 1), max(each, default=0.0))


def disk_bytes(run: Run, keep_checkpoints: int = 0) -> int:
    """Return about how much room a run takes when it has ended; while it trains, two checkpoints more."""
    records = BYTES_PER_STEP * run.steps * (1 + keep_checkpoints / 2)  # a checkpoint has those up to its step
    checkpoints = keep_checkpoints + bool(keep_checkpoints)  # and that of the first update
    return int(4 * _weights(as_fields(run)) * (1 + 3 * checkpoints) + records)


def _kind(settings: Mapping[str, Any]) -> str:
    return repr([settings.get(key) for key in OF_PACE])


def _usual(settings: Mapping[str, Any]) -> float:
    """Return what the table says that a step takes."""
    weights, seconds = np.log(SECONDS_PER_STEP[settings["engine"]]).T
    return float(np.exp(np.interp(np.log(_weights(settings)), weights, seconds)))


def _weights(settings: Mapping[str, Any]) -> int:
    """Return about how many weights the networks of a run have; 1 of a table."""
    layers = [[64, *(settings.get(part) or ()), 5] for part in ("actor", "critic")]
    return max(1, sum(before * after for own in layers for before, after in pairwise(own)))
