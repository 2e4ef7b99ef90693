"""`pneuma study summary` and `compare`: what conditions come to, in numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, command, draw_files, frame_table, read_formats, wrote
from pneuma.cli.study_environments import (
    compare_in_environments,
    crosses_environments,
    summary_of_environments,
)
from pneuma.cli.study_notes import what_is_shown, with_unit
from pneuma.errors import UserError, counted
from pneuma.presets import WORLDS

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.claims import Claim
    from pneuma.analysis.study_data import StudyData

COLUMNS = 3
"""Outcomes that `summary` prints by default."""
PRINTED = ("markdown", "latex")
"""Forms of a table for pages and papers."""
TOLD_BY = ("mean", "share", "median")
"""Statistics that stand for an outcome in such a table: the first of them that it has."""
FEW_EPISODES = 10
"""With fewer, the last point of a return is said to average few."""


def _episodes_text(data: StudyData, outcomes: Iterable[str]) -> str:
    """Say how many runs' last returns average few episodes; empty if none do."""
    counts = sorted(run.last_episodes for run in data.rows if 0 < run.last_episodes < FEW_EPISODES)
    if not counts or "final-return" not in outcomes:
        return ""
    between = f"{counts[0]:.0f} to {counts[-1]:.0f}" if counts[0] < counts[-1] else f"{counts[0]:.0f}"
    return f"final-return of {counted(len(counts), 'run')} is a mean of few episodes: {between}."


# --- summary --------------------------------------------------------------------------------------


def summary(
    name: opt.Study,
    picked: opt.RunFilter,
    outcome: opt.Outcomes = None,
    all_: Annotated[bool, opt.flag("--all", "Tell all statistics of the usual outcomes.")] = False,
    format: opt.Format = opt.TABLE,
    cells: Annotated[
        str | None,
        opt.choice(
            "--cells", ("sd", "interval"), "With --format markdown or latex: mean ± SD, or [low, high]."
        ),
    ] = None,
) -> Result:
    """Summarize each condition: means with 95 % intervals; with --outcome, all statistics.

    --format markdown and latex give the table of a thesis: a column for each outcome, mean ± SD in it.
    """
    if cells and format not in PRINTED:
        raise UserError(f"--cells: goes with --format {' or '.join(PRINTED)}")
    data = picked.open(name)
    from pneuma.analysis.environments import by_environment
    from pneuma.analysis.intervals import LEAST_RUNS
    from pneuma.analysis.summaries import summary_table, with_cells

    parts = by_environment(data)
    if len(parts) > 1 and data.study.factors and not all_ and len(outcome or ()) <= 1:
        return summary_of_environments(data, parts, outcome or (), format)
    found = summary_table(data, outcome or ())
    document = {**what_is_shown(data), "summary": found}
    every = [name for name in dict.fromkeys(found["outcome"]) if name != "runs"]
    listed = every if all_ else outcome or ()
    if format in PRINTED:
        table = _thesis_table(data, with_cells(found, cells or "sd"), listed, by_factor=format == "latex")
    elif listed:
        table = _statistics(data, with_cells(found), listed)
    else:
        table = _overview(data, with_cells(found))
    shown: list[str | Table] = ["", frame_table(table)]
    if not listed:
        lacking = " –: no run has it." * bool((table == "–").any(axis=None))
        few = any(len(data.of_condition(name)) < LEAST_RUNS for name in data.conditions)
        lacking += f" Means of fewer than {LEAST_RUNS} runs have none." * few
        legend = f"Means, and shares of runs, with 95 % intervals.{lacking} More: --outcome NAME, or --all."
        shown += ["", legend]
    notes = [data.ends, *_lacks_text(data, found, outcome or ()), _episodes_text(data, listed)]
    return Result(document, shown, data.full_title, notes, table, found)


def _statistics(data: StudyData, found: pd.DataFrame, outcomes: Sequence[str]) -> pd.DataFrame:
    """Return a row for each outcome and condition, with all statistics."""
    from pneuma.analysis.summaries import wide

    asked, rows = found[found["outcome"].isin(outcomes)], ["outcome", "condition"]
    runs = asked.groupby(rows)["runs"].first()
    pairs = [pair for pair in product(outcomes, data.conditions) if pair in runs]
    table = wide(asked, pairs, [*asked["statistic"].unique()], rows, ["statistic"])
    table.insert(0, "n", runs)
    table = table.reset_index().rename_axis(columns=None)
    return table.assign(outcome=table["outcome"].map(with_unit))


def _overview(data: StudyData, found: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each condition: means of the first outcomes, and shares of runs that failed."""
    from pneuma.analysis.summaries import wide

    shares = ("collapsed", "diverged")
    names = [*found["outcome"][found["statistic"] == "mean"].unique()][:COLUMNS]
    pairs = [*((name, "mean") for name in names), *((name, "share") for name in shares)]
    table = wide(found, data.conditions, pairs).set_axis([*map(with_unit, names), *shares], axis=1)
    table.insert(0, "runs", [len(data.of_condition(condition)) for condition in data.conditions])
    return table.reset_index()


def _thesis_table(
    data: StudyData, found: pd.DataFrame, outcomes: Sequence[str], by_factor: bool
) -> pd.DataFrame:
    """Return a row for each condition with a value and a column for each outcome, as in '0.68 ± 0.11'.

    A value of fewer runs than the condition has says of how many. If asked for, the conditions of a crossed
    study have a column for each factor.
    """
    import pandas as pd

    from pneuma.analysis.summaries import NO_CELL, wide

    told_by = found[found["statistic"].isin(TOLD_BY)].groupby("outcome", sort=False)["statistic"].first()
    pairs = [(name, told_by.get(name, "")) for name in outcomes or told_by.index[told_by == "mean"][:COLUMNS]]
    runs = {name: len(data.of_condition(name)) for name in data.conditions}
    fewer = found["runs"].map(" (n = {})".format).where(found["runs"] < found["condition"].map(runs), "")
    heads = [with_unit(name) + ", median" * (statistic == "median") for name, statistic in pairs]
    table = wide(found.assign(cell=found["cell"] + fewer), data.conditions, pairs).set_axis(heads, axis=1)
    table = table[(table != NO_CELL).any(axis=1)]
    table.insert(0, "runs", table.index.map(runs))
    if by_factor and (levels := data.study.levels):
        factors = pd.DataFrame([levels[name] for name in table.index])
        factors.columns = factors.columns.str.replace("_", " ")
        return pd.concat([factors, table.reset_index(drop=True)], axis=1)
    return table.reset_index()


def _lacks_text(data: StudyData, found: pd.DataFrame, outcomes: Sequence[str]) -> list[str]:
    """Say which conditions have no value of an outcome that was asked for, and why."""
    from pneuma.analysis.outcomes import reason

    known, text = {*zip(found["outcome"], found["condition"], strict=True)}, []
    for outcome, condition in product(outcomes, data.conditions):
        if (outcome, condition) not in known:
            runs = data.of_condition(condition)
            why = reason(runs[0], outcome) if runs else "no run has finished"
            text.append(f"{outcome}, {condition}: {why}")
    return text


# --- compare --------------------------------------------------------------------------------------


def compare(
    name: opt.Study,
    picked: opt.RunFilter,
    a: Annotated[str | None, opt.argument("A", "A condition.")] = None,
    b: Annotated[str | None, opt.argument("B", "The condition that A is compared with.")] = None,
    with_: Annotated[
        str | None,
        opt.option("--with", "STUDY", "Compare the conditions of another study that both have, not A and B."),
    ] = None,
    outcome: opt.Outcomes = None,
    plot: Annotated[bool, opt.flag("--plot", "Draw the differences too, as PNG and SVG.")] = False,
    out: opt.PlotFolder = None,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Compare two conditions: the difference of their means, and how likely a run of A is better.

    With --with, each condition is compared with that of the same name of another study. In a study of several
    environments A and B are compared in each, and their scores over all.
    """
    if (b is None) == (with_ is None) or (a and not b):
        raise UserError("name two conditions, A and B, or another study by --with STUDY")
    formats = read_formats(None, out, "" if plot else "--plot")
    if a and b and crosses_environments(name, a):
        return compare_in_environments(picked.open(name), a, b, outcome or (), format)
    from pneuma.analysis.study_data import join_studies
    from pneuma.analysis.summaries import compare_pairs, comparison_cells

    claims: list[Claim] = []
    if a and b:
        data, heads, pairs = replace(picked, condition=[a, b]).open(name), [a, b], {"": (a, b)}
        claims = [] if outcome else _claims_on(data, a, b)
    else:
        data, other = picked.open(name), replace(picked, condition=None, set_=None).open(str(with_))
        heads = [data.study.name, other.study.name]
        data, pairs = join_studies(data, other)
        if not pairs:
            raise UserError(f"{name} and {with_} have no condition of one name: name two conditions instead")
    table = compare_pairs(data, pairs, outcome or (), [name for claim in claims for name in claim.outcome])
    if with_ and not outcome:  # what one of two studies lacks, as imports do, is left out
        table = table[(table["seeds_a"] > 0) & (table["seeds_b"] > 0)]
    people = comparison_cells(table.assign(outcome=table["outcome"].map(with_unit)), heads)
    table = table.drop(columns="condition")
    files = []
    if plot:
        from pneuma.figures.summary import comparison_page

        narrowed = [word for word in data.narrowed if word not in heads]  # these are named below
        basename = replace(data, narrowed=narrowed).basename("compare", *(heads if b else heads[1:]))
        words = ["compare", name, *([a, b] if a and b else ["--with", str(with_)]), "--plot"]
        words += [word for each in outcome or () for word in ("--outcome", each)]
        again = command("study", *words, *opt.words_of(replace(picked, steps=data.steps or picked.steps)))
        files = draw_files(picked.store, out, formats, [(comparison_page(data, table, basename), again)])
    legend = (
        "Means and their difference with a 95 % interval (Welch), each rounded by itself. P(better): the",
        "probability that a run of the first is better than one of the second, from ten runs on.",
        "no value: runs left out.",
    )
    engines, episodes = _engines_text(data, [*pairs.values()]), _episodes_text(data, [*table["outcome"]])
    return Result(
        {**what_is_shown(data), "comparisons": table, "figures": files},
        ["", frame_table(people), "", *legend, *wrote(files)],
        f"{data.full_title}: {heads[0]} against {heads[1]}",
        [data.ends, *map(_claim_text, claims), engines, episodes],
        people,
        table,
    )


def _claims_on(data: StudyData, a: str, b: str) -> list[Claim]:
    """Return the shipped claims that compare the means of two conditions of a study in its world."""
    from pneuma.analysis.claims import MINUS, load_claims

    world = data.world or next((name for name, one in WORLDS.items() if one.env in _environments(data)), "")
    return [
        claim
        for claim in load_claims().claims.values()
        if (claim.study, claim.kind) == (data.study.name, "mean")
        and world in claim.worlds
        and any({*pair} == {(a,), (b,)} for pair in claim.pairs)
        and not any(MINUS in name for name in claim.outcome)
    ]


def _environments(data: StudyData) -> set[object]:
    return {fields.get("env") for fields in data.fields.values()}


def _claim_text(claim: Claim) -> str:
    return f"The claim {claim.name} compares these conditions: its outcomes stand first (study verify)."


def _engines_text(data: StudyData, pairs: Sequence[tuple[str, str]]) -> str:
    """Say where what is compared was trained by different engines; claims refuse that."""
    for pair in pairs:
        if not all(data.of_condition(name) for name in pair):
            continue
        engines = [", ".join(sorted(data.engines(name))) or "not known" for name in pair]
        if engines[0] != engines[1]:
            return f"Note: trained by different engines ({' and '.join(engines)})."
    return ""
