"""What two factors of a crossed study do: the mean at each pair of levels, main effects, interactions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.cells import with_cells
from pneuma.analysis.claims import contrasts
from pneuma.analysis.drawing import drawing_of
from pneuma.analysis.environments import columns_of
from pneuma.analysis.intervals import LEAST_RUNS, Groups, no_interval, within
from pneuma.analysis.notes import notes_on_ends, notes_on_outcomes
from pneuma.analysis.outcomes import find_outcome, kinds_of_return, outcome_values, primary, with_unit
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import refuse_different_returns
from pneuma.errors import Hint, UserError, unknown_name
from pneuma.study.spec import CONDITION

LEGEND = (
    "Means, then main effects and interactions: differences of means, each with its own 95 % interval",
    "(Welch). A main effect is over all levels of the other factors, which count alike.",
)
Rows = list[dict[str, Any]]


def factors_of(study_data: StudyData) -> list[str]:
    """Return the factors of a crossed study in which its conditions differ."""
    names: dict[str, set[str]] = {}
    for condition in study_data.conditions:
        for factor, level in study_data.study.levels.get(condition, {}).items():
            names.setdefault(factor, set()).add(level)
    return [factor for factor, levels in names.items() if len(levels) > 1]


def compare_factors(study_data: StudyData, a: str, b: str, outcomes: Sequence[str] = ()) -> Answer:
    """Return what two factors of a crossed study do to outcomes, in each of its environments.

    Args:
        study_data: an opened study.
        a: a factor, or `condition`.
        b: another one.
        outcomes: names from docs/outcomes.md; default: the study's, or its primary one.

    Returns:
        The table `means` has a row for each pair of levels. `effects` has the main effect of each level
        against the baseline's, and each interaction: by how much such a difference changes with the other
        factor's level.

    Raises:
        UserError: for an unknown factor, or a condition without a value.
    """
    mean_rows: Rows = []
    effect_rows: Rows = []
    outcome_names: list[str] = []
    notes = notes_on_ends(study_data)
    for environment, env_data in columns_of(study_data).items():
        factors = factors_of(env_data)
        for factor in (a, b):
            if factor not in factors:
                raise unknown_name(f"factor of study {study_data.study.name}", factor, factors)
        others = [factor for factor in factors if factor not in (a, b)]
        if others:
            notes.append(f"Averaged over {' and '.join(map(_words, others))}.")
        outcome_names = list(outcomes or env_data.study.outcomes or [primary(env_data)])
        for outcome in outcome_names:
            means, effects = _effects(env_data, a, b, outcome)
            shared = {"environment": environment, "outcome": outcome}
            mean_rows += [{**shared, **row} for row in means]
            effect_rows += [{**shared, **row} for row in effects]
    means_table, effects_table = with_cells(pd.DataFrame(mean_rows)), with_cells(pd.DataFrame(effect_rows))
    if effects_table["low"].isna().any():
        notes.append(f"A condition with fewer than {LEAST_RUNS} runs has no interval.")
    pivoted = means_table.pivot(
        index=["environment", "outcome", "level_a"], columns="level_b", values="cell"
    ).reindex(pd.MultiIndex.from_frame(means_table[["environment", "outcome", "level_a"]].drop_duplicates()))
    pivoted = pivoted[means_table["level_b"].unique()].rename(columns=partial(level_label, study_data, b))
    cells = pivoted.rename_axis(columns=None).reset_index().rename(columns={"level_a": _words(a)})
    cells[_words(a)] = cells[_words(a)].map(partial(level_label, study_data, a))
    effect_cells = effects_table[["environment", "outcome", "effect", "cell", "runs"]]
    effect_cells = effect_cells.rename(columns={"cell": "difference"})
    levels = [
        (factor, level)
        for factor, column in ((a, "level_a"), (b, "level_b"))
        for level in means_table[column].unique()
    ]
    level_rows = [(factor, level, level_label(study_data, factor, level)) for factor, level in levels]
    return Answer(
        title=f"{study_data.full_title}: {_words(a)} and {_words(b)}",
        about={**study_data.about, "a": a, "b": b},
        tables={"means": means_table.drop(columns="cell"), "effects": effects_table.drop(columns="cell")},
        cells=[_plain(cells), _plain(effect_cells)],
        notes=list(dict.fromkeys(notes + notes_on_outcomes(study_data, outcome_names))),
        legend=LEGEND,
        drawing=drawing_of(
            {"": study_data},
            "factors",
            a,
            b,
            levels=pd.DataFrame(level_rows, columns=["factor", "level", "label"]),
        ),
    )


def level_label(study_data: StudyData, factor: str, level: str) -> str:
    """Return what a level is called by the study's file, or its factor and value."""
    label = study_data.labelled(level, factor)
    is_named = factor == CONDITION or level in study_data.study.factors.get(factor, {})
    return label if is_named or label != level else f"{_words(factor)} {level}"


def _words(factor: str) -> str:
    return factor.replace("_", " ")


def _plain(cells: pd.DataFrame) -> pd.DataFrame:
    """Return cells without the columns that are the same in all rows, and with outcomes' units."""
    if (cells["environment"] == "").all():
        cells = cells.drop(columns="environment")
    return cells.assign(outcome=cells["outcome"].map(with_unit))


def _effects(study_data: StudyData, a: str, b: str, outcome: str) -> tuple[Rows, Rows]:
    """Return the means at each pair of levels, and the effects."""
    declared, levels = find_outcome(outcome), study_data.study.levels
    refuse_different_returns(kinds_of_return(study_data), outcome)
    values: dict[str, np.ndarray] = {}
    for condition in study_data.conditions:
        run_values = outcome_values(study_data, condition, outcome)
        values[condition] = run_values[~np.isnan(run_values)]
        if not values[condition].size or not np.isfinite(values[condition]).all():
            raise UserError(f"{condition}: has no mean {outcome} ({study_data.label})")
    fewest_runs = min(runs.size for runs in values.values())
    width = declared.bounds[1] - declared.bounds[0]

    def at(level_a: str = "", level_b: str = "") -> dict[str, np.ndarray]:
        """Return the runs of the conditions at a level of a, of b, or of both."""
        groups = {}
        for condition, runs in values.items():
            if level_a in ("", levels[condition][a]) and level_b in ("", levels[condition][b]):
                groups[condition] = runs
        if not groups:
            text = f"no condition has {a} {level_a} and {b} {level_b} ({study_data.label}): choose some with "
            raise UserError(text, Hint("conditions"), " that have every pair of levels")
        return groups

    def estimate(plus: Groups, minus: Groups, weight: int = 1) -> dict[str, Any]:
        """Return the mean of some groups minus that of others, so many times."""
        contrast = contrasts.compare("main-effect", plus, minus, bounds=declared.bounds)
        limits = (-weight * width, weight * width) if minus else declared.bounds
        interval = no_interval()
        if fewest_runs >= LEAST_RUNS:
            scaled = replace(
                contrast.interval, low=weight * contrast.interval.low, high=weight * contrast.interval.high
            )
            interval = within(scaled, *limits)
        runs = sum(group.size for group in {**plus, **minus}.values())
        return {"value": weight * contrast.effect, "low": interval.low, "high": interval.high, "runs": runs}

    base: Mapping[str, str] = levels.get(study_data.study.baseline) or next(iter(levels.values()))
    names_a = list(dict.fromkeys(levels[condition][a] for condition in values))
    names_b = list(dict.fromkeys(levels[condition][b] for condition in values))
    other_levels = []
    for x, y in product(names_a, names_b):
        pair_levels = [{**levels[condition], a: "", b: ""} for condition in at(x, y)]
        other_levels.append(sorted(map(sorted, (pair.items() for pair in pair_levels))))
    if any(pair_levels != other_levels[0] for pair_levels in other_levels):
        text = (
            f"the pairs of {a} and {b} have different levels of other factors ({study_data.label}): choose "
        )
        raise UserError(text, Hint("conditions"), " so that a mean over them is the same mean everywhere")
    means = [{"level_a": x, "level_b": y, **estimate(at(x, y), {})} for x, y in product(names_a, names_b)]
    base_a = base[a] if base[a] in names_a else names_a[0]
    base_b = base[b] if base[b] in names_b else names_b[0]
    names_a.remove(base_a)
    names_b.remove(base_b)
    label_a, label_b = partial(study_data.labelled, factor=a), partial(study_data.labelled, factor=b)
    effects: Rows = []
    for x in names_a:
        words = f"{_words(a)}: {label_a(x)} − {label_a(base_a)}"
        effects.append({"effect": words, **estimate(at(x), at(base_a))})
    for y in names_b:
        words = f"{_words(b)}: {label_b(y)} − {label_b(base_b)}"
        effects.append({"effect": words, **estimate(at("", y), at("", base_b))})
    for x, y in product(names_a, names_b):
        # twice the mean over both corners minus that over the others is the difference of differences
        corners, others = {**at(x, y), **at(base_a, base_b)}, {**at(x, base_b), **at(base_a, y)}
        difference = f"{label_a(x)} − {label_a(base_a)}"
        words = f"interaction: {difference} at {label_b(y)} minus at {label_b(base_b)}"
        effects.append({"effect": words, **estimate(corners, others, 2)})
    return means, effects
