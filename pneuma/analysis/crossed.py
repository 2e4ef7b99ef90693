"""Crossed studies: the effect of each factor, and the cells in which a contrast holds.

    a study and an outcome → a cell of runs for each combination of levels → effects, Holm-corrected
    a study, a field and two values of it → a pair of conditions for each cell → a robustness map

Factors are the fields in which the resolved conditions differ; nobody has to name them. Fields that do not
take all combinations of their values form one factor of the effects. A cell of a map is a pair of conditions
that differ only in the contrast's field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import linalg

from pneuma.analysis.contrasts import Contrast, compare
from pneuma.analysis.frames import StudyData
from pneuma.analysis.intervals import finite
from pneuma.analysis.outcomes import find_outcome, outcome_values, primary, refuse_unlike_returns
from pneuma.config import Run, stream_seed
from pneuma.env_fields import read_field
from pneuma.errors import UserError, counted
from pneuma.study.plan import differing_fields
from pneuma.values import as_tuple, shown_level, shown_value

DRAWS = 5_000
"""Permutations per test of an effect."""
ALPHA = 0.05
"""Error rate over all cells of a map."""
HOLDS, REVERSED, OPEN = "holds", "reversed", "open"


# --- Effects ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Effects:
    """All main effects and two-way interactions of a crossed study.

    Attributes:
        table: of `factorial`, with p-values also corrected over all effects by Holm's method.
        means: the means of each factor's levels, with equal weight for each cell.
        cells: number of combinations of levels.
        runs: number of runs with a value of the outcome.
        without: number of finished runs without one, which are left out.
    """

    outcome: str
    table: pd.DataFrame
    means: Mapping[str, Mapping[str, float]]
    cells: int
    runs: int
    without: int


def study_effects(data: StudyData, name: str | None = None) -> Effects:
    """Test all main effects and two-way interactions of a crossed study's factors.

    Raises:
        UserError: for an unknown outcome, returns of different rewards, a study that is not crossed, a cell
            without a run that has the outcome, or too few runs.
    """
    name = name or primary(data)
    refuse_unlike_returns(data, name)
    factors, cells = find_crossing(data)
    runs = {  # one that two conditions share counts once
        run.run_id: (cell, value)
        for condition, cell in cells.items()
        for run, value in zip(data.of_condition(condition), _values(data, condition, name), strict=True)
    }
    known = [(cell, value) for cell, value in runs.values() if not np.isnan(value)]
    values, index = [value for _, value in known], [cell for cell, _ in known]
    if empty := next((cell for cell in cells.values() if cell not in index), None):
        raise UserError(f"outcome {name}: no finished run of {', '.join(empty)} has it; every cell needs one")
    levels = {factor: [cell[i] for cell in index] for i, factor in enumerate(factors)}
    table = factorial(values, levels, np.random.default_rng(stream_seed("effects", name)))
    if (table["df_error"] < 1).any():
        there = f"{counted(len(known), 'run')} in {counted(len({*index}), 'cell')}"
        raise UserError(
            f"study {data.study}: {there} leave nothing to tell an effect from chance; run more --seeds"
        )
    table.insert(2, "outcome", name)
    table = table.assign(p_holm=holm(table["p"]), runs=len(known))
    by_cell = pd.Series(values, pd.MultiIndex.from_tuples(index)).groupby(level=[*range(len(factors))]).mean()
    means = {
        factor: {level: float(by_cell.xs(level, level=i).mean()) for level in names}
        for i, (factor, names) in enumerate(factors.items())
    }
    return Effects(name, table, means, len(by_cell), len(known), len(runs) - len(known))


def find_crossing(data: StudyData) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Return a study's factors with their levels, and the level of every factor in each condition.

    Conditions without a finished run are included.

    Raises:
        UserError: when fewer than two factors are crossed, or a combination is missing.
    """
    settings = _settings(data)

    def level(fields: Mapping[str, Any], keys: Sequence[str]) -> str:
        return " + ".join(shown_value(fields[key]) if key in fields else "none" for key in keys)

    def seen(*keys: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(level(fields, keys) for fields in settings.values()))

    groups: list[tuple[str, ...]] = [(key,) for key in _levels(settings)]
    while pair := next(
        ((a, b) for a, b in combinations(groups, 2) if len(seen(*a, *b)) < len(seen(*a)) * len(seen(*b))),
        None,
    ):
        groups[groups.index(pair[0])] = pair[0] + pair[1]
        groups.remove(pair[1])
    factors = {" + ".join(group): seen(*group) for group in groups}
    cells = {name: tuple(level(fields, group) for group in groups) for name, fields in settings.items()}
    if len(factors) < 2 or {*product(*factors.values())} - {*cells.values()}:
        raise UserError(
            f"study {data.study} is not crossed: its conditions differ in {', '.join(factors) or 'nothing'}; "
            "take one whose conditions are every combination of two factors' values ([factors] in its "
            "file), and all of them"
        )
    return factors, cells


def factorial(
    values: ArrayLike, factors: Mapping[str, Sequence[str]], generator: np.random.Generator
) -> pd.DataFrame:
    """Return all main effects and two-way interactions, one a row.

    Each effect is tested with the others in the model, by permuting the residuals of the model without it
    (Freedman and Lane 1983). The test is exact if there are no other effects, and close otherwise. Levels are
    coded as deviations from their mean, so that a main effect is the average over the other factors' levels
    with equal weights, however many runs each cell has.

    Args:
        values: (runs,) finite numbers.
        factors: by name, the (runs,) levels of each run; balanced or not.
        generator: draws the permutations.

    Returns:
        Columns effect and levels (the factors, and how many levels each has), df and df_error (degrees of
        freedom of the effect and of the errors), f (inf without errors), partial_r2 (share of the variance
        that the other effects leave) and p (NaN if the design cannot separate the effect from others).
    """
    runs = finite(values)
    coded: dict[tuple[str, ...], np.ndarray] = {
        (name,): _deviations(levels) for name, levels in factors.items()
    }
    for one, other in combinations(factors, 2):
        both = coded[one,][:, :, None] * coded[other,][:, None, :]
        coded[one, other] = both.reshape(runs.size, -1)
    shuffles = np.argsort(generator.random((DRAWS, runs.size)), axis=1)
    constant = np.ones((runs.size, 1))
    rows = []
    for names, columns in coded.items():
        others = np.hstack([constant, *(each for term, each in coded.items() if term != names)])
        levels = " × ".join(str(len({*factors[name]})) for name in names)
        rows.append((" × ".join(names), levels, *_test(runs, others, columns, shuffles)))
    return pd.DataFrame(rows, columns=["effect", "levels", "df", "df_error", "f", "partial_r2", "p"])


def _deviations(levels: Sequence[str]) -> np.ndarray:
    """Return the sum-to-zero coding of a factor, (runs, levels - 1)."""
    names, index = np.unique(np.asarray(levels), return_inverse=True)
    return np.vstack([np.eye(names.size - 1), -np.ones(names.size - 1)])[index]


def _test(
    runs: np.ndarray, others: np.ndarray, columns: np.ndarray, shuffles: np.ndarray
) -> tuple[int, int, float, float, float]:
    """Return degrees of freedom, F, partial R² and p-value of an effect's columns, given the others."""
    reduced, full = (linalg.orth(each, rcond=1e-9) for each in (others, np.hstack([others, columns])))
    gained, left = full.shape[1] - reduced.shape[1], runs.size - full.shape[1]
    degrees = columns.shape[1], left
    if gained < columns.shape[1] or left < 1:
        return *degrees, np.nan, np.nan, np.nan
    residuals = runs - reduced @ (reduced.T @ runs)
    if np.abs(residuals).max() <= 1e-12 * max(1.0, np.abs(runs).max()):
        return *degrees, np.nan, np.nan, 1.0
    # The fitted part lies in both models, so it does not change their residuals.
    samples = np.vstack([residuals, residuals[shuffles]])  # (1 + draws, runs)
    tiny = 1e-12 * (residuals**2).sum()
    before = (samples**2).sum(axis=1) - ((samples @ reduced) ** 2).sum(axis=1)
    after = np.maximum((samples**2).sum(axis=1) - ((samples @ full) ** 2).sum(axis=1), tiny)
    taken = np.where(before - after > tiny, before - after, 0.0)  # rounding is not counted
    statistic = taken / gained / (after / left)
    p_value = float((statistic >= statistic[0] * (1 - 1e-9)).mean())
    f = float(statistic[0]) if after[0] > tiny else np.inf
    return *degrees, f, float(taken[0] / before[0]), p_value


# --- The robustness map ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Map:
    """A contrast in all combinations of the other factors' levels.

    Attributes:
        setting: the field in which the two conditions of a cell differ.
        values: the value that is claimed to be better, and the other one.
        outcome: by which they are compared.
        factors: the fields in which cells differ.
        cells: one row each, in the study's order: levels, both conditions, and their difference, which is
            above 0 if it is as claimed. P-values are two-sided and Holm-corrected over the map.
        runs: number of runs of each arm.
    """

    setting: str
    values: tuple[Any, Any]
    outcome: str
    factors: tuple[str, ...]
    cells: pd.DataFrame
    runs: tuple[int, ...]

    @property
    def label(self) -> str:
        """In how many cells the contrast holds, and in how many it is reversed if it is in any."""
        labels = [*self.cells["label"]]
        backwards = f", reversed in {labels.count(REVERSED)}" if REVERSED in labels else ""
        return f"holds in {labels.count(HOLDS)} of {len(labels)}{backwards}"


def robustness_map(
    data: StudyData, setting: str, better: object, worse: object, outcome: str | None = None
) -> Map:
    """Map a contrast over all pairs of conditions that differ in a single field.

    The outcome, by default the study's primary one, has a better direction.

    Raises:
        UserError: when no pair of conditions is such a contrast, or for an outcome without a direction, or
            one that the two values change the meaning of.
    """
    outcome = outcome or primary(data)
    direction = {"higher": 1.0, "lower": -1.0}.get(find_outcome(outcome).better)
    if direction is None:
        raise UserError(f"outcome {outcome}: is neither better high nor better low")
    values = as_tuple(read_field(Run, setting, better)), as_tuple(read_field(Run, setting, worse))
    settings = _settings(data)
    pairs = [
        (one, other)
        for one, other in product(settings, settings)
        if values[0] != values[1]
        and settings[one].get(setting) == values[0]
        and settings[other] == {**settings[one], setting: values[1]}
    ]
    if not pairs:
        differing = _levels(settings)
        known = ", ".join(
            f"{key} ({', '.join(map(shown_level, levels))})" for key, levels in differing.items()
        )
        raise UserError(
            f"study {data.study}: no two conditions differ in {setting} alone, {shown_value(values[0])} in "
            f"one and {shown_value(values[1])} in the other{f'; they differ in {known}' if known else ''}"
        )
    for pair in pairs:
        refuse_unlike_returns(data, outcome, pair)
    factors = _levels({one: settings[one] for one, _ in pairs})
    contrasts = [_contrast(data, *pair, outcome, direction) for pair in pairs]
    corrected = holm([contrast.p_different for contrast in contrasts])
    cells = [
        {
            **{key: shown_value(settings[pair[0]].get(key)) for key in factors},
            "better": pair[0],
            "worse": pair[1],
            "outcome": outcome,
            "value": contrast.effect,
            "low": contrast.interval.low,
            "high": contrast.interval.high,
            "interval": contrast.interval.method,
            "p": float(p),
            "runs": f"{contrast.seeds[0]} and {contrast.seeds[1]}",
            "label": (HOLDS if contrast.effect > 0 else REVERSED) if p <= ALPHA else OPEN,
            "reason": contrast.reason,
        }
        for pair, contrast, p in zip(pairs, contrasts, corrected, strict=True)
    ]
    runs = tuple(count for contrast in contrasts for count in contrast.seeds)
    return Map(setting, values, outcome, tuple(factors), pd.DataFrame(cells), runs)


def _contrast(data: StudyData, better: str, worse: str, outcome: str, direction: float) -> Contrast:
    """Compare two conditions. A run without a value leaves them open, as the others may look too good."""
    a, b = (direction * _values(data, name, outcome) for name in (better, worse))
    blank = int(np.isnan(a).sum() + np.isnan(b).sum())
    if blank:
        return Contrast(reason=f"{counted(blank, 'run')} without a value")
    return compare("mean", a, b, None)


# --- Both ------------------------------------------------------------------------------------------


def _settings(data: StudyData) -> dict[str, dict[str, Any]]:
    return {
        name: {key: as_tuple(value) for key, value in fields.items()} for name, fields in data.fields.items()
    }


def _levels(settings: Mapping[str, Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    return {key: (*dict.fromkeys(of_key.values()),) for key, of_key in differing_fields(settings).items()}


def _values(data: StudyData, condition: str, name: str) -> np.ndarray:
    """Return the outcome of each finished run, (runs,); refuse one that is infinite for some run."""
    values = outcome_values(data, condition, name)
    if np.isinf(values).any():
        raise UserError(f"outcome {name}: some runs of {condition} never get there; compare another outcome")
    return values
