"""Studies of several environments: their runs in each, and scores over all.

StudyData → `by_environment` → StudyData of each environment, with conditions of the same names
    → scores on a common scale → `over_environments`, `improvements`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd

from pneuma.analysis.intervals import no_interval, shown_with_interval
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.scores import AGGREGATES, Scores, bootstrap, improvement, normalized
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import NO_CELL, summary_table, wide, with_cells
from pneuma.errors import UserError

OUTCOME = "evaluated-return"
"""Of which scores are made, unless another is asked for."""
FEWEST = 3
"""Fewer runs in an environment are too few to draw anew."""
Parts = Mapping[str, StudyData]
Statistic = Callable[..., np.ndarray]


def by_environment(data: StudyData) -> dict[str, StudyData]:
    """Return a study's runs in each of its environments, by id; a single part if there is one environment.

    Conditions are called by all that they are crossed with but the environment, so that those of unlike
    environments have the same names.
    """
    of = {name: str(fields.get("env")) for name, fields in data.fields.items()}
    names = {name: _apart_from_env(data, name) for name in data.fields}
    parts = {}
    for env in dict.fromkeys(of.values()):
        inside = [name for name in data.fields if of[name] == env]
        parts[env] = _renamed(data.of_conditions(inside), {name: names[name] for name in inside})
    return parts


def _apart_from_env(data: StudyData, condition: str) -> str:
    setting = {
        key for key, values in data.study.factors.items() if any("env" in each for each in values.values())
    }
    levels = data.study.levels.get(condition, {})
    parts = [
        f"{factor}={level}" if f"{factor}={level}" in condition else level
        for factor, level in levels.items()
        if factor not in setting
    ]
    return ", ".join(parts) or condition


def _renamed(data: StudyData, names: Mapping[str, str]) -> StudyData:
    rows = [replace(row, condition=names[row.condition]) for row in data.rows]
    runs = data.runs.assign(row=pd.Series(rows, dtype=object, index=data.runs.index))
    study = data.study.model_copy(
        update={
            "conditions": {
                names[name]: fields for name, fields in data.study.conditions.items() if name in names
            },
            "labels": {names[name]: label for name, label in data.study.labels.items() if name in names},
            "baseline": names.get(data.study.baseline, next(iter(names.values()))),
            "levels": {},
        }
    )
    return replace(
        data,
        study=study,
        fields={names[name]: fields for name, fields in data.fields.items()},
        runs=runs.assign(condition=[names[name] for name in runs["condition"]]),
        configurations={names[name]: run for name, run in data.configurations.items()},
    )


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
    scored = wide(score_cells(over), names, [*dict.fromkeys(over["statistic"])], of=["statistic"])
    table = pd.concat([means, scored], axis=1).fillna(NO_CELL)
    table.columns = [str(column) for column in table.columns]
    runs = [", ".join(str(len(part.of_condition(name))) for part in parts.values()) for name in names]
    table.insert(0, "runs", runs)
    return table.reset_index(), every.drop(columns="cell"), over


def score_cells(numbers: pd.DataFrame) -> pd.DataFrame:
    """Return scores with a column `cell`: each as text, with its interval."""
    rows = zip(numbers["value"], numbers["low"], numbers["high"], strict=True)
    return numbers.assign(cell=[shown_with_interval(*row) for row in rows])


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
    few = min(len(runs) for group in groups for runs in group) < FEWEST
    ends = no_interval() if few else bootstrap(statistic, *groups)
    return ends.low, ends.high
