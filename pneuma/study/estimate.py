"""Runtime estimate: how long runs take here, from runs like them, or a table by network size."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
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
OF_PACE = (
    "engine", "algorithm", "env", "level", "players", "slots", "horizon", "minibatch", "epochs",
    "actor", "critic", "optimizer", "steps", "evaluation_episodes", "episode_steps", "observation", "reward",
    "random_levels", "magic", "classes", "buffer_size",
)  # fmt: skip
"""Fields that decide how long a step takes. The budget is one: a short run has as many evaluations."""

Paces = Mapping[str, float]
"""Seconds that an agent step took of runs that were timed, by what decides over that."""


def stored_paces(store: Store, own: Iterable[str]) -> Paces:
    """Return the paces of runs that ended on such a processor: a plan's own, by id, and some others."""
    names, cpu = [*dict.fromkeys([*own, *store.runs()[:SAMPLE]])], machine()["cpu"]
    found: dict[str, list[float]] = {}
    for name, origin in stored_origins(store, names):
        try:
            settings = stored_settings(store, name)
            seconds = origin.get("training_seconds", origin["wall_seconds"])
            pace = seconds / (origin["attempts"][-1]["step"] - settings["fork_step"])
        except (KeyError, TypeError, ValueError, IndexError, ArithmeticError):
            continue  # a diverged, damaged or untrusted run tells nothing
        if pace > 0 and processors(origin) == (cpu,):
            found.setdefault(_kind(settings), []).append(pace)
    return {kind: statistics.fmean(paces) for kind, paces in found.items()}


def expected_seconds(paces: Paces, run: Run, steps: int) -> float:
    """Return about how long a run takes for so many agent steps."""
    settings = as_fields(run)
    pace = paces.get(_kind(settings)) or _usual(settings)
    return START_SECONDS + steps * pace


def is_known(paces: Paces, run: Run) -> bool:
    """Tell whether a run like this one was timed."""
    return _kind(as_fields(run)) in paces


def total_seconds(seconds: Iterable[float], workers: int) -> float:
    """Return about how long runs of such lengths take together, so many at once."""
    each = [*seconds]
    return max(sum(each) / max(workers, 1), max(each, default=0.0))


def _kind(settings: Mapping[str, Any]) -> str:
    return repr([settings.get(key) for key in OF_PACE])


def _usual(settings: Mapping[str, Any]) -> float:
    """Return what the table says that a step takes."""
    layers = [[64, *(settings.get(part) or ()), 5] for part in ("actor", "critic")]
    weights = max(1, sum(before * after for own in layers for before, after in pairwise(own)))
    known, seconds = np.log(SECONDS_PER_STEP[settings["engine"]]).T
    return float(np.exp(np.interp(np.log(weights), known, seconds)))
