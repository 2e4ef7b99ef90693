"""`pneuma study effects`: what each factor of a crossed study does, alone and with each other."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.options import (
    Json,
    Results,
    Selected,
    StudyName,
    WorldName,
    print_json,
    selects,
)
from pneuma.cli.plain_text import plain
from pneuma.cli.study_summary import open_data, records, tell_step
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.effects import Effects

RESULTS = Path("results")
PRIMARY = "final-share-killed"


@selects
def effects(
    name: StudyName,
    outcome: Annotated[str, typer.Option("--outcome", metavar="NAME", help="What to look at.")] = PRIMARY,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Test the main effects and two-way interactions of a crossed study's factors."""
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.effects import study_effects
    from pneuma.analysis.run_view import common_step

    found = study_effects(data, outcome)
    if json:
        return print_json({**_document(found), "at_step": common_step(data)})
    _print_effects(found)
    tell_step(data)
    return None


def _document(found: Effects) -> dict[str, Any]:
    from pneuma.analysis.effects import effects_table

    factors = [effect.factors for effect in found.effects]
    rows = zip(records(effects_table(found)), factors, strict=True)
    return {
        "schema": 1,
        "study": found.study,
        "outcome": found.outcome,
        "cells": found.cells,
        "runs": found.runs,
        "runs_without_outcome": found.without,
        "means": found.means,
        "effects": [
            {**row, "factors": list(own), "levels": [len(found.means[factor]) for factor in own]}
            for row, own in rows
        ],
    }


def _print_effects(found: Effects) -> None:
    from pneuma.analysis.effects import effects_table
    from pneuma.analysis.rounding import decimals, shown

    without = f", and {found.without} without it left out" if found.without else ""
    print(f"{plain(found.title)}: {found.outcome}, {found.runs} runs in {found.cells} cells{without}\n")
    rows = effects_table(found).to_dict("records")
    width = max(len(row["effect"]) for row in rows)
    print(f"{'effect':<{width}}  {'levels':>7}  {'df':>8}  {'F':>8}  {'share':>6}  {'p':>6}  {'Holm':>6}")
    for row in rows:
        degrees, size = f"{row['df']}, {row['df_error']}", shown(row["partial_r2"], 3)
        statistic = "endless" if row["f"] == float("inf") else shown(row["f"], 2)
        told = f"{row['levels']:>7}  {degrees:>8}  {statistic:>8}  {size:>6}"
        print(f"{plain(row['effect']):<{width}}  {told}  {row['p']:.4f}  {row['p_holm']:.4f}")
    print("\nMeans, each cell counted alike:")
    for factor, means in found.means.items():
        told = ";  ".join(f"{level} {shown(value, decimals(value))}" for level, value in means.items())
        print(f"  {plain(factor)}: {plain(told)}")
    print("\nShare: of the variance that the other effects leave. Holm: p corrected over this table.")
