"""The robustness map: does a contrast hold whatever else is set?

    a study of crossed factors, a setting and two values of it → a cell for each combination → a label

A cell is a pair of conditions that differ in that setting alone, as they resolved. What the cells differ
in are the map's factors; nobody has to name them. Each cell is tested by itself, Holm-corrected over the
map; one that lacks an arm's runs, or the value of some, is open. The map is *robust* where every cell
holds, *conditional* where some hold and some are reversed, *partial* where some hold and the others are
open, for few seeds show no condition; *reversed* where some are reversed and none holds, and *undecided*
where no cell can be told from no difference.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.contrasts import Contrast, compare, undecided
from pneuma.analysis.corrections import holm
from pneuma.analysis.crossing import condition_settings
from pneuma.analysis.outcomes import PRIMARY, find_outcome, outcome_values
from pneuma.analysis.references import refuse_unlike_returns
from pneuma.analysis.run_view import common_step
from pneuma.analysis.tables import StudyData
from pneuma.config import Run, read_field, stream_seed
from pneuma.errors import UserError, counted
from pneuma.values import as_tuple, shown_level, shown_value

LEVEL = 0.05
"""Error rate over all cells of a map."""

ROBUST, PARTIAL, CONDITIONAL = "robust", "partial", "conditional"
REVERSED, UNDECIDED = "reversed", "undecided"
HOLDS, OPEN = "holds", "open"

Levels = tuple[tuple[str, Any], ...]


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
        label: robust, partial, conditional, reversed or undecided.
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
    data: StudyData, setting: str, better: object, worse: object, outcome: str = PRIMARY
) -> Map:
    """Map a contrast over every pair of a study's conditions that differ in one setting alone.

    Args:
        data: the study.
        setting: a field of the run.
        better: its value that is claimed to do better.
        worse: the other.
        outcome: one that has a better direction.

    Raises:
        UserError: for one value twice, where no pair of conditions is such a contrast, or for an outcome
            without a direction, or in which the two values do not compare.
    """
    direction = {"higher": 1.0, "lower": -1.0}.get(find_outcome(outcome).better)
    if direction is None:
        raise UserError(f"outcome {outcome}: is neither better high nor better low")
    values = as_tuple(read_field(Run, setting, better)), as_tuple(read_field(Run, setting, worse))
    if values[0] == values[1]:
        raise UserError(f"{setting}: {shown_value(values[0])} against itself is no contrast; name two values")
    pairs = _pairs(data, setting, *values)
    if not pairs:
        raise UserError(
            f"study {data.study}: no two conditions differ in {setting} alone, "
            f"{shown_value(values[0])} in one and {shown_value(values[1])} in the other"
            + _told_differences(data)
        )
    for one, other, _ in pairs:
        refuse_unlike_returns(data, outcome, (one, other))
    factors = _factors([settings for _, _, settings in pairs])
    at_step = common_step(data)
    values_of = {
        name: direction * _values(data, name, outcome, at_step) for pair in pairs for name in pair[:2]
    }
    contrasts = [_contrast(values_of[one], values_of[other], one) for one, other, _ in pairs]
    corrected = holm([contrast.p_different for contrast in contrasts])
    cells = tuple(
        Cell(
            tuple((key, settings.get(key)) for key in factors),
            one,
            other,
            contrast,
            float(p),
            _cell_label(contrast, p),
        )
        for (one, other, settings), contrast, p in zip(pairs, contrasts, corrected, strict=True)
    )
    return Map(data.study, data.title, setting, values, outcome, factors, cells, _label(cells))


def map_table(found: Map) -> pd.DataFrame:
    """Return a map as a tidy table, a row for each cell."""
    rows = []
    for cell in found.cells:
        contrast = cell.contrast
        rows.append(
            {
                **{key: shown_value(level) for key, level in cell.levels},
                "better": cell.better,
                "worse": cell.worse,
                "outcome": found.outcome,
                "value": contrast.effect,
                "low": contrast.interval.low,
                "high": contrast.interval.high,
                "interval": contrast.interval.method,
                "p": cell.p,
                "runs": f"{contrast.seeds[0]} and {contrast.seeds[1]}",
                "label": cell.label,
                "reason": contrast.reason,
            }
        )
    return pd.DataFrame(rows)


# --- Cells -----------------------------------------------------------------------------------------

_NOT_COMPARED = ("seed", "steps")


def _pairs(
    data: StudyData, setting: str, better: object, worse: object
) -> list[tuple[str, str, dict[str, Any]]]:
    """Return the conditions of every cell, and the settings that both have."""
    settings = _settings(data)
    arms: dict[object, dict[str, list[str]]] = {better: {}, worse: {}}
    for name, own in settings.items():
        value = own.pop(setting, None)
        if value in arms:
            arms[value].setdefault(json.dumps(own, sort_keys=True, default=str), []).append(name)
    return [
        (one, other, settings[one])
        for cell, names in arms[better].items()
        for one in names
        for other in arms[worse].get(cell, ())
    ]


def _settings(data: StudyData) -> dict[str, dict[str, Any]]:
    return {
        condition: {key: value for key, value in own.items() if key not in _NOT_COMPARED}
        for condition, own in condition_settings(data).items()
    }


def _factors(settings: Sequence[Mapping[str, Any]]) -> dict[str, tuple[Any, ...]]:
    """Return every setting in which cells differ, with its levels in the study's order."""
    levels = {key: tuple(dict.fromkeys(own.get(key) for own in settings)) for key in settings[0]}
    return {key: values for key, values in levels.items() if len(values) > 1}


def _told_differences(data: StudyData) -> str:
    """Say in which settings a study's conditions do differ, and in what values."""
    levels = _factors([*_settings(data).values()])
    told = [f"{key} ({', '.join(map(shown_level, values))})" for key, values in levels.items()]
    return f"; they differ in {', '.join(told)}" if levels else ""


def _values(data: StudyData, condition: str, outcome: str, at_step: float | None) -> np.ndarray:
    """Return the values of a condition's finished runs, (runs,), NaN of a run that has none.

    Raises:
        UserError: where a run's is endless: without it the others would look too good.
    """
    values = outcome_values(data, condition, outcome, at_step)
    if np.isinf(values).any():
        raise UserError(
            f"outcome {outcome}: some runs of {condition} never get there; compare another outcome"
        )
    return values


def _contrast(better: np.ndarray, worse: np.ndarray, name: str) -> Contrast:
    """Compare two arms; a run without a value leaves it open, for without it the others may look too good."""
    blank = int(np.isnan(better).sum() + np.isnan(worse).sum())
    if blank:
        return undecided("mean", f"{counted(blank, 'run')} without a value", (better.size, worse.size))
    generator = np.random.default_rng(stream_seed("robustness", name))
    return compare("mean", better, worse, None, generator)


def _cell_label(contrast: Contrast, p: float) -> str:
    if p > LEVEL or not np.isfinite(contrast.effect):
        return OPEN
    return HOLDS if contrast.effect > 0 else REVERSED


def _label(cells: Sequence[Cell]) -> str:
    labels = {cell.label for cell in cells}
    if HOLDS in labels:
        return ROBUST if labels == {HOLDS} else CONDITIONAL if REVERSED in labels else PARTIAL
    return REVERSED if REVERSED in labels else UNDECIDED
