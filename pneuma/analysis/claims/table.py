"""The table of contrasts: one row for each claim, world, outcome and pair of arms.

    ClaimList → [ClaimContrast], planned here before any run; `verdicts.py` adds what the runs show

Every verdict, the design check, pages and pictures are views of these rows. The plan has the half width that
the simultaneous interval is expected to have, which must not exceed the margin. It is the interval of arms
that have so many runs, spread normally as the pilot's, and do not differ, made by the code of real intervals.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import special

from pneuma.analysis.claims.claim_list import Claim, ClaimList
from pneuma.analysis.claims.contrasts import Contrast, compare_arms

UNKNOWN_SHARE = 0.5
"""The share of runs with an event if the pilot has none: where shares vary most."""


@dataclass(frozen=True)
class ClaimContrast:
    """One row: a contrast of a claim in a world.

    Attributes:
        a, b: the conditions of either arm, several for a range; b is empty for a constant.
        planned: the number of seeds of each condition.
        alpha: the contrast's own part of the list's error rate in the world.
        spread: between runs, from the pilot; for an incidence the share of runs; None without a pilot.
        half_width: expected, of its simultaneous interval; None without a spread.
        why_undecidable: why so many seeds cannot decide it; empty if they can.
        refused: why its claim is not admitted in the world; empty if it is, or the list has no pilot.
        contrast: what the runs show; its reason is not empty if nothing can be concluded.
        runs: the ids of the runs that were read, by condition.
        verdict: on this contrast alone; empty before it is judged.
        none_learned: whether neither arm is shown to play better than the random player, so that being alike
            counts for nothing.
    """

    claim: Claim
    world: str
    outcome: str
    a: tuple[str, ...]
    b: tuple[str, ...]
    planned: tuple[int, ...] = ()
    alpha: float = 1.0
    spread: float | None = None
    half_width: float | None = None
    why_undecidable: str = ""
    refused: str = ""
    contrast: Contrast = Contrast()
    runs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    verdict: str = ""
    none_learned: bool = False

    @property
    def margin(self) -> float | None:
        return self.claim.margin_of(self.world, self.outcome)

    @property
    def value(self) -> float:
        """The constant that arm a is compared with; 0 if there is none."""
        return self.claim.value_of(self.world, self.outcome) or 0.0

    @property
    def conditions(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.a, *self.b)))

    @property
    def names(self) -> tuple[str, str]:
        """The arms as text; b may be a number."""
        return ", ".join(self.a), ", ".join(self.b) or f"{self.value:g}"

    @property
    def has_effect(self) -> bool:
        return math.isfinite(self.contrast.effect)

    def compare(self, values: Mapping[str, np.ndarray]) -> Contrast:
        """Return the contrast of runs, (runs,) of each condition."""
        a = {name: values[name] for name in self.a}
        b = {name: values[name] for name in self.b} or self.value
        return compare_arms(self.claim.kind, a, b, 1 - self.alpha)


def plan_contrasts(claims: ClaimList) -> list[ClaimContrast]:
    table: list[ClaimContrast] = []
    for claim in claims.claims.values():
        for world in claim.worlds:
            table += plan_claim(claims, claim, world)
    return table


def plan_claim(claims: ClaimList, claim: Claim, world: str) -> list[ClaimContrast]:
    alpha = claims.head.alpha / claims.contrasts(world)
    rows: list[ClaimContrast] = []
    for outcome in claim.outcome:
        for a, b in claim.pairs:
            planned = tuple(len(claim.seeds_of(name)) for name in (*a, *b))
            row = ClaimContrast(claim, world, outcome, a, b, planned, alpha)
            rows.append(_with_half_width(row, _spread(claims, row)))
    refused = _why_refused(rows) if claims.pilot else ""
    return [replace(row, refused=refused) for row in rows]


def _why_refused(rows: Sequence[ClaimContrast]) -> str:
    """Return why a claim is not admitted; empty if one of its outcomes can be decided in all contrasts.

    All of them must be if the claim needs all, and runs that were seen are described however few they are.
    """
    claim = rows[0].claim
    undecidable = {row.outcome for row in rows if row.why_undecidable}
    is_admitted = undecidable < {*claim.outcome} if claim.need == "one" else not undecidable
    if is_admitted or claim.seen:
        return ""
    return "; ".join(dict.fromkeys(row.why_undecidable for row in rows if row.why_undecidable))


def _spread(claims: ClaimList, row: ClaimContrast) -> float | None:
    spread = row.claim.spread_of(row.world, row.outcome)
    if spread is None and claims.pilot:
        name = f"{row.outcome} {row.claim.event(row.outcome)}".strip()
        spread = claims.pilot.spreads.get(row.world, {}).get(name)
    return UNKNOWN_SHARE if row.claim.is_incidence and spread is None else spread


def _with_half_width(row: ClaimContrast, spread: float | None) -> ClaimContrast:
    """Return a row with the half width that its interval is expected to have, and if that is too wide why."""
    if spread is None:
        return replace(row, why_undecidable=f"no pilot has a spread of {row.outcome}")
    sample = _share if row.claim.is_incidence else _normal
    names = (*row.a, *row.b)
    expected = row.compare(
        {name: sample(runs, spread) for name, runs in zip(names, row.planned, strict=True)}
    )
    if expected.reason:
        return replace(row, spread=spread, why_undecidable=expected.reason)
    half = (expected.simultaneous.high - expected.simultaneous.low) / 2
    reason = ""
    if row.margin is None:
        reason = f"no margin of {row.outcome} is stated"
    elif not half <= row.margin:
        reason = f"{sum(row.planned)} runs tell it to ±{half:.3g} only, and the margin is {row.margin:.3g}"
    return replace(row, spread=spread, half_width=half, why_undecidable=reason)


def _normal(runs: int, spread: float) -> np.ndarray:
    """Return runs as a normal sample of mean 0 has them, (runs,)."""
    scores = special.ndtri((np.arange(runs) + 0.5) / runs)
    return spread * scores / scores.std(ddof=1) if runs > 1 else scores


def _share(runs: int, share: float) -> np.ndarray:
    return (np.arange(runs) < round(share * runs)).astype(float)
