"""`pneuma study summary` and `compare`: what conditions come to, in numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, frame_table
from pneuma.errors import UserError, counted
from pneuma.presets import WORLDS
from pneuma.study.spec import load_study

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.claims.claim_list import Claim
    from pneuma.analysis.study_data import StudyData

PRINTED = ("markdown", "latex")
"""Forms of a table for pages and papers."""
SCALE = (
    "Scores are 0 and 1 at the numbers of [scores] in the study's file, or else at the random player's mean",
    "and the best condition's. Intervals over all are of the stratified bootstrap (Agarwal et al. 2021).",
)


def summary(
    name: opt.Study,
    picked: opt.RunFilter,
    outcome: opt.Outcomes = None,
    all_: Annotated[bool, opt.flag("--all", "Tell all statistics of the usual outcomes.")] = False,
    format: opt.Format = opt.TABLE,
    cells: Annotated[
        str | None, opt.choice(("sd", "interval"), "Markdown, latex: ± SD, or [low, high].")
    ] = None,
) -> Result:
    """Summarize each condition: means with 95 % intervals; with --outcome, all statistics.

    --format markdown and latex give the table of a thesis: a column for each outcome, mean ± SD in it.
    """
    if cells and format not in PRINTED:
        raise UserError(f"--cells: goes with --format {' or '.join(PRINTED)}")
    data, asked = picked.open(name), outcome or ()
    from pneuma.analysis import environments, summaries
    from pneuma.analysis.intervals import LEAST_RUNS
    from pneuma.analysis.outcomes import with_unit

    parts = environments.by_environment(data)
    if len(parts) > 1 and data.study.factors and not all_ and len(asked) <= 1:
        sought = asked[0] if asked else environments.OUTCOME
        form = "sd" if format in PRINTED else "interval"
        table, found, over = environments.environment_cells(parts, sought, form)
        legend = (f"{with_unit(sought)} in each environment, then scores over all.", *SCALE)
        document = {**data.about, "summary": found, "scores": over}
        notes = [data.ends, _few_text(parts.values())]
        return Result(document, ["", frame_table(table), "", *legend], data.full_title, notes, table, found)
    found = summaries.summary_table(data, asked)
    listed = [name for name in dict.fromkeys(found["outcome"]) if name != "runs"] if all_ else asked
    if format in PRINTED:
        cell_table = summaries.with_cells(found, cells or "sd")
        table = summaries.thesis_cells(data, cell_table, listed, by_factor=format == "latex")
    elif listed:
        table = summaries.statistics_cells(data, summaries.with_cells(found), listed)
    else:
        table = summaries.overview_cells(data, summaries.with_cells(found))
    shown: list[str | Table] = ["", frame_table(table)]
    if not listed:
        lacking = " –: no run has it." * bool((table == summaries.NO_CELL).any(axis=None))
        few = any(len(data.of_condition(name)) < LEAST_RUNS for name in data.conditions)
        lacking += f" Means of fewer than {LEAST_RUNS} runs have none." * few
        text = f"Means, and shares of runs, with 95 % intervals.{lacking} More: --outcome NAME, or --all."
        shown += ["", *filter(None, [summaries.failures_text(found)]), text]
    notes = [data.ends, *summaries.lacks_text(data, found, asked), summaries.episodes_text(data, listed)]
    return Result({**data.about, "summary": found}, shown, data.full_title, notes, table, found)


# --- compare --------------------------------------------------------------------------------------


def compare(
    name: opt.Study,
    picked: opt.RunFilter,
    a: Annotated[str | None, opt.argument("A", "A condition.")] = None,
    b: Annotated[str | None, opt.argument("B", "The condition that A is compared with.")] = None,
    with_: Annotated[
        str | None, opt.option("STUDY", "Compare each with another study's.", name="--with")
    ] = None,
    outcome: opt.Outcomes = None,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Compare two conditions: the difference of their means, and how likely a run of A is better.

    With --with, each condition is compared with that of the same name of another study. In a study of several
    environments A and B are compared in each, and their scores over all.
    """
    if (b is None) == (with_ is None) or (a and not b):
        raise UserError("name two conditions, A and B, or another study by --with STUDY")
    if a and b and _crosses_environments(name, a):
        return _compare_in_environments(picked.open(name), a, b, outcome or ())
    from pneuma.analysis.outcomes import with_unit
    from pneuma.analysis.study_data import join_studies
    from pneuma.analysis.summaries import compare_pairs, comparison_cells, episodes_text

    claims: list[Claim] = []
    if a and b:
        picked = replace(picked, condition=[a, b])
        data, heads, pairs = picked.open(name), [a, b], {"": (a, b)}
        _refuse_empty_arms(data)
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
    legend = (
        "Means and their difference with a 95 % interval (Welch), each rounded by itself. P(better): the",
        "probability that a run of the first is better than one of the second, from ten runs on.",
        "no value: runs left out.",
    )
    engines, episodes = _engines_text(data, [*pairs.values()]), episodes_text(data, [*table["outcome"]])
    notes = [data.ends, *map(_claim_text, claims), engines, *_common_text(data, pairs.values()), episodes]
    return Result(
        {**data.about, "comparisons": table},
        ["", frame_table(people), "", *legend],
        f"{data.full_title}: {heads[0]} against {heads[1]}",
        [*notes, _no_interval_text(table)],
        people,
        table,
    )


def _crosses_environments(name: str, condition: str) -> bool:
    """Return whether a name is not of a study's condition, but of some in each of its environments."""
    try:
        study = load_study(name)
    except UserError:
        return False  # a study without a file, or none
    levels = (fields for values in study.factors.values() for fields in values.values())
    return condition not in study.conditions and any("env" in fields for fields in levels)


def _compare_in_environments(data: StudyData, a: str, b: str, outcomes: Sequence[str]) -> Result:
    """Return a comparison of two conditions in each environment, and of their scores over all."""
    import pandas as pd

    from pneuma.analysis.environments import OUTCOME, by_environment, improvements
    from pneuma.analysis.outcomes import with_unit
    from pneuma.analysis.summaries import compare_conditions, comparison_cells, with_cells

    parts, outcomes = by_environment(data), outcomes or [OUTCOME]
    tables = [
        compare_conditions(part.of_conditions([a, b]), a, b, outcomes).assign(condition=env)
        for env, part in parts.items()
    ]
    table, over = pd.concat(tables, ignore_index=True), improvements(parts, a, b, outcomes[0])
    people = comparison_cells(table.assign(outcome=table["outcome"].map(with_unit)), [a, b])
    people = people.rename(columns={"": "environment"})
    table = table.rename(columns={"condition": "environment"})
    scores = with_cells(over)[["statistic", "cell"]]
    scores.columns = ["scores over all", f"{a} against {b}"]
    shown: list[str | Table] = ["", frame_table(people), "", frame_table(scores), "", *SCALE]
    document = {**data.about, "comparisons": table, "scores": over}
    notes = [data.ends, _few_text(parts.values()), _no_interval_text(table)]
    return Result(document, shown, f"{data.full_title}: {a} against {b}", notes, people, table)


def _claims_on(data: StudyData, a: str, b: str) -> list[Claim]:
    """Return the shipped claims that compare the means of two conditions of a study in its world."""
    from pneuma.analysis.claims.claim_list import shipped_claims

    environments = {fields.get("env") for fields in data.fields.values()}
    world = data.world or next((name for name, one in WORLDS.items() if one.env in environments), "")
    claims = [claim for claim_list in shipped_claims() for claim in claim_list.claims.values()]
    return [
        claim
        for claim in claims
        if (claim.study, claim.kind) == (data.study.name, "mean")
        and world in claim.worlds
        and any({*pair} == {(a,), (b,)} for name in claim.outcome for pair in claim.pairs(name))
    ]


def _claim_text(claim: Claim) -> str:
    return f"The claim {claim.name} compares these conditions: its outcomes stand first (study verify)."


def _few_text(parts: Iterable[StudyData]) -> str:
    """Say that intervals over environments are of few runs; empty if they are not."""
    from pneuma.analysis.intervals import LEAST_RUNS

    few = any(len(part.of_condition(name)) < LEAST_RUNS for part in parts for name in part.conditions)
    return f"Bootstrap intervals of fewer than {LEAST_RUNS} runs in an environment are too narrow." * few


def _refuse_empty_arms(data: StudyData) -> None:
    """Refuse a comparison with a condition none of whose cells has finished."""
    for condition in data.conditions:
        if not data.of_condition(condition):
            raise UserError(f"{condition}: none of its runs has finished ({data.label})")


def _common_text(data: StudyData, pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    for a, b in pairs:
        one, other = ({run.run_id for run in data.of_condition(name)} for name in (a, b))
        if both := len(one & other):
            yield f"Note: {a} and {b} are the same settings, and have {counted(both, 'run')} in common."


def _no_interval_text(table: pd.DataFrame) -> str:
    """Say why a difference has no interval; empty if all have one."""
    from pneuma.analysis.intervals import LEAST_RUNS

    lacking = bool((table["low"].isna() & table["difference"].notna()).any())
    return f"No interval where an arm has fewer than {LEAST_RUNS} runs, or all its runs are equal." * lacking


def _engines_text(data: StudyData, pairs: Sequence[tuple[str, str]]) -> str:
    """Say where what is compared was trained by different engines; claims refuse that."""
    for pair in pairs:
        engines = [", ".join(sorted(data.engines(name))) or "not known" for name in pair]
        if all(map(data.of_condition, pair)) and engines[0] != engines[1]:
            return f"Note: trained by different engines ({' and '.join(engines)})."
    return ""
