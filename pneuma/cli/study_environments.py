"""`pneuma study summary` and `compare` of studies of several environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pneuma.cli.output import Result, Table, frame_table
from pneuma.cli.study_notes import what_is_shown, with_unit
from pneuma.errors import UserError
from pneuma.study.spec import load_study

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.environments import Parts
    from pneuma.analysis.study_data import StudyData

SCALE = (
    "Scores are 0 and 1 at the numbers of [scores] in the study's file, or else at the random player's mean",
    "and the best condition's. Intervals over all are of the stratified bootstrap (Agarwal et al. 2021).",
)


def crosses_environments(name: str, condition: str) -> bool:
    """Return whether a name is not of a study's condition, but of some in each of its environments."""
    try:
        study = load_study(name)
    except UserError:
        return False  # a study without a file, or none
    levels = (fields for values in study.factors.values() for fields in values.values())
    return condition not in study.conditions and any("env" in fields for fields in levels)


def summary_of_environments(data: StudyData, parts: Parts, outcomes: Sequence[str], format: str) -> Result:
    """Return a row for each condition, with columns for each environment and each score over all."""
    import pandas as pd

    from pneuma.analysis.environments import OUTCOME, over_environments
    from pneuma.analysis.summaries import NO_CELL, summary_table, wide, with_cells

    outcome = outcomes[0] if outcomes else OUTCOME
    form = "sd" if format in ("markdown", "latex") else "interval"
    found = []
    for env, part in parts.items():
        cells = with_cells(summary_table(part, [outcome]), form)
        found.append(cells[cells["statistic"] == "mean"].assign(environment=env))
    every = pd.concat(found, ignore_index=True)
    every = every[every["outcome"] == outcome]
    names = [*dict.fromkeys(every["condition"])]
    table = wide(every, names, [*parts], of=["environment"])
    over = over_environments(parts, outcome)
    scored = wide(_with_cells(over), names, [*dict.fromkeys(over["statistic"])], of=["statistic"])
    table = pd.concat([table, scored], axis=1).fillna(NO_CELL)
    table.columns = [str(column) for column in table.columns]
    runs = [", ".join(str(len(part.of_condition(name))) for part in parts.values()) for name in names]
    table.insert(0, "runs", runs)
    table = table.reset_index()
    document = {**what_is_shown(data), "summary": every.drop(columns="cell"), "scores": over}
    legend = [f"{with_unit(outcome)} in each environment, then scores over all.", *SCALE]
    shown: list[str | Table] = ["", frame_table(table), "", *legend]
    return Result(document, shown, data.full_title, [data.ends], table, every)


def _with_cells(numbers: pd.DataFrame) -> pd.DataFrame:
    from pneuma.analysis.intervals import shown_with_interval

    rows = zip(numbers["value"], numbers["low"], numbers["high"], strict=True)
    return numbers.assign(cell=[shown_with_interval(*row) for row in rows])


def compare_in_environments(data: StudyData, a: str, b: str, outcomes: Sequence[str], format: str) -> Result:
    """Return a comparison of two conditions in each environment, and of their scores over all."""
    import pandas as pd

    from pneuma.analysis.environments import OUTCOME, by_environment, improvements
    from pneuma.analysis.summaries import compare_conditions, comparison_cells

    parts = by_environment(data)
    outcomes = outcomes or [OUTCOME]
    tables = []
    for env, part in parts.items():
        part.of_conditions([a, b])  # refuses unknown ones
        tables.append(compare_conditions(part, a, b, outcomes).assign(condition=env))
    table = pd.concat(tables, ignore_index=True)
    over = improvements(parts, a, b, outcomes[0])
    people = comparison_cells(table.assign(outcome=table["outcome"].map(with_unit)), [a, b])
    people = people.rename(columns={"": "environment"})
    scores = _with_cells(over)[["statistic", "cell"]].set_axis(
        ["scores over all", f"{a} against {b}"], axis=1
    )
    table = table.rename(columns={"condition": "environment"})
    document = {**what_is_shown(data), "comparisons": table, "scores": over}
    shown: list[str | Table] = ["", frame_table(people), "", frame_table(scores), "", *SCALE]
    return Result(document, shown, f"{data.full_title}: {a} against {b}", [data.ends], people, table)
