"""Studies of several environments: their runs in each, and scores over all.

StudyData → `by_environment` → StudyData of each environment, with conditions of the same names
    → scores on a common scale → `over_environments`, `improvements`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import pandas as pd

from pneuma.analysis.intervals import no_interval
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.scores import (
    AGGREGATES,
    Scores,
    bootstrap,
    improvement,
    normalized,
    profile,
    profile_band,
)
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError

OUTCOME = "evaluated-return"
"""Of which scores are made, unless another is asked for."""
FEWEST = 3
"""Fewer runs in an environment are too few to draw anew."""
POINTS = 200
"""Of a performance profile."""
Parts = Mapping[str, StudyData]
Statistic = Callable[..., np.ndarray]


def by_environment(data: StudyData) -> dict[str, StudyData]:
    """Return a study's runs in each of its environments, by id; a single part if there is one environment.

    Conditions are called by all that they are crossed with but the environment, so that those of unlike
    environments have the same names.
    """
    of_env: dict[str, dict[str, str]] = {}
    for name, fields in data.fields.items():
        of_env.setdefault(str(fields.get("env")), {})[name] = _apart_from_env(data, name)
    return {env: data.renamed(names) for env, names in of_env.items()}


def _apart_from_env(data: StudyData, condition: str) -> str:
    """Return the values of a condition in all factors but those that set the environment."""
    parts = []
    for factor, level in data.study.levels.get(condition, {}).items():
        if not any("env" in fields for fields in data.study.factors.get(factor, {}).values()):
            named = f"{factor}={level}"  # where values have no names
            parts.append(named if named in condition else level)
    return ", ".join(parts) or condition


def references(parts: Parts, outcome: str = OUTCOME) -> dict[str, tuple[float, float]]:
    """Return the outcomes that are scores of 0 and 1 in each environment.

    They are those of [scores] in the study's file, or else what the random player's episodes return, and the
    best condition's mean.

    Raises:
        UserError: when the two are equal, or not known.
    """
    found = {}
    for env, data in parts.items():
        if given := data.study.scores.get(env):
            low, high = given.random, given.expert
        else:
            seen = data.evaluations
            low = float(seen["random_return"].mean()) if "random_return" in seen else np.nan
            means = [
                _values(data, name, outcome).mean() for name in data.conditions if data.of_condition(name)
            ]
            high = float(max(means, default=np.nan))
        if not np.isfinite([low, high]).all() or low == high:
            fix = f"[scores.{env}] random = …, expert = … in the study's file"
            raise UserError(f"{env}: there is no scale from {low:g} to {high:g}: give {fix}")
        found[env] = low, high
    return found


def _values(data: StudyData, condition: str, outcome: str) -> np.ndarray:
    values = outcome_values(data, condition, outcome)
    return values[np.isfinite(values)]


def scores(parts: Parts, outcome: str = OUTCOME) -> dict[str, list[np.ndarray]]:
    """Return the scores of each condition that has runs in every environment: (runs,) by environment."""
    scales = references(parts, outcome)
    names = dict.fromkeys(name for data in parts.values() for name in data.conditions)
    found = {
        name: [normalized(_values(data, name, outcome), *scales[env]) for env, data in parts.items()]
        for name in names
        if all(name in data.conditions for data in parts.values())
    }
    return {name: each for name, each in found.items() if all(len(runs) for runs in each)}


def over_environments(parts: Parts, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return condition, statistic, value, low, high: one row for each of `AGGREGATES`."""
    rows = []
    for condition, each in scores(parts, outcome).items():
        for name, aggregate in AGGREGATES.items():
            rows.append((condition, name, float(aggregate(each)), *_ends(aggregate, each)))
    return pd.DataFrame(rows, columns=["condition", "statistic", "value", "low", "high"])


def profiles(parts: Parts, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return condition, x, centre, low, high, runs: the share of runs with a score above each x, with a band.

    A condition of fewer than `FEWEST` runs in an environment has no band.
    """
    found = scores(parts, outcome)
    every = [0.0, 1.0, *(score for each in found.values() for runs in each for score in runs)]
    thresholds = np.linspace(min(every), max(every), POINTS)
    frames = []
    for condition, each in found.items():
        low, high = profile_band(each, thresholds) if _enough(each) else [thresholds * np.nan] * 2
        frame = {"x": thresholds, "centre": profile(each, thresholds), "low": low, "high": high}
        counts = ", ".join(str(len(runs)) for runs in each)
        frames.append(pd.DataFrame({"condition": condition, **frame, "runs": counts}))
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=["condition"])


def improvements(parts: Parts, a: str, b: str, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return how likely a run of `a` is above one of `b` over all environments, and differences of scores."""
    found = scores(parts, outcome)
    for name in (a, b):
        if name not in found:
            raise UserError(f"{name}: no runs in every environment; there are {', '.join(found) or 'none'}")
    arms = found[a], found[b]
    rows = [("P(better)", float(improvement(*arms)), *_ends(improvement, *arms))]
    for name, aggregate in AGGREGATES.items():
        less = partial(_difference, aggregate)
        rows.append((f"{name}, difference", float(less(*arms)), *_ends(less, *arms)))
    return pd.DataFrame(rows, columns=["statistic", "value", "low", "high"])


def _difference(aggregate: Statistic, a: Scores, b: Scores) -> np.ndarray:
    return aggregate(a) - aggregate(b)


def _ends(statistic: Statistic, *groups: Scores) -> tuple[float, float]:
    ends = bootstrap(statistic, *groups) if all(map(_enough, groups)) else no_interval()
    return ends.low, ends.high


def _enough(scores: Scores) -> bool:
    return min(map(len, scores)) >= FEWEST
