"""`pneuma study summary`, `compare` and `collapse`: the results of a study's runs."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from pneuma.analysis.answer import Answer
from pneuma.cli import options as opt
from pneuma.errors import MOST_LISTED, UserError

PAPER_FORMATS = ("markdown", "latex")
"""Forms of a table for pages and papers."""


def summary(
    name: opt.Study,
    selection: opt.RunFilter,
    outcome: opt.Outcomes = None,
    format: opt.Format = opt.TABLE,
    cells: Annotated[
        str | None, opt.choice(("sd", "interval"), "With markdown or latex: mean ± SD, or mean [low, high].")
    ] = None,
) -> Answer:
    """Summarize each condition: means with 95 % confidence intervals; with --outcome, all statistics.

    --format markdown or latex prints a table for a paper: a column for each outcome, with mean ± SD. Over
    several environments its cells have intervals.
    """
    if cells and format not in PAPER_FORMATS:
        raise UserError(f"--cells requires --format {' or '.join(PAPER_FORMATS)}")
    study_data = selection.open(name)
    from pneuma.analysis.summaries import summarize

    return summarize(study_data, outcome or (), format in PAPER_FORMATS, cells)


def compare(
    name: opt.Study,
    selection: opt.RunFilter,
    a: Annotated[str | None, opt.argument("A", "A condition, or a factor.")] = None,
    b: Annotated[
        str | None, opt.argument("B", "What A is compared with; another factor if A is one.")
    ] = None,
    with_: Annotated[
        str | None, opt.option("STUDY", "Compare each condition with another study's.", name="--with")
    ] = None,
    outcome: opt.Outcomes = None,
    format: opt.Format = opt.TABLE,
) -> Answer:
    """Compare two conditions: the difference of their means, and how likely a run of A beats one of B.

    With --with, each condition is compared with the condition of the same name in another study. In a study
    of several environments, A and B are compared in each, and by their scores over all. Of two factors of a
    crossed study it shows means at each pair of levels, main effects and interactions.
    """
    from pneuma.analysis import comparison

    if with_ and a is None:
        second = replace(selection, condition=None, set_=None)
        study_data, other_data = selection.open(name), second.open(with_)
        return comparison.compare(study_data, outcomes=outcome or (), other_data=other_data)
    if a and b and not with_:
        study_data = selection.open(comparison.narrowed(selection.query(name), a, b))
        return comparison.compare(study_data, a, b, outcome or ())
    from pneuma.analysis.runs import find_study

    listed = "; ".join(find_study(selection.index, selection.query(name)).conditions[:MOST_LISTED])
    raise UserError(f"name two conditions, A and B, or no condition and --with STUDY: {listed}")


def collapse(name: opt.Study, selection: opt.RunFilter) -> Answer:
    """Show which runs collapsed, when and by which signs, and how often in each condition."""
    study_data = selection.open(name)
    from pneuma.analysis.collapse import find_collapses

    return find_collapses(study_data)
