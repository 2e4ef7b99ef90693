"""Two conditions compared, or each condition of a study with the same one of another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pandas as pd

from pneuma.analysis.claims.claim_list import Claim, shipped_claims
from pneuma.analysis.environments import OUTCOME, by_environment, improvements
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import Group, compare_groups, outcomes_to_compare
from pneuma.answers.answer import Answer
from pneuma.answers.cells import comparison_cells, with_cells
from pneuma.answers.summary import SCALE, few_episodes, few_runs
from pneuma.errors import UserError, counted
from pneuma.presets import WORLDS
from pneuma.study.plan import Query
from pneuma.study.spec import load_study

LEGEND = (
    "Means and their difference with a 95 % interval (Welch), each rounded by itself. P(better): the",
    "probability that a run of the first is better than one of the second, from ten runs on.",
    "no value: runs left out.",
)
Pairs = dict[str, tuple[Group, Group]]
"""Two groups of runs, by what is compared in them: a condition, an environment, or nothing."""


def narrowed(query: Query, a: str, b: str) -> Query:
    """Return a query of two conditions alone, unless their names are of conditions in each environment."""
    try:
        study = load_study(query.study)
    except UserError:  # it has no file
        return replace(query, conditions=(a, b))
    set_by_factors = [fields for levels in study.factors.values() for fields in levels.values()]
    if a not in study.conditions and any("env" in fields for fields in set_by_factors):
        return query
    return replace(query, conditions=(a, b))


def compare(
    data: StudyData, a: str = "", b: str = "", outcomes: Sequence[str] = (), other: StudyData | None = None
) -> Answer:
    """Compare condition `a` with `b`, or each condition with that of the same name of another study.

    In a study of several environments `a` and `b` are compared in each, and their scores over all.

    Args:
        data: an opened study.
        a: a condition.
        b: the condition that it is compared with.
        outcomes: names from docs/outcomes.md; default: the study's own or usual ones, after those of a claim
            about these conditions.
        other: another opened study, instead of two conditions.

    Returns:
        The table `comparisons` has a row for each outcome: means, their difference with its interval,
        `p_better`, and counts of runs. Scores over several environments are the table `scores`.

    Raises:
        UserError: for unknown names, or outcomes that cannot be compared.
    """
    if other is not None:
        return _compare_studies(data, other, outcomes)
    if a == b:
        raise UserError(f"{a} and {b} are the same condition; name two of {', '.join(data.conditions)}")
    title = f"{data.full_title}: {a} against {b}"
    data_by_env = by_environment(data)
    if a not in data.fields and len(data_by_env) > 1:
        pairs = {env: (_group(env_data, a), _group(env_data, b)) for env, env_data in data_by_env.items()}
        outcomes = outcomes or [OUTCOME]
        answer = _compare_pairs(data, pairs, [a, b], title, outcomes, shared="environment")
        scores = improvements(data_by_env, a, b, outcomes[0])
        cells = with_cells(scores)[["statistic", "cell"]]
        cells.columns = pd.Index(["scores over all", f"{a} against {b}"])
        return replace(
            answer,
            tables={**answer.tables, "scores": scores},
            cells=[*answer.cells, cells],
            notes=[*answer.notes, few_runs(data_by_env)],
            legend=list(answer.legend) + list(SCALE),
        )
    claims = [] if outcomes else _claims_about(data, a, b)
    first = [name for claim in claims for name in claim.outcome]
    pairs = {"": (_group(data, a), _group(data, b))}
    answer = _compare_pairs(data, pairs, [a, b], title, outcomes, first)
    notes = list(answer.notes)
    for claim in claims:
        notes.append(
            f"The claim {claim.name} compares these conditions; its outcomes come first (see study verify)."
        )
    return replace(answer, notes=notes)


def _compare_studies(data: StudyData, other: StudyData, outcomes: Sequence[str]) -> Answer:
    names = [data.study.name, other.study.name]
    if names[0] == names[1]:
        names = [data.label, other.label]
    pairs: Pairs = {}
    for condition in data.conditions:
        if data.of_condition(condition) and other.of_condition(condition):
            a = Group(data, condition, f"{condition}, {names[0]}")
            pairs[condition] = a, Group(other, condition, f"{condition}, {names[1]}")
    if not pairs:
        raise UserError(
            f"{names[0]} and {names[1]} have no condition with the same name: name two conditions instead"
        )
    title = f"{data.full_title}, and {other.full_title}: {names[0]} against {names[1]}"
    return _compare_pairs(data, pairs, names, title, outcomes)


def _group(data: StudyData, condition: str) -> Group:
    """Return the runs of a condition, which must have finished ones."""
    if not data.of_conditions(condition).of_condition(condition):
        raise UserError(f"{condition}: none of its runs has finished ({data.label}); train them first")
    return Group(data, condition, condition)


def _compare_pairs(
    data: StudyData,
    pairs: Pairs,
    heads: Sequence[str],
    title: str,
    outcomes: Sequence[str] = (),
    first: Sequence[str] = (),
    shared: str = "",
) -> Answer:
    """Compare pairs of groups.

    Args:
        data: the study of the first group of each pair.
        pairs: what is compared.
        heads: what stands over the means.
        title: of the answer.
        outcomes: default: those of `outcomes_to_compare`.
        first: outcomes that come before the default ones.
        shared: the name of the column with the keys of `pairs` in the numbers; left out if empty.
    """
    rows = []
    notes = [data.ends]
    for key, (a, b) in pairs.items():
        for outcome in dict.fromkeys([*first, *(outcomes or outcomes_to_compare(a, b))]):
            row = compare_groups(a, b, outcome)
            # What one of two studies lacks, as imports do, is left out.
            if outcomes or a.data is b.data or (row["seeds_a"] and row["seeds_b"]):
                rows.append({**row, "shared": key})
        notes += _notes_on_pair(a, b)
    if not rows:
        raise UserError(f"{' and '.join(heads)} share no outcome: name one that both have")
    table = pd.DataFrame(rows)
    cells = comparison_cells(table, heads, first_head=shared)
    if (table["low"].isna() & table["difference"].notna()).any():
        notes.append(
            f"A condition with fewer than {LEAST_RUNS} runs, or whose runs are all equal, has no interval."
        )
    notes.append(few_episodes(data, list(table["outcome"])))
    if not shared:
        table = table.drop(columns="shared")
    table = table.rename(columns={"shared": shared})
    return Answer(title, data.about, {"comparisons": table}, [cells], list(dict.fromkeys(notes)), LEGEND)


def _notes_on_pair(a: Group, b: Group) -> list[str]:
    """Return what makes a comparison doubtful: different engines, which claims refuse, and shared runs."""
    notes = []
    engines = [", ".join(sorted(arm.data.engines(arm.condition))) or "not known" for arm in (a, b)]
    if engines[0] != engines[1]:
        notes.append(f"Note: these runs were trained by different engines ({' and '.join(engines)}).")
    shared = a.run_ids & b.run_ids
    if shared:
        shared_runs = counted(len(shared), "run")
        notes.append(f"Note: {a.name} and {b.name} have the same settings and share {shared_runs}.")
    return notes


def _claims_about(data: StudyData, a: str, b: str) -> list[Claim]:
    """Return the shipped claims that compare the means of two conditions of a study in its world."""
    worlds = [name for name, world in WORLDS.items() if world.env in data.environments]
    if data.world:
        worlds = [data.world]
    claims = []
    for claim_list in shipped_claims():
        for claim in claim_list.claims.values():
            if (claim.study, claim.kind) != (data.study.name, "mean") or worlds[:1] == []:
                continue
            pairs = [pair for outcome in claim.outcome for pair in claim.pairs(outcome)]
            if worlds[0] in claim.worlds and any(set(pair) == {(a,), (b,)} for pair in pairs):
                claims.append(claim)
    return claims
