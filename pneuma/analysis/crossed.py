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
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import linalg

from pneuma.analysis.contrasts import Contrast, compare, undecided
from pneuma.analysis.frames import StudyData, common_step
from pneuma.analysis.intervals import finite
from pneuma.analysis.outcomes import find_outcome, outcome_values, primary, refuse_unlike_returns
from pneuma.analysis.pvalues import holm
from pneuma.config import Run, stream_seed
from pneuma.env_fields import read_field
from pneuma.errors import UserError, counted
from pneuma.values import as_tuple, shown_level, shown_value

DRAWS = 5_000
"""Permutations per test of an effect."""
LEVEL = 0.05
"""Error rate over all cells of a map."""
HOLDS, REVERSED, OPEN = "holds", "reversed", "open"


# --- Effects ---------------------------------------------------------------------------------------


class Effect(NamedTuple):
    """A main effect of one factor, or an interaction of two.

    Attributes:
        degrees: of freedom, of the effect and of the errors.
        statistic: its F; inf without errors.
        p_value: by permutation; NaN if the design cannot separate it from other effects.
        share: of the variance that the other effects leave (partial R²).
    """

    factors: tuple[str, ...]
    degrees: tuple[int, int]
    statistic: float
    p_value: float
    share: float


@dataclass(frozen=True)
class Effects:
    """All main effects and two-way interactions of a crossed study.

    Attributes:
        means: the means of each factor's levels, with equal weight for each cell.
        cells: number of combinations of levels.
        runs: number of runs with a value of the outcome.
        without: number of finished runs without one, which are left out.
    """

    outcome: str
    means: Mapping[str, Mapping[str, float]]
    cells: int
    runs: int
    without: int
    effects: Sequence[Effect]

    def table(self) -> pd.DataFrame:
        """Return one row per effect, with its p-value also corrected over all effects by Holm's method."""
        corrected = holm([effect.p_value for effect in self.effects])
        return pd.DataFrame(
            {
                "effect": " × ".join(effect.factors),
                "levels": " × ".join(str(len(self.means[factor])) for factor in effect.factors),
                "outcome": self.outcome,
                "df": effect.degrees[0],
                "df_error": effect.degrees[1],
                "f": effect.statistic,
                "partial_r2": effect.share,
                "p": effect.p_value,
                "p_holm": p,
                "runs": self.runs,
            }
            for effect, p in zip(self.effects, corrected, strict=True)
        )


def study_effects(data: StudyData, name: str | None = None) -> Effects:
    """Test all main effects and two-way interactions of a crossed study's factors.

    Raises:
        UserError: for an unknown outcome, returns of different rewards, a study that is not crossed, a cell
            without a run that has the outcome, or too few runs.
    """
    name = name or primary(data)
    refuse_unlike_returns(data, name)
    factors, levels = find_crossing(data)
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for condition, cell in levels.items():  # a run that two conditions share counts once
        ids = [run.run_id for run in data.of_condition(condition)]
        found.setdefault(cell, {}).update(zip(ids, _values(data, condition, name), strict=True))
    every = [(cell, value) for cell, outcomes in found.items() for value in outcomes.values()]
    known = [(cell, value) for cell, value in every if not np.isnan(value)]
    means_of = {cell: [value for of, value in known if of == cell] for cell in found}
    if empty := next((cell for cell, outcomes in means_of.items() if not outcomes), None):
        raise UserError(f"outcome {name}: no finished run of {', '.join(empty)} has it; every cell needs one")
    columns = {factor: [cell[i] for cell, _ in known] for i, factor in enumerate(factors)}
    generator = np.random.default_rng(stream_seed("effects", name))
    effects = factorial([value for _, value in known], columns, generator)
    if any(effect.degrees[1] < 1 for effect in effects):
        raise UserError(
            f"study {data.study}: {len(known)} runs in {len(found)} cells leave nothing to tell an effect "
            "from chance; run it with more --seeds"
        )
    cells = {cell: float(np.mean(outcomes)) for cell, outcomes in means_of.items()}
    means = {
        factor: {
            level: float(np.mean([cells[cell] for cell in cells if cell[i] == level])) for level in levels
        }
        for i, (factor, levels) in enumerate(factors.items())
    }
    return Effects(name, means, len(cells), len(known), len(every) - len(known), effects)


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

    groups: list[tuple[str, ...]] = [(key,) for key in _differing([*settings.values()])]
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
) -> list[Effect]:
    """Return all main effects and two-way interactions.

    Each effect is tested with the others in the model, by permuting the residuals of the model without it
    (Freedman and Lane 1983). The test is exact if there are no other effects, and close otherwise. Levels are
    coded as deviations from their mean, so that a main effect is the average over the other factors' levels
    with equal weights, however many runs each cell has.

    Args:
        values: (runs,) finite numbers.
        factors: by name, the (runs,) levels of each run; balanced or not.
        generator: draws the permutations.
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
    found = []
    for names, columns in coded.items():
        others = np.hstack([constant, *(each for term, each in coded.items() if term != names)])
        found.append(Effect(names, *_test(runs, others, columns, shuffles)))
    return found


def _deviations(levels: Sequence[str]) -> np.ndarray:
    """Return the sum-to-zero coding of a factor, (runs, levels - 1)."""
    names, index = np.unique(np.asarray(levels), return_inverse=True)
    return np.vstack([np.eye(names.size - 1), -np.ones(names.size - 1)])[index]


def _test(
    runs: np.ndarray, others: np.ndarray, columns: np.ndarray, shuffles: np.ndarray
) -> tuple[tuple[int, int], float, float, float]:
    """Return degrees of freedom, F, p-value and partial R² of an effect's columns, given the others."""
    reduced, full = (linalg.orth(each, rcond=1e-9) for each in (others, np.hstack([others, columns])))
    gained, left = full.shape[1] - reduced.shape[1], runs.size - full.shape[1]
    degrees = columns.shape[1], left
    if gained < columns.shape[1] or left < 1:
        return degrees, np.nan, np.nan, np.nan
    residuals = runs - reduced @ (reduced.T @ runs)
    if np.abs(residuals).max() <= 1e-12 * max(1.0, np.abs(runs).max()):
        return degrees, np.nan, 1.0, np.nan
    # The fitted part lies in both models, so it does not change their residuals.
    samples = np.vstack([residuals, residuals[shuffles]])  # (1 + draws, runs)
    tiny = 1e-12 * (residuals**2).sum()
    before = (samples**2).sum(axis=1) - ((samples @ reduced) ** 2).sum(axis=1)
    after = np.maximum((samples**2).sum(axis=1) - ((samples @ full) ** 2).sum(axis=1), tiny)
    taken = np.where(before - after > tiny, before - after, 0.0)  # rounding is not counted
    statistic = taken / gained / (after / left)
    p_value = float((statistic >= statistic[0] * (1 - 1e-9)).mean())
    return degrees, float(statistic[0]) if after[0] > tiny else np.inf, p_value, float(taken[0] / before[0])


# --- The robustness map ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """One combination of the factors' levels.

    Attributes:
        levels: of every field in which the cells differ.
        better, worse: the condition that is claimed to do better, and the other one.
        contrast: the first minus the second, with the sign such that above 0 is as claimed.
        p: Holm-corrected over the map, two-sided.
    """

    levels: Mapping[str, Any]
    better: str
    worse: str
    contrast: Contrast
    p: float

    @property
    def label(self) -> str:
        """'holds', 'reversed' or 'open'."""
        if self.p > LEVEL or not np.isfinite(self.contrast.effect):
            return OPEN
        return HOLDS if self.contrast.effect > 0 else REVERSED


@dataclass(frozen=True)
class Map:
    """A contrast in all its cells, in the study's order.

    Attributes:
        setting: the field in which the two conditions of a cell differ.
        values: the value that is claimed to be better, and the other one.
        outcome: by which they are compared.
    """

    setting: str
    values: tuple[Any, Any]
    outcome: str
    cells: Sequence[Cell]

    @property
    def label(self) -> str:
        """The label of the whole map.

        Robust if every cell holds; conditional if some hold and some are reversed; partial if some hold and
        the others are open; reversed if some are reversed and none holds; otherwise undecided.
        """
        labels = {cell.label for cell in self.cells}
        if HOLDS in labels:
            return "robust" if labels == {HOLDS} else "conditional" if REVERSED in labels else "partial"
        return "reversed" if REVERSED in labels else "undecided"

    def table(self) -> pd.DataFrame:
        """Return one row per cell."""
        return pd.DataFrame(
            {
                **{key: shown_value(level) for key, level in cell.levels.items()},
                "better": cell.better,
                "worse": cell.worse,
                "outcome": self.outcome,
                "value": cell.contrast.effect,
                "low": cell.contrast.interval.low,
                "high": cell.contrast.interval.high,
                "interval": cell.contrast.interval.method,
                "p": cell.p,
                "runs": f"{cell.contrast.seeds[0]} and {cell.contrast.seeds[1]}",
                "label": cell.label,
                "reason": cell.contrast.reason,
            }
            for cell in self.cells
        )


def robustness_map(
    data: StudyData, setting: str, better: object, worse: object, outcome: str | None = None
) -> Map:
    """Map a contrast over all pairs of conditions that differ in a single field.

    Args:
        data: the study.
        setting: a field of the run.
        better: its value that is claimed to do better.
        worse: the other.
        outcome: one that has a better direction; default: the study's primary one.

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
        differing = _differing([*settings.values()])
        known = ", ".join(
            f"{key} ({', '.join(map(shown_level, levels))})" for key, levels in differing.items()
        )
        raise UserError(
            f"study {data.study}: no two conditions differ in {setting} alone, {shown_value(values[0])} in "
            f"one and {shown_value(values[1])} in the other{f'; they differ in {known}' if known else ''}"
        )
    for pair in pairs:
        refuse_unlike_returns(data, outcome, pair)
    factors = _differing([settings[one] for one, _ in pairs])
    contrasts = [_contrast(data, *pair, outcome, direction) for pair in pairs]
    corrected = map(float, holm([contrast.p_different for contrast in contrasts]))
    cells = [
        Cell({key: settings[pair[0]].get(key) for key in factors}, *pair, contrast, p)
        for pair, contrast, p in zip(pairs, contrasts, corrected, strict=True)
    ]
    return Map(setting, values, outcome, cells)


def _contrast(data: StudyData, better: str, worse: str, outcome: str, direction: float) -> Contrast:
    """Compare two conditions. A run without a value leaves them open, as the others may look too good."""
    a, b = (direction * _values(data, name, outcome) for name in (better, worse))
    blank = int(np.isnan(a).sum() + np.isnan(b).sum())
    if blank:
        return undecided("mean", f"{counted(blank, 'run')} without a value", (a.size, b.size))
    return compare("mean", a, b, None, np.random.default_rng(stream_seed("robustness", better)))


# --- Both ------------------------------------------------------------------------------------------


def _settings(data: StudyData) -> dict[str, dict[str, Any]]:
    """Return the fields of all conditions, including those without a finished run; lists as tuples."""
    found: dict[str, dict[str, Any]] = {}
    for run in data.record["runs"]:
        if run["condition"] not in found:
            fields = {
                key: as_tuple(value) for key, value in run["run"].items() if key not in ("seed", "steps")
            }
            found[run["condition"]] = fields
    return found


def _differing(settings: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Return the fields in which conditions differ, with their values in the study's order."""
    keys = dict.fromkeys(key for fields in settings for key in fields)
    levels = {key: tuple(dict.fromkeys(fields.get(key) for fields in settings)) for key in keys}
    return {key: values for key, values in levels.items() if len(values) > 1}


def _values(data: StudyData, condition: str, name: str) -> np.ndarray:
    """Return the outcome of each finished run, (runs,); refuse one that is infinite for some run."""
    values = outcome_values(data, condition, name, common_step(data))
    if np.isinf(values).any():
        raise UserError(f"outcome {name}: some runs of {condition} never get there; compare another outcome")
    return values
