"""Verdicts on claims, all of them views of one table of contrasts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import wrap
from typing import Any

import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.claims import words
from pneuma.analysis.claims.claim_list import RULES, Claim, ClaimList, load_claims, shipped_claims
from pneuma.analysis.claims.verdicts import ClaimContrast, Verdict, judge
from pneuma.errors import UserError, counted, unknown_name
from pneuma.store.index import RunIndex

_LEGEND = (
    "In brackets: the confidence interval of the difference, or of the value if there is only a threshold; "
    "and the margin (± or, of a factor, ×), the smallest difference that counts.",
    words.RULE,
    f"docs/claims.md explains more. Rules of the judge: version {RULES}. The intervals of a family hold "
    "jointly:",
)
LEGEND = tuple(line for sentences in _LEGEND for line in wrap(sentences, 100))
KILLS_AND_RETURNS = "Kills are the mean of the last five evaluations, returns of the last 5 % of training."
CLAIM_FIELDS = ("row", "section", "quote", "context", "study", "kind", "direction", "need", "seen")
"""The fields of a claim in a document, apart from its name."""


@dataclass(frozen=True)
class VerdictsAnswer(Answer):
    """The verdicts on claims.

    Attributes:
        verdicts: by claim and world.
        heading: what must be known before the verdicts are read: the lists, and their labels.
    """

    verdicts: Mapping[str, Mapping[str, Verdict]] = field(default_factory=dict)
    heading: Sequence[str] = ()

    @property
    def document(self) -> dict[str, Any]:
        """Each claim with its contrasts."""
        return dict(self.about)


def verify(
    index: RunIndex,
    claims_path: Path | None = None,
    claim_names: Sequence[str] = (),
    world: str | None = None,
) -> VerdictsAnswer:
    """Judge the thesis's claims, or those of another list, on the runs that they fixed.

    Args:
        index: the runs of a results folder, and published ones.
        claims_path: a list of claims; default: those on the thesis.
        claim_names: of claims; default: all.
        world: only this one.

    Returns:
        The table `contrasts` has a row for each claim, world, outcome and pair of conditions.

    Raises:
        UserError: for a list that is not allowed, or names that are not in it.
    """
    claim_lists, is_selected = selected_claims(claims_path, claim_names, world)
    verdicts: list[Verdict] = []
    legend = list(LEGEND)
    if claims_path is None:
        legend.insert(0, KILLS_AND_RETURNS)
    for claim_list in claim_lists:
        verdicts += judge(claim_list, index, is_selected)
        family = {"list": "a world", "study": "a study in a world"}[claim_list.head.families]
        confidence = f"{100 - 100 * claim_list.head.alpha:g} %, for {family}"
        legend.append(f"  {claim_list.path.name}: {confidence}; SHA-256 {claim_list.digest[:16]}…")
    contrast_rows = [
        _contrast_row(claim_contrast) for verdict in verdicts for claim_contrast in verdict.contrasts
    ]
    by_claim = words.verdicts_by_claim(verdicts)
    about = {
        "rules": RULES,
        "lists": [list_row(claim_list) for claim_list in claim_lists],
        "claims": [_verdict_row(verdict) for verdict in verdicts],
    }
    return VerdictsAnswer(
        title="",
        about=about,
        tables={"contrasts": pd.DataFrame(contrast_rows)},
        cells=[words.verdict_table(by_claim), words.count_words(by_claim)],
        notes=[f"{problem}." for problem in index.problems],
        legend=legend + [_origin(index, verdicts)],
        verdicts=by_claim,
        heading=_heading(claim_lists, verdicts),
    )


def selected_claims(
    claims_path: Path | None, claim_names: Sequence[str], world: str | None
) -> tuple[list[ClaimList], Callable[[Claim, str], bool]]:
    """Return the lists of claims, and whether a claim is selected in a world; see `verify`."""
    claim_lists = [load_claims(claims_path)] if claims_path else shipped_claims()
    known_names = [claim_name for claim_list in claim_lists for claim_name in claim_list.claims]
    for claim_name in claim_names:
        if claim_name not in known_names:
            every_claim = [claim for claims in claim_lists for claim in claims.claims.values()]
            about = [claim.name for claim in every_claim if claim.study == claim_name]
            if about:
                raise UserError(f"{claim_name} is a study; name claims, such as its {', '.join(about[:5])}")
            raise unknown_name("claim", claim_name, known_names)

    def is_selected(claim: Claim, judged_world: str) -> bool:
        is_named = not claim_names or claim.name in claim_names or claim.like in claim_names
        return is_named and world in (None, judged_world)

    return claim_lists, is_selected


def _heading(claim_lists: Sequence[ClaimList], verdicts: Sequence[Verdict]) -> list[str]:
    """Return which lists are judged, and what the labels mean that occur."""
    heading = []
    for claim_list in claim_lists:
        if claim_list.head.title:
            claim_count = counted(len(claim_list.claims), "claim")
            heading.append(f"{claim_list.head.title}: {claim_list.path.name}, {claim_count}.")
    for label in dict.fromkeys([*words.LABELS, *(verdict.label for verdict in verdicts)]):
        if any(verdict.label == label for verdict in verdicts):
            meaning = words.LABELS.get(label, "its runs were known when it was stated")
            heading.append(f"{label.capitalize()}: {meaning}.")
    return heading


def _origin(index: RunIndex, verdicts: Sequence[Verdict]) -> str:
    """Return how many of the runs that were read are the user's own, which count before published ones."""
    run_ids = {run_id for verdict in verdicts for run_id in verdict.run_ids}
    own_runs = int((index.frame.loc[list(run_ids), "where"] == "").sum())
    return f"Read {own_runs:,} runs from {index.store.root} and {len(run_ids) - own_runs:,} published runs."


def list_row(claim_list: ClaimList) -> dict[str, Any]:
    return {
        "file": claim_list.path.name,
        "claims_hash": claim_list.digest,
        "alpha": claim_list.head.alpha,
        "families": claim_list.head.families,
    }


def _verdict_row(verdict: Verdict) -> dict[str, Any]:
    """Return the row that decides first, with the claim's own verdict and reason, and all its rows."""
    return {
        **_contrast_row(verdict.deciding[0]),
        "verdict": verdict.verdict,
        "registered_verdict": verdict.registered_verdict,
        "label": verdict.label,
        "changed": verdict.changed,
        "reason": verdict.reason,
        "run_ids": verdict.run_ids,
        **{field_name: getattr(verdict.claim, field_name) for field_name in CLAIM_FIELDS},
        "outcomes": verdict.claim.outcome,
        "contrasts": [
            {**_contrast_row(claim_contrast), "runs": claim_contrast.runs}
            for claim_contrast in verdict.contrasts
        ],
    }


def _contrast_row(claim_contrast: ClaimContrast) -> dict[str, Any]:
    """Return a row of the table: what was planned, and what the runs show."""
    contrast, (a, b) = claim_contrast.contrast, claim_contrast.names
    return {
        "claim": claim_contrast.claim.name,
        "world": claim_contrast.world,
        "outcome": claim_contrast.outcome,
        "a": a,
        "b": b,
        "alpha": claim_contrast.alpha,
        "margin": claim_contrast.margin,
        "registered_margin": claim_contrast.registered_margin,
        "interim_margin": claim_contrast.interim_margin,
        "effect": contrast.effect,
        "mean_a": contrast.means[0],
        "mean_b": contrast.means[1],
        "low": contrast.interval.low,
        "high": contrast.interval.high,
        "simultaneous_low": contrast.simultaneous.low,
        "simultaneous_high": contrast.simultaneous.high,
        "verdict": claim_contrast.verdict,
        "registered_verdict": claim_contrast.registered_verdict,
        "rule_changes": claim_contrast.rule_changes,
        "reason": contrast.reason,
        "seeds_a": contrast.seeds[0],
        "seeds_b": contrast.seeds[1],
        "none_learned": claim_contrast.none_learned,
    }
