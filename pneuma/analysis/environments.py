"""Studies of several environments: their runs in each, and scores over all (Agarwal et al. 2021).

StudyData → `by_environment` → StudyData of each environment, with conditions of the same names
    → scores on a common scale → `over_environments`, `improvements`, `profiles`

A run's score is its outcome on the scale of its environment, on which 0 and 1 are two reference scores.
Statistics are rliable's; they take the scores of one condition, or of many resamples of them. Intervals are
of the stratified bootstrap: runs are drawn anew within each environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from pneuma.analysis.intervals import LEVEL, interquartile_mean
from pneuma.analysis.outcomes import known_values
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import NO_CELL, summary_table, wide, with_cells
from pneuma.errors import UserError
from pneuma.study.spec import Study

OUTCOME = "evaluated-return"
"""Of which scores are made, unless another is asked for."""
FEWEST, RESAMPLES = 3, 10_000
"""Fewer runs in an environment are too few to draw anew; and how often they are drawn."""
POINTS = 200
"""Of a performance profile, for whose band a tenth as many are drawn."""
Parts = Mapping[str, StudyData]
Scores = Sequence[np.ndarray]
"""(…, runs) for each environment."""
Statistic = Callable[..., np.ndarray]


def by_environment(data: StudyData) -> dict[str, StudyData]:
    """Return a study's runs in each of its environments, by id; a single part if there is one environment.

    Conditions are called by all that they are crossed with but the environment, so that those of unlike
    environments have the same names.
    """
    levels = {name: _apart_from_env(data.study, of) for name, of in data.study.levels.items()}
    data = replace(data, study=data.study.model_copy(update={"levels": levels}))
    of_env: dict[str, dict[str, str]] = {}
    for name, fields in data.fields.items():
        parts = []
        for factor, level in levels.get(name, {}).items():
            named = f"{factor}={level}"  # where values have no names
            parts.append(named if named in name else level)
        of_env.setdefault(str(fields.get("env")), {})[name] = ", ".join(parts) or name
    return {env: data.renamed(names) for env, names in of_env.items()}


def _apart_from_env(study: Study, levels: Mapping[str, str]) -> dict[str, str]:
    """Return a condition's values of all factors but those that set the environment."""
    return {
        factor: level
        for factor, level in levels.items()
        if not any("env" in fields for fields in study.factors.get(factor, {}).values())
    }


def environments(data: StudyData) -> list[str]:
    return [*dict.fromkeys(str(fields.get("env")) for fields in data.fields.values())]


def in_environment_of(data: StudyData, other: StudyData) -> StudyData | None:
    """Return another study's runs in a study's environment; None without any. Logs do not tell theirs."""
    if data.averaged_over or other.averaged_over:
        return other
    own, parts = environments(data), by_environment(other)
    shared = [part for env, part in parts.items() if env in own]
    return other if shared and len(parts) == 1 else next(iter(shared), None)


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
            every = (known_values(data, name, outcome) for name in data.conditions)
            high = float(max((values.mean() for values in every if len(values)), default=np.nan))
        if not np.isfinite([low, high]).all() or low == high:
            fix = f"[scores.{env}] random = …, expert = … in the study's file"
            raise UserError(f"{env}: there is no scale from {low:g} to {high:g}: give {fix}")
        found[env] = low, high
    return found


def scores(parts: Parts, outcome: str = OUTCOME) -> dict[str, list[np.ndarray]]:
    """Return the scores of each condition that has runs in every environment: (runs,) by environment."""
    scales = references(parts, outcome)
    found = {}
    for name in dict.fromkeys(name for data in parts.values() for name in data.conditions):
        if all(data.of_condition(name) for data in parts.values()):
            values = {env: known_values(data, name, outcome) for env, data in parts.items()}
            found[name] = [(own - scales[env][0]) / np.diff(scales[env]) for env, own in values.items()]
    return {name: each for name, each in found.items() if all(map(len, each))}


def over_environments(parts: Parts, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return condition, statistic, value, low, high: one row for each of `AGGREGATES`."""
    rows = [
        (condition, name, float(aggregate(each)), *bootstrap(aggregate, each))
        for condition, each in scores(parts, outcome).items()
        for name, aggregate in AGGREGATES.items()
    ]
    return pd.DataFrame(rows, columns=["condition", "statistic", "value", "low", "high"])


def environment_cells(
    parts: Parts, outcome: str = OUTCOME, form: str = "interval"
) -> tuple[pd.DataFrame, pd.DataFrame, pd.DataFrame]:
    """Return a row for each condition with its means in each environment and its scores over all, as text.

    Also return the summaries of all environments, and the scores.
    """
    found = [
        with_cells(summary_table(part, [outcome]), form).assign(environment=env)
        for env, part in parts.items()
    ]
    every, over = pd.concat(found, ignore_index=True), over_environments(parts, outcome)
    every = every[(every["outcome"] == outcome) & (every["statistic"] == "mean")]
    names = [*dict.fromkeys(every["condition"])]
    means = wide(every, names, [*parts], of=["environment"])
    scored = wide(with_cells(over), names, [*dict.fromkeys(over["statistic"])], of=["statistic"])
    table = pd.concat([means, scored], axis=1).fillna(NO_CELL)
    table.columns = [str(column) for column in table.columns]
    runs = [", ".join(str(len(part.of_condition(name))) for part in parts.values()) for name in names]
    table.insert(0, "runs", runs)
    return table.reset_index(), every.drop(columns="cell"), over


def profiles(parts: Parts, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return the share of runs with a score above each x: condition, x, centre, low, high, runs."""
    found = scores(parts, outcome)
    if not found:
        raise UserError(f"no condition has runs in every environment: {', '.join(parts)}")
    every = [0.0, 1.0, *(score for each in found.values() for runs in each for score in runs)]
    thresholds = np.linspace(min(every), max(every), POINTS)
    above, frames = partial(profile, thresholds=thresholds), []
    for condition, each in found.items():
        low, high = bootstrap(above, each, resamples=RESAMPLES // 10)
        frame = {"x": thresholds, "centre": above(each), "low": low, "high": high}
        runs = ", ".join(str(len(runs)) for runs in each)
        frames.append(pd.DataFrame({"condition": condition, **frame, "runs": runs}))
    return pd.concat(frames, ignore_index=True)


def improvements(parts: Parts, a: str, b: str, outcome: str = OUTCOME) -> pd.DataFrame:
    """Return how likely a run of `a` is above one of `b` over all environments, and differences of scores."""
    found = scores(parts, outcome)
    for name in (a, b):
        if name not in found:
            raise UserError(f"{name}: no runs in every environment; there are {', '.join(found) or 'none'}")
    told: dict[str, Statistic] = {"P(better)": improvement}
    told |= {f"{name}, difference": partial(_difference, of) for name, of in AGGREGATES.items()}
    rows = [
        (name, float(statistic(found[a], found[b])), *bootstrap(statistic, found[a], found[b]))
        for name, statistic in told.items()
    ]
    return pd.DataFrame(rows, columns=["statistic", "value", "low", "high"])


# --- Statistics --------------------------------------------------------------------------------------

AGGREGATES: Mapping[str, Statistic] = {
    "mean": lambda scores: np.mean([each.mean(axis=-1) for each in scores], axis=0),
    "median": lambda scores: np.median([each.mean(axis=-1) for each in scores], axis=0),
    "IQM": lambda scores: interquartile_mean(np.concatenate(scores, axis=-1)),
    "optimality gap": lambda scores: 1 - np.minimum(np.concatenate(scores, axis=-1), 1).mean(axis=-1),
}
"""Mean and median over environments of means over runs; the mean of the middle half of all runs; and by how
much all miss a score of 1, in the mean, where what lies above 1 does not count."""


def profile(scores: Scores, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of all runs with scores above each threshold: (…, thresholds)."""
    runs = np.concatenate(scores, axis=-1)
    return (runs[..., None, :] > thresholds[:, None]).mean(axis=-1)


def improvement(a: Scores, b: Scores) -> np.ndarray:
    """Return the probability that a run of `a` is above one of `b` in the same environment, a tie a half.

    The mean over environments, which stand in the same order in both.
    """
    pairs = [(first[..., :, None], second[..., None, :]) for first, second in zip(a, b, strict=True)]
    return np.mean([((a > b) + 0.5 * (a == b)).mean(axis=(-2, -1)) for a, b in pairs], axis=0)


def _difference(aggregate: Statistic, a: Scores, b: Scores) -> np.ndarray:
    return aggregate(a) - aggregate(b)


def bootstrap(statistic: Statistic, *groups: Scores, resamples: int = RESAMPLES) -> np.ndarray:
    """Return the ends of a statistic's 95 % interval, (2, …); NaN if an environment has too few runs."""
    if min(len(runs) for group in groups for runs in group) < FEWEST:
        return np.array([statistic(*groups)] * 2) * np.nan
    generator = np.random.default_rng(0)
    drawn = [
        [runs[generator.integers(len(runs), size=(resamples, len(runs)))] for runs in group]
        for group in groups
    ]
    return np.quantile(statistic(*drawn), [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
