"""Crossed studies: what each factor does, and in which cells a contrast holds.

    a study and an outcome → a cell of runs for each combination of levels → effects, Holm-corrected
    a study, a field and two values of it → a pair of conditions for each cell → a robustness map

Factors are the fields in which conditions differ, as they resolved; nobody has to name them. Fields that do
not take every combination of their values vary together, and are one factor of effects. A cell of a map
is a pair of conditions that differ in the contrast's field alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import prod
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.contrasts import Contrast, compare, undecided
from pneuma.analysis.factorial import Effect, factorial
from pneuma.analysis.frames import StudyData, common_step
from pneuma.analysis.outcomes import (
    find_outcome,
    outcome,
    outcome_values,
    primary,
    reason,
    refuse_unlike_returns,
)
from pneuma.analysis.pvalues import holm
from pneuma.config import Run, read_field, stream_seed
from pneuma.errors import UserError, counted
from pneuma.values import as_tuple, shown_level, shown_value

LEVEL = 0.05
"""Error rate over all cells of a map."""

ROBUST, PARTIAL, CONDITIONAL = "robust", "partial", "conditional"
REVERSED, UNDECIDED = "reversed", "undecided"
HOLDS, OPEN = "holds", "open"

Levels = tuple[tuple[str, Any], ...]
Settings = dict[str, dict[str, Any]]
"""Of each condition its fields, but for those in which no two conditions are compared."""


# --- Effects ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Effects:
    """All main effects and two-way interactions of a crossed study.

    Attributes:
        outcome: in what respect.
        means: of each factor, its levels' means, in which each cell counts alike.
        cells: how many combinations of levels there are.
        runs: how many have a value.
        without: how many finished runs have none, and are left out.
        effects: each with its p-value as it is.
        corrected: their p-values, Holm-corrected over all of them.
    """

    study: str
    title: str
    outcome: str
    means: Mapping[str, Mapping[str, float]]
    cells: int
    runs: int
    without: int
    effects: tuple[Effect, ...]
    corrected: tuple[float, ...]


def study_effects(data: StudyData, name: str | None = None) -> Effects:
    """Test every main effect and two-way interaction of the factors that a study crosses.

    Args:
        data: the study.
        name: an outcome; the study's primary one when left out.

    Raises:
        UserError: for a name that is no outcome's, returns of unlike rewards, a study that is not crossed,
            mixed engines, a cell without a run that has the outcome, an endless value, or no more runs than
            the effects take up.
    """
    name = name or primary(data)
    refuse_unlike_returns(data, name)
    factors, levels = find_crossing(data)
    cells = _cells(data, levels, name)  # each with NaN where a run has no value
    known = {cell: own[~np.isnan(own)] for cell, own in cells.items()}
    values = np.concatenate(list(known.values()))  # (runs,)
    whose = [cell for cell, own in known.items() for _ in own]
    columns = {factor: [cell[i] for cell in whose] for i, factor in enumerate(factors)}
    effects = factorial(values, columns, np.random.default_rng(stream_seed("effects", name)))
    if any(effect.degrees[1] < 1 for effect in effects):
        raise UserError(
            f"study {data.study}: {len(values)} runs in {len(known)} cells leave nothing to tell an effect "
            "from chance; run it with more --seeds"
        )
    means = {
        factor: {
            level: float(np.mean([runs.mean() for cell, runs in known.items() if cell[i] == level]))
            for level in own
        }
        for i, (factor, own) in enumerate(factors.items())
    }
    corrected = tuple(map(float, holm([effect.p_value for effect in effects])))
    without = sum(map(len, cells.values())) - len(values)
    counts = len(known), len(values), without
    return Effects(data.study, data.title, name, means, *counts, tuple(effects), corrected)


def effects_table(found: Effects) -> pd.DataFrame:
    """Return effects as a tidy table, a row for each."""
    return pd.DataFrame(
        {
            "effect": " × ".join(effect.factors),
            "levels": " × ".join(str(len(found.means[factor])) for factor in effect.factors),
            "outcome": found.outcome,
            "df": effect.degrees[0],
            "df_error": effect.degrees[1],
            "f": effect.statistic,
            "partial_r2": effect.share,
            "p": effect.p_value,
            "p_holm": corrected,
            "runs": found.runs,
        }
        for effect, corrected in zip(found.effects, found.corrected, strict=True)
    )


def find_crossing(data: StudyData) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Return a study's factors with their levels, and of each condition a level of every factor.

    Conditions without a finished run are included.

    Raises:
        UserError: where engines are mixed, fewer than two factors are crossed, or a combination is missing.
    """
    engines = {str(run.fields.get("engine")): run.condition for run in reversed(data.runs)}
    if len(engines) > 1:
        told = ", ".join(f"{condition} by {engine}" for engine, condition in reversed(engines.items()))
        raise UserError(f"engines are mixed: {told}; choose the runs of one with --engine {[*engines][-1]}")
    shown = {
        condition: {key: shown_value(value) for key, value in own.items() if key != "engine"}
        for condition, own in _settings(data).items()
    }
    groups = _factor_groups(list(shown.values()))
    names = [" + ".join(group) for group in groups]
    levels = {condition: tuple(_level(own, group) for group in groups) for condition, own in shown.items()}
    if len(groups) < 2:
        told = f"its conditions differ in {names[0]} alone" if names else "its conditions do not differ"
        raise UserError(
            f"study {data.study} is not crossed: {told}; take one whose conditions are every "
            "combination of two factors' values ([factors] in its file), and all of them"
        )
    factors = {name: tuple(dict.fromkeys(own[i] for own in levels.values())) for i, name in enumerate(names)}
    missing = next((cell for cell in product(*factors.values()) if cell not in levels.values()), None)
    if missing:
        told = ", ".join(f"{name} {level}" for name, level in zip(factors, missing, strict=True))
        raise UserError(f"study {data.study} is not fully crossed: no condition has {told}; add it")
    return factors, levels


def _factor_groups(settings: Sequence[Mapping[str, str]]) -> list[tuple[str, ...]]:
    """Return the factors: groups of differing fields, each two of which are crossed."""
    keys = dict.fromkeys(key for own in settings for key in own)
    groups: list[tuple[str, ...]] = [(key,) for key in keys if len({own.get(key) for own in settings}) > 1]

    def count(*some: tuple[str, ...]) -> int:
        return len({tuple(_level(own, group) for group in some) for own in settings})

    def is_crossed(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
        return count(one, other) == prod(map(count, (one, other)))

    while pair := next((pair for pair in combinations(groups, 2) if not is_crossed(*pair)), None):
        groups[groups.index(pair[0])] = pair[0] + pair[1]
        groups.remove(pair[1])
    return groups


def _level(own: Mapping[str, str], group: Sequence[str]) -> str:
    return " + ".join(own.get(key, "none") for key in group)


def _cells(
    data: StudyData, levels: Mapping[str, tuple[str, ...]], name: str
) -> dict[tuple[str, ...], np.ndarray]:
    """Return the values of every cell, (runs,); a run that two conditions share counts once."""
    at_step = common_step(data)
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for condition, cell in levels.items():
        runs = data.of_condition(condition)
        own = {run.run_id: outcome(data, run, name, at_step) for run in runs}
        if not runs:
            raise UserError(
                f"study {data.study}: no run of {condition} has finished, and every cell needs one: "
                f"{data.how_to_train}"
            )
        if all(map(np.isnan, own.values())):
            raise UserError(
                f"outcome {name}: no run of {condition} has it, and every cell needs one: "
                f"{reason(data, runs[0], name, at_step)}; compare another outcome"
            )
        _refuse_endless(list(own.values()), name, condition)
        found.setdefault(cell, {}).update(own)
    return {cell: np.array(list(own.values())) for cell, own in found.items()}


# --- The robustness map ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """One combination of the factors' levels.

    Attributes:
        levels: factor and level, in the factors' order.
        better, worse: conditions: the one that is claimed to do better, and the other.
        contrast: of the two, the first less the second, turned so that above 0 is as claimed.
        p: Holm-corrected over the map, two-sided.
        label: holds, reversed or open.
    """

    levels: Levels
    better: str
    worse: str
    contrast: Contrast
    p: float
    label: str


@dataclass(frozen=True)
class Map:
    """A contrast over all its cells.

    Attributes:
        setting: what the two conditions of a cell differ in.
        values: of the claimed better, and of the other.
        outcome: by what they are judged.
        factors: what the cells differ in, with their levels.
        cells: in the study's order.
        label: robust where every cell holds; conditional where some hold and some are reversed; partial where
            some hold and the others are open, for few seeds show no condition; reversed where some are
            reversed and none holds; else undecided.
    """

    study: str
    title: str
    setting: str
    values: tuple[Any, Any]
    outcome: str
    factors: Mapping[str, tuple[Any, ...]]
    cells: tuple[Cell, ...]
    label: str


def robustness_map(
    data: StudyData, setting: str, better: object, worse: object, outcome: str | None = None
) -> Map:
    """Map a contrast over every pair of a study's conditions that differ in one field alone.

    Args:
        data: the study.
        setting: a field of the run.
        better: its value that is claimed to do better.
        worse: the other.
        outcome: one that has a better direction; the study's primary one when left out.

    Raises:
        UserError: for one value twice, where no pair of conditions is such a contrast, or for an outcome
            without a direction, or in which the two values do not compare.
    """
    outcome = outcome or primary(data)
    direction = {"higher": 1.0, "lower": -1.0}.get(find_outcome(outcome).better)
    if direction is None:
        raise UserError(f"outcome {outcome}: is neither better high nor better low")
    values = as_tuple(read_field(Run, setting, better)), as_tuple(read_field(Run, setting, worse))
    pairs = _pairs(data, setting, *values)
    for one, other, _ in pairs:
        refuse_unlike_returns(data, outcome, (one, other))
    factors = _differing([settings for _, _, settings in pairs])
    contrasts = [_contrast(data, one, other, outcome, direction) for one, other, _ in pairs]
    corrected = holm([contrast.p_different for contrast in contrasts])
    cells = []
    for (one, other, settings), contrast, p in zip(pairs, contrasts, map(float, corrected), strict=True):
        levels = tuple((key, settings.get(key)) for key in factors)
        cells.append(Cell(levels, one, other, contrast, p, _cell_label(contrast, p)))
    return Map(data.study, data.title, setting, values, outcome, factors, tuple(cells), _label(cells))


def map_table(found: Map) -> pd.DataFrame:
    """Return a map as a tidy table, a row for each cell."""
    return pd.DataFrame(
        {
            **{key: shown_value(level) for key, level in cell.levels},
            "better": cell.better,
            "worse": cell.worse,
            "outcome": found.outcome,
            "value": cell.contrast.effect,
            "low": cell.contrast.interval.low,
            "high": cell.contrast.interval.high,
            "interval": cell.contrast.interval.method,
            "p": cell.p,
            "runs": f"{cell.contrast.seeds[0]} and {cell.contrast.seeds[1]}",
            "label": cell.label,
            "reason": cell.contrast.reason,
        }
        for cell in found.cells
    )


def _pairs(
    data: StudyData, setting: str, better: object, worse: object
) -> list[tuple[str, str, dict[str, Any]]]:
    """Return the conditions of every cell, and the fields that both have.

    Raises:
        UserError: for one value twice, or where there is no such pair.
    """
    told = shown_value(better), shown_value(worse)
    if better == worse:
        raise UserError(f"{setting}: {told[0]} against itself is no contrast; name two values")
    settings = _settings(data)
    differing = _differing([dict(own) for own in settings.values()])
    arms: dict[object, dict[str, list[str]]] = {better: {}, worse: {}}
    for name, own in settings.items():
        value = own.pop(setting, None)
        if value in arms:
            arms[value].setdefault(json.dumps(own, sort_keys=True, default=str), []).append(name)
    pairs = [
        (one, other, settings[one])
        for cell, names in arms[better].items()
        for one in names
        for other in arms[worse].get(cell, ())
    ]
    if not pairs:
        known = ", ".join(f"{key} ({', '.join(map(shown_level, own))})" for key, own in differing.items())
        raise UserError(
            f"study {data.study}: no two conditions differ in {setting} alone, {told[0]} in one and "
            f"{told[1]} in the other{f'; they differ in {known}' if known else ''}"
        )
    return pairs


def _settings(data: StudyData) -> Settings:
    """Return the fields of every condition, of those without a finished run too; lists as tuples."""
    found: Settings = {}
    for run in data.record["runs"]:
        if run["condition"] not in found:
            own = {key: as_tuple(value) for key, value in run["run"].items() if key not in ("seed", "steps")}
            found[run["condition"]] = own
    return found


def _differing(settings: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Return every field of the first in which some differ, with its values in the study's order."""
    levels = {key: tuple(dict.fromkeys(own.get(key) for own in settings)) for key in settings[0]}
    return {key: values for key, values in levels.items() if len(values) > 1}


def _contrast(data: StudyData, better: str, worse: str, outcome: str, direction: float) -> Contrast:
    """Compare two conditions; a run without a value leaves them open, as the others may look too good."""
    at_step = common_step(data)
    a, b = (direction * outcome_values(data, name, outcome, at_step) for name in (better, worse))
    _refuse_endless(a, outcome, better)
    _refuse_endless(b, outcome, worse)
    blank = int(np.isnan(a).sum() + np.isnan(b).sum())
    if blank:
        return undecided("mean", f"{counted(blank, 'run')} without a value", (a.size, b.size))
    return compare("mean", a, b, None, np.random.default_rng(stream_seed("robustness", better)))


def _refuse_endless(values: Sequence[float] | np.ndarray, name: str, condition: str) -> None:
    """Refuse values of which some are endless: without them the others would look too good."""
    if np.isinf(values).any():
        raise UserError(f"outcome {name}: some runs of {condition} never get there; compare another outcome")


def _cell_label(contrast: Contrast, p: float) -> str:
    if p > LEVEL or not np.isfinite(contrast.effect):
        return OPEN
    return HOLDS if contrast.effect > 0 else REVERSED


def _label(cells: Sequence[Cell]) -> str:
    labels = {cell.label for cell in cells}
    if HOLDS in labels:
        return ROBUST if labels == {HOLDS} else CONDITIONAL if REVERSED in labels else PARTIAL
    return REVERSED if REVERSED in labels else UNDECIDED
