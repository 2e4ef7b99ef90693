"""Runtime estimate: how long runs take on this machine, by similar finished runs or by network size."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from pneuma.config import Run, as_fields
from pneuma.study.provenance import machine, processors
from pneuma.study.store import Store
from pneuma.study.stored_runs import stored_settings

SECONDS_PER_STEP = {
    "batched": ((1e3, 2e-5), (3e4, 4e-5), (4e6, 5e-3), (5e7, 6.5e-2)),
    "sb3": ((1e3, 1.2e-3), (1e5, 1.8e-3), (1e6, 5e-3), (1e7, 4e-2)),
    "tabular": ((1e3, 2e-5),),
}
"""By engine: seconds per agent step, evaluations included, by the number of weights."""
SAMPLE = 100
"""Other runs in the results folder from which paces are read."""
START_SECONDS = 4.0
"""Seconds that a worker takes to start with compiled programs."""
OF_PACE = (
    "engine", "algorithm", "env", "level", "players", "slots", "horizon", "minibatch", "epochs",
    "actor", "critic", "optimizer", "steps", "evaluation_episodes", "episode_steps", "observation", "reward",
    "random_levels", "magic", "classes", "buffer_size",
)  # fmt: skip
"""Fields that decide how long a step takes. Steps are one, as every run has the same number of
evaluations."""

Paces = Mapping[str, float]
"""Seconds per agent step of finished runs, by the fields that decide it."""


def stored_paces(store: Store, names_first: Iterable[str]) -> Paces:
    """Return the paces of finished runs on a processor like this one: those of a plan, and some others."""
    names, cpu = [*dict.fromkeys([*names_first, *store.runs()[:SAMPLE]])], machine()["cpu"]
    found: dict[str, list[float]] = {}
    for name in names:
        try:
            origin = store.read_document(name, "provenance.json")
            settings = stored_settings(store, name)
            seconds = origin.get("training_seconds", origin["wall_seconds"])
            pace = seconds / (origin["attempts"][-1]["step"] - settings["fork_step"])
        except (KeyError, TypeError, ValueError, IndexError, ArithmeticError):
            continue  # an imported, diverged, damaged or untrusted run tells nothing
        if pace > 0 and processors(origin) == (cpu,):
            found.setdefault(_kind(settings), []).append(pace)
    return {kind: statistics.fmean(paces) for kind, paces in found.items()}


def expected_seconds(paces: Paces, run: Run, steps: int) -> float:
    """Return about how many seconds a run takes for `steps` agent steps."""
    settings = as_fields(run)
    pace = paces.get(_kind(settings)) or _usual(settings)
    return START_SECONDS + steps * pace


def is_known(paces: Paces, run: Run) -> bool:
    """Return whether a similar run has been timed."""
    return _kind(as_fields(run)) in paces


def total_seconds(seconds: Iterable[float], workers: int) -> float:
    """Return about how many seconds runs take together with so many workers."""
    each = [*seconds]
    return max(sum(each) / max(workers, 1), max(each, default=0.0))


def _kind(settings: Mapping[str, Any]) -> str:
    return repr([settings.get(key) for key in OF_PACE])


def _usual(settings: Mapping[str, Any]) -> float:
    """Return the seconds per step from the table."""
    layers = [[64, *(settings.get(part) or ()), 5] for part in ("actor", "critic")]
    weights = max(1, sum(before * after for sizes in layers for before, after in pairwise(sizes)))
    known, seconds = np.log(SECONDS_PER_STEP[settings["engine"]]).T
    return float(np.exp(np.interp(np.log(weights), known, seconds)))
