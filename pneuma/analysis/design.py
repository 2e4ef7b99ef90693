"""The design check: how near a claim's seeds can tell its effect, before any run.

    ClaimList with pilot spreads → [Plan], one for each contrast of a claim in a world

A contrast is decidable if the half width of its simultaneous interval is expected to be no greater than its
margin. The expected interval is that of arms as they would be: so many runs, spread normally as those of the
pilot, by the code that makes the real intervals. A claim of which no outcome is decidable in a world is not
admitted there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from pneuma.analysis.claims import Claim, ClaimList
from pneuma.analysis.contrasts import compare_ranges, estimate
from pneuma.analysis.intervals import Interval

UNKNOWN_SHARE = 0.5
"""The share of runs with an event if no pilot tells it: where shares vary most."""


@dataclass(frozen=True)
class Plan:
    """What the seeds of one contrast can show.

    Attributes:
        a, b: the arms; b may be a number.
        seeds: of each arm.
        alpha: the contrast's own part of the list's error rate in the world.
        spread: between runs, from the pilot; for an incidence the share of runs; None without a pilot.
        half_width: expected, of its simultaneous interval; None without a spread.
        margin: that the half width must not exceed; None without one.
        reason: why it cannot be decided; empty if it can.
    """

    claim: Claim
    world: str
    outcome: str
    a: str
    b: str
    seeds: tuple[int, ...]
    alpha: float
    spread: float | None
    half_width: float | None
    margin: float | None
    reason: str


def check_design(claims: ClaimList) -> list[Plan]:
    """Return what the seeds of each claim can show, in each world in which runs are trained for it."""
    return [
        _plan(claims, claim.in_world(world), world, outcome, a, b)
        for claim in claims.claims.values()
        for world in claim.worlds
        if world not in claims.head.seen
        for outcome in claim.outcome
        for a, b in claim.pairs
    ]


def not_admitted(claims: ClaimList) -> dict[tuple[str, str], str]:
    """Return why claims are not admitted, by claim and world; empty if the list has no pilot.

    A claim is admitted if one of its outcomes can be decided in all contrasts.
    """
    if claims.pilot is None:
        return {}
    plans: dict[tuple[str, str], dict[str, list[Plan]]] = {}
    for plan in check_design(claims):
        plans.setdefault((plan.claim.name, plan.world), {}).setdefault(plan.outcome, []).append(plan)
    refused = {}
    for key, outcomes in plans.items():
        if all(any(row.reason for row in each) for each in outcomes.values()):
            reasons = dict.fromkeys(row.reason for each in outcomes.values() for row in each if row.reason)
            refused[key] = "; ".join(reasons)
    return refused


def arms_of(names: tuple[str, ...], value: float | None) -> str:
    return ", ".join(names) if names else f"{value:g}"


def _plan(
    claims: ClaimList, claim: Claim, world: str, outcome: str, a: tuple[str, ...], b: tuple[str, ...]
) -> Plan:
    seeds = tuple(len(claim.seeds_in(world)[name]) for name in (*a, *b))
    alpha = claims.head.alpha / claims.contrasts(world)
    spreads = claims.pilot.spreads.get(world, {}) if claims.pilot else {}
    measured = f"{outcome} {claim.event}" if claim.event else outcome
    spread = claim.of("spread", outcome) or spreads.get(measured)
    if claim.event and spread is None:
        spread = UNKNOWN_SHARE
    margin, value = claim.of("margin", outcome), claim.of("value", outcome)
    half, reason = None, ""
    if spread is not None:
        interval = _expected(claim, dict(zip((*a, *b), seeds, strict=True)), a, b, value, spread, 1 - alpha)
        half = (interval.high - interval.low) / 2 if interval.exists else 0.0  # runs that are all alike
    if half is None:
        reason = f"no pilot has a spread of {outcome}"
    elif margin is None:
        reason = f"no margin of {outcome} is stated"
    elif not half <= margin:
        reason = f"{sum(seeds)} runs tell it to ±{half:.3g} only, and the margin is {margin:.3g}"
    names = arms_of(a, None), arms_of(b, value)
    return Plan(claim, world, outcome, *names, seeds, alpha, spread, half, margin, reason)


def _expected(
    claim: Claim,
    runs: dict[str, int],
    a: tuple[str, ...],
    b: tuple[str, ...],
    value: float | None,
    spread: float,
    level: float,
) -> Interval:
    """Return the interval of arms that spread as the pilot's, and do not differ."""
    sample = _share if claim.event else _normal
    arms = {name: sample(count, spread) for name, count in runs.items()}
    if claim.kind == "range":
        names = [*arms]
        places = [[names.index(name) for name in group] for group in (a, b)]
        made = compare_ranges([*arms.values()], places[0], places[1] or 0.0, None, level)
        return made.simultaneous
    return estimate(claim.kind, arms[a[0]], arms[b[0]] if b else float(value or 0))[1](level)


def _normal(runs: int, spread: float) -> np.ndarray:
    """Return runs as a normal sample of mean 0 has them, (runs,)."""
    scores = special.ndtri((np.arange(runs) + 0.5) / runs)
    return spread * scores / scores.std(ddof=1)


def _share(runs: int, share: float) -> np.ndarray:
    return (np.arange(runs) < round(share * runs)).astype(float)
