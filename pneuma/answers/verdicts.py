"""Verdicts on claims, all of them views of one table of contrasts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.claims import words
from pneuma.analysis.claims.claim_list import RULES, Claim, ClaimList, load_claims, shipped_claims
from pneuma.analysis.claims.verdicts import ClaimContrast, Verdict, judge
from pneuma.answers.answer import Answer
from pneuma.errors import unknown_name
from pneuma.store.index import RunIndex

LEGEND = (
    "In brackets: the confidence interval of the difference, and the margin (± or, of a factor, ×), the",
    "smallest difference that counts. docs/claims.md explains words, labels and margins.",
    "Kills are the mean of the last five evaluations, returns of the last 5 % of training.",
    f"Rules of the judge: version {RULES}. The intervals of a family hold jointly:",
)
OF_CLAIM = ("row", "section", "quote", "context", "study", "kind", "direction", "need", "seen")
"""What a document has of a claim beside its name."""


@dataclass(frozen=True)
class VerdictsAnswer(Answer):
    """The verdicts on claims.

    Attributes:
        verdicts: by claim and world.
    """

    verdicts: Mapping[str, Mapping[str, Verdict]] = field(default_factory=dict)

    @property
    def document(self) -> dict[str, Any]:
        """Each claim with its contrasts."""
        return dict(self.about)


def verify(
    index: RunIndex, file: Path | None = None, names: Sequence[str] = (), world: str | None = None
) -> VerdictsAnswer:
    """Judge the thesis's claims, or those of another list, on the runs that they fixed.

    Args:
        index: the runs of a results folder, and published ones.
        file: a list of claims; default: those on the thesis.
        names: of claims; default: all.
        world: only this one.

    Returns:
        The table `contrasts` has a row for each claim, world, outcome and pair of arms.

    Raises:
        UserError: for a list that is not allowed, or names that are not in it.
    """
    lists = [load_claims(file)] if file else shipped_claims()
    known_names = [name for claims in lists for name in claims.claims]
    for name in names:
        if name not in known_names:
            raise unknown_name("claim", name, known_names)

    def wanted(claim: Claim, where: str) -> bool:
        return (not names or claim.name in names or claim.like in names) and world in (None, where)

    verdicts: list[Verdict] = []
    legend = list(LEGEND)
    for claims in lists:
        verdicts += judge(claims, index, wanted)
        family = {"list": "a world", "study": "a study in a world"}[claims.head.families]
        level = f"{100 - 100 * claims.head.alpha:g} %, for {family}"
        legend.append(f"  {claims.path.name}: {level}; SHA-256 {claims.digest[:16]}…")
    contrasts = [_contrast_row(row) for verdict in verdicts for row in verdict.contrasts]
    by_claim = words.verdicts_by_claim(verdicts)
    about = {
        "rules": RULES,
        "lists": [_list_row(claims) for claims in lists],
        "claims": [_verdict_row(verdict) for verdict in verdicts],
    }
    return VerdictsAnswer(
        title="",
        about=about,
        tables={"contrasts": pd.DataFrame(contrasts)},
        cells=[words.verdict_table(by_claim), words.count_words(by_claim)],
        notes=[f"{problem}." for problem in index.problems],
        legend=legend + [_origin(index, verdicts)],
        verdicts=by_claim,
    )


def _origin(index: RunIndex, verdicts: Sequence[Verdict]) -> str:
    """Return how many of the runs that were read are the user's own, which count before published ones."""
    run_ids = {run_id for verdict in verdicts for run_id in verdict.run_ids}
    own_runs = int((index.frame.loc[list(run_ids), "where"] == "").sum())
    return f"Read {own_runs:,} runs from {index.store.root} and {len(run_ids) - own_runs:,} published runs."


def _list_row(claims: ClaimList) -> dict[str, Any]:
    return {
        "file": claims.path.name,
        "claims_hash": claims.digest,
        "alpha": claims.head.alpha,
        "families": claims.head.families,
    }


def _verdict_row(verdict: Verdict) -> dict[str, Any]:
    """Return the row that decides first, with the claim's own verdict and reason, and all its rows."""
    return {
        **_contrast_row(verdict.deciding[0]),
        "word": words.word(verdict),
        "verdict": verdict.verdict,
        "registered_verdict": verdict.registered_verdict,
        "label": verdict.label,
        "changed": verdict.changed,
        "reason": verdict.reason,
        "run_ids": verdict.run_ids,
        **{key: getattr(verdict.claim, key) for key in OF_CLAIM},
        "outcomes": verdict.claim.outcome,
        "contrasts": [{**_contrast_row(row), "runs": row.runs} for row in verdict.contrasts],
    }


def _contrast_row(row: ClaimContrast) -> dict[str, Any]:
    """Return a row of the table: what was planned, and what the runs show."""
    contrast, (a, b) = row.contrast, row.names
    return {
        "claim": row.claim.name,
        "world": row.world,
        "outcome": row.outcome,
        "a": a,
        "b": b,
        "alpha": row.alpha,
        "margin": row.margin,
        "registered_margin": row.registered_margin,
        "effect": contrast.effect,
        "mean_a": contrast.means[0],
        "mean_b": contrast.means[1],
        "low": contrast.interval.low,
        "high": contrast.interval.high,
        "simultaneous_low": contrast.simultaneous.low,
        "simultaneous_high": contrast.simultaneous.high,
        "verdict": row.verdict,
        "registered_verdict": row.registered_verdict,
        "reason": contrast.reason,
        "seeds_a": contrast.seeds[0],
        "seeds_b": contrast.seeds[1],
        "none_learned": row.none_learned,
    }
