"""What each factor of a crossed study does, and what each two of them do together.

a crossed study and an outcome → a cell of runs for each combination → effects, Holm-corrected over all
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneuma.analysis.corrections import holm
from pneuma.analysis.crossing import Crossing, find_crossing
from pneuma.analysis.factorial import Effect, factorial
from pneuma.analysis.outcomes import PRIMARY, find_outcome, outcome, reason
from pneuma.analysis.references import refuse_unlike_returns
from pneuma.analysis.run_view import common_step
from pneuma.analysis.tables import StudyData
from pneuma.config import stream_seed
from pneuma.errors import UserError

Cells = Mapping[tuple[str, ...], np.ndarray]
"""Levels, one of every factor, to the values of the runs that have them, (runs,)."""


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


def study_effects(data: StudyData, name: str = PRIMARY) -> Effects:
    """Test every main effect and two-way interaction of the factors that a study crosses.

    Args:
        data: the study.
        name: an outcome.

    Raises:
        UserError: for a name that is no outcome's, returns of unlike rewards, a study that is not crossed,
            mixed engines, a cell without a run that has the outcome, an endless value, or no more runs than
            the effects take up.
    """
    find_outcome(name)
    refuse_unlike_returns(data, name)
    crossing = find_crossing(data)
    cells, without = _cells(data, crossing, name)
    values = np.concatenate(list(cells.values()))  # (runs,)
    levels = [cell for cell, own in cells.items() for _ in own]
    factors = {factor: [cell[i] for cell in levels] for i, factor in enumerate(crossing.factors)}
    effects = factorial(values, factors, np.random.default_rng(stream_seed("effects", name)))
    if any(effect.degrees[1] < 1 for effect in effects):
        raise UserError(
            f"study {data.study}: {len(values)} runs in {len(cells)} cells leave nothing to tell an effect "
            "from chance; run it with more --seeds"
        )
    corrected = tuple(map(float, holm([effect.p_value for effect in effects])))
    counts = len(cells), len(values), without
    means = _means(cells, crossing)
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


def _cells(data: StudyData, crossing: Crossing, name: str) -> tuple[Cells, int]:
    """Return the values of every cell, and how many runs have none; what two conditions share, once."""
    at_step = common_step(data)
    found: dict[tuple[str, ...], dict[str, float]] = {}
    for condition, cell in crossing.levels.items():
        own = {run.run_id: outcome(data, run, name, at_step) for run in data.of_condition(condition)}
        if any(map(np.isinf, own.values())):
            raise UserError(
                f"outcome {name}: some runs of {condition} never get there; compare another outcome"
            )
        if all(map(np.isnan, own.values())):
            raise _empty(data, condition, name, at_step)
        found.setdefault(cell, {}).update(own)
    values = {cell: np.array(list(own.values())) for cell, own in found.items()}
    without = sum(int(np.isnan(own).sum()) for own in values.values())
    return {cell: own[~np.isnan(own)] for cell, own in values.items()}, without


def _empty(data: StudyData, condition: str, name: str, at_step: int | None) -> UserError:
    runs = data.of_condition(condition)
    if not runs:
        return UserError(
            f"study {data.study}: no run of {condition} has finished, and every cell needs one: "
            f"{data.how_to_train}"
        )
    return UserError(
        f"outcome {name}: no run of {condition} has it, and every cell needs one: "
        f"{reason(data, runs[0], name, at_step)}; compare another outcome"
    )


def _means(cells: Cells, crossing: Crossing) -> dict[str, dict[str, float]]:
    return {
        factor: {
            level: float(np.mean([own.mean() for cell, own in cells.items() if cell[i] == level]))
            for level in levels
        }
        for i, (factor, levels) in enumerate(crossing.factors.items())
    }
