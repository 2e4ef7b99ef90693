"""Two conditions compared, or each condition of a study with the same one of another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.cells import comparison_cells, with_cells
from pneuma.analysis.claims.claim_list import Claim, shipped_claims_on
from pneuma.analysis.environments import OUTCOME, by_environment, environment_names, improvements
from pneuma.analysis.factors import compare_factors, factors_of
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.notes import (
    averaging,
    notes_on_ends,
    notes_on_failing_runs,
    notes_on_few_runs,
    notes_on_outcomes,
)
from pneuma.analysis.outcomes import find_outcome, known_values
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import SCALE, Group, compare_groups, outcomes_to_compare
from pneuma.errors import UserError, counted
from pneuma.study.plan import Query
from pneuma.study.spec import CONDITION, load_study, named_condition

LEGEND = (
    "Means and their difference with a 95 % interval (Welch), each rounded by itself. P(better): the",
    "probability that a run of the first is better than one of the second, from ten runs on.",
    "no value: runs left out.",
)
Pairs = dict[str, tuple[Group, Group]]
"""Two groups of runs, by what is compared in them: a condition, an environment, or nothing."""


def narrowed(query: Query, a: str, b: str) -> Query:
    """Return a query of two conditions alone, unless they are factors or conditions in each environment."""
    try:
        study = load_study(query.study)
    except UserError:  # it has no file
        return replace(query, conditions=(a, b))
    if {a, b} & {CONDITION, *study.factors, *query.settings} - {*study.conditions}:
        return query
    set_by_factors = [set_fields for levels in study.factors.values() for set_fields in levels.values()]
    if named_condition(a, study.levels) not in study.conditions and any(
        "env" in set_fields for set_fields in set_by_factors
    ):
        return query
    return replace(query, conditions=(a, b))


def compare(
    study_data: StudyData,
    a: str = "",
    b: str = "",
    outcomes: Sequence[str] = (),
    other_data: StudyData | None = None,
) -> Answer:
    """Compare condition `a` with `b`, or each condition with that of the same name of another study.

    In a study of several environments `a` and `b` are compared in each, and their scores over all. Of two
    factors of a crossed study, it gives what `compare_factors` does.

    Args:
        study_data: an opened study.
        a: a condition, or a factor.
        b: the condition that it is compared with.
        outcomes: names from docs/outcomes.md; default: the study's, or the default ones, after those of a
            claim about these conditions.
        other_data: another opened study, instead of two conditions.

    Returns:
        The table `comparisons` has a row for each outcome: means, their difference with its interval,
        `p_better`, and counts of runs. Scores over several environments are the table `scores`.

    Raises:
        UserError: for unknown names, or outcomes that cannot be compared.
    """
    if other_data is not None:
        return _compare_studies(study_data, other_data, outcomes)
    a, b = (named_condition(name, study_data.study.levels) for name in (a, b))
    if a == b:
        raise UserError(f"{a} and {b} are the same condition: name two")
    if {a, b} & {*factors_of(study_data)} - {*study_data.fields}:
        return compare_factors(study_data, a, b, outcomes)
    data_by_env = by_environment(study_data)
    if a not in study_data.fields and len(data_by_env) > 1:
        return _compare_in_environments(study_data, data_by_env, a, b, outcomes or [OUTCOME])
    claims = [] if outcomes else _claims_about(study_data, a, b)
    claimed_outcomes: list[str] = []
    for claim in claims:
        claimed_outcomes += claim.outcome
    claim_notes = []
    if claims:
        claim_names = " and ".join(claim.name for claim in claims)
        claim_notes.append(
            f"Claims about these conditions: {claim_names}. Their outcomes come first (see study verify)."
        )
    pairs = {"": (_group(study_data, a), _group(study_data, b))}
    headings = [study_data.labelled(condition) for condition in (a, b)]
    answer = _compare_pairs(study_data, pairs, headings, outcomes, claimed_outcomes)
    return replace(answer, notes=list(answer.notes) + claim_notes)


def _compare_in_environments(
    study_data: StudyData, data_by_env: Mapping[str, StudyData], a: str, b: str, outcomes: Sequence[str]
) -> Answer:
    """Compare two conditions in each environment, and their scores over all."""
    pairs = {env: (_group(env_data, a), _group(env_data, b)) for env, env_data in data_by_env.items()}
    answer = _compare_pairs(study_data, pairs, [a, b], outcomes, shared_column="environment")
    (cells,) = answer.cells
    cells = cells.assign(environment=cells["environment"].map(environment_names(study_data)))
    answer = replace(answer, cells=[cells])
    try:
        score_table = improvements(data_by_env, a, b, outcomes[0])
    except UserError as missing_scale:
        return replace(answer, notes=[*answer.notes, f"No scores over all: {missing_scale}."])
    score_cells = with_cells(score_table)[["statistic", "cell"]]
    score_cells.columns = pd.Index(["scores over all", f"{a} against {b}"])
    return replace(
        answer,
        tables={**answer.tables, "scores": score_table},
        cells=[cells, score_cells],
        notes=list(answer.notes) + notes_on_few_runs(data_by_env),
        legend=LEGEND + SCALE,
    )


def _compare_studies(study_data: StudyData, other_data: StudyData, outcomes: Sequence[str]) -> Answer:
    names = [study_data.study.name, other_data.study.name]
    if names[0] == names[1]:
        names = [study_data.label, other_data.label]
    if names[0] == names[1]:
        raise UserError(
            f"{names[0]} is compared with itself; name another study, or one of its presets as @NAME"
        )
    pairs: Pairs = {}
    for condition in study_data.conditions:
        if study_data.of_condition(condition) and other_data.of_condition(condition):
            group_a = Group(study_data, condition, f"{condition}, {names[0]}")
            pairs[condition] = group_a, Group(other_data, condition, f"{condition}, {names[1]}")
    if not pairs:
        raise UserError(
            f"{names[0]} and {names[1]} have no condition with the same name, so nothing can be compared"
        )
    title = f"{study_data.full_title}, and {other_data.full_title}: {names[0]} against {names[1]}"
    return replace(_compare_pairs(study_data, pairs, names, outcomes), title=title)


def _group(study_data: StudyData, condition: str) -> Group:
    """Return the runs of a condition, which must have finished ones."""
    if not study_data.of_conditions([condition]).of_condition(condition):
        raise UserError(f"{condition}: none of its runs has finished ({study_data.label}); train them first")
    return Group(study_data, condition, condition)


def _compare_pairs(
    study_data: StudyData,
    pairs: Pairs,
    headings: Sequence[str],
    outcomes: Sequence[str],
    first_outcomes: Sequence[str] = (),
    shared_column: str = "",
) -> Answer:
    """Compare pairs of groups.

    Args:
        study_data: the study of the first group of each pair.
        pairs: what is compared.
        headings: of the columns of means.
        outcomes: default: those of `outcomes_to_compare`.
        first_outcomes: outcomes that come before the default ones.
        shared_column: the name of the column with the keys of `pairs` in the numbers; left out if empty.
    """
    comparison_rows = []
    notes = notes_on_ends(study_data)
    notes_on_runs: list[str] = []
    for pair_key, (a, b) in pairs.items():
        for outcome in dict.fromkeys([*first_outcomes, *(outcomes or outcomes_to_compare(a, b))]):
            row = compare_groups(a, b, outcome)
            # What one of two studies lacks, as imports do, or both conditions of one, is left out.
            counts = row["seeds_a"], row["seeds_b"]
            if outcomes or all(counts) or (a.data is b.data and any(counts)):
                comparison_rows.append({**row, "shared": pair_key})
                values = {group.name: known_values(group.data, group.condition, outcome) for group in (a, b)}
                notes_on_runs += notes_on_failing_runs(outcome, values)
        notes += _notes_on_pair(a, b)
    if not comparison_rows:
        raise UserError(f"{' and '.join(headings)} share no outcome: name one that both have")
    comparison_table = pd.DataFrame(comparison_rows)
    cells = comparison_cells(comparison_table, headings, first_heading=shared_column)
    if (comparison_table["low"].isna() & comparison_table["difference"].notna()).any():
        notes.append(
            f"A condition with fewer than {LEAST_RUNS} runs, or whose runs are all equal, has no interval."
        )
    outcome_names = list(comparison_table["outcome"])
    notes += notes_on_runs + notes_on_outcomes(study_data, outcome_names)
    if any(find_outcome(outcome).is_return for outcome in outcome_names):
        notes += _notes_on_averages(*next(iter(pairs.values())))
    if not shared_column:
        comparison_table = comparison_table.drop(columns="shared")
    comparison_table = comparison_table.rename(columns={"shared": shared_column})
    title, tables = (
        f"{study_data.full_title}: {' against '.join(headings)}",
        {"comparisons": comparison_table},
    )
    return Answer(title, study_data.about, tables, [cells], list(dict.fromkeys(notes)), LEGEND)


def _notes_on_pair(a: Group, b: Group) -> list[str]:
    """Return what makes a comparison doubtful: different engines, which claims refuse, and shared runs."""
    notes = []
    engine_texts = [", ".join(sorted(group.data.engines(group.condition))) or "not known" for group in (a, b)]
    if engine_texts[0] != engine_texts[1]:
        notes.append(f"Note: these runs were trained by different engines ({' and '.join(engine_texts)}).")
    shared_ids = a.run_ids & b.run_ids
    if shared_ids:
        shared_runs = counted(len(shared_ids), "run")
        notes.append(f"Note: {a.name} and {b.name} have the same settings and share {shared_runs}.")
    return notes


def _notes_on_averages(a: Group, b: Group) -> list[str]:
    """Return that the returns of two studies average different episodes, if they do."""
    if averaging(a.data) == averaging(b.data):
        return []
    texts = [f"{averaging(group.data)} ({group.data.study.name})" for group in (a, b)]
    return [f"Note: returns average different episodes: {' and '.join(texts)}."]


def _claims_about(study_data: StudyData, a: str, b: str) -> list[Claim]:
    """Return the shipped claims that compare the means of two conditions of a study in its world."""
    claims = []
    for claim in shipped_claims_on(study_data.study.name):
        if claim.kind == "mean" and study_data.study.world in claim.worlds:
            pairs = [pair for outcome in claim.outcome for pair in claim.pairs(outcome)]
            if any(set(pair) == {(a,), (b,)} for pair in pairs):
                claims.append(claim)
    return claims
