"""The design check: whether a claim can be decided with its number of seeds, before any run.

    ClaimList with pilot spreads → [Plan], one for each contrast of a claim in a world

A claim of a direction can be decided if the least difference that is found with 80 % power, at its part of
alpha, is no greater than what is plausible. A claim of no difference can be decided if equal arms would be
shown to lie within the margin. Spreads come from a pilot on other seeds, which is in the claims' file with
the command that printed it. A claim that cannot be decided in a world is not admitted there.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass

import numpy as np
from scipy import special

from pneuma.analysis.claims import Claim, ClaimList
from pneuma.analysis.pvalues import count_chances, incidence_p_values, one_share_p_values, share_table

POWER = 0.8
"""The power at which contrasts are planned."""

SHARES = np.linspace(0, 1, 101)
"""True shares that are searched for the least detectable difference, and margins for the least provable."""
UNKNOWN_SHARE = 0.5
"""The share of runs with an event if no pilot tells it: where shares vary most."""


@dataclass(frozen=True)
class Plan:
    """What the seeds of one contrast can show.

    Attributes:
        a, b: the arms; b may be a number.
        seeds: of each arm.
        alpha: the contrast's own part of the list's error rate.
        spread: between runs, from the pilot; for an incidence the share of runs of arm b; None without a
            pilot.
        detectable: the least difference that is found with 80 % power.
        provable: the least margin within which equal arms are shown to lie with 80 % power.
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
    detectable: float | None
    provable: float | None
    reason: str


def check_design(claims: ClaimList) -> list[Plan]:
    """Return what the seeds of each claim can show, in each of its worlds."""
    return [
        _plan(claims, claim.in_world(world), world, outcome, a, b)
        for claim in claims.claims.values()
        for world in claim.worlds
        for outcome in claim.outcome
        for a, b in claim.pairs
    ]


def not_admitted(claims: ClaimList) -> dict[tuple[str, str], str]:
    """Return why claims are not admitted, by claim and world; empty if the list has no pilot.

    A claim is admitted if one of its outcomes can be decided in all contrasts, or with `need = "any"` in one.
    """
    if claims.pilot is None:
        return {}
    plans: dict[tuple[str, str], dict[str, list[Plan]]] = {}
    for plan in check_design(claims):
        plans.setdefault((plan.claim.name, plan.world), {}).setdefault(plan.outcome, []).append(plan)
    refused = {}
    for key, outcomes in plans.items():
        enough = all if claims.claims[key[0]].need == "all" else any
        if not any(enough(not row.reason for row in each) for each in outcomes.values()):
            reasons = dict.fromkeys(row.reason for each in outcomes.values() for row in each if row.reason)
            refused[key] = "; ".join(reasons)
    return refused


def _plan(claims: ClaimList, claim: Claim, world: str, outcome: str, a: str, b: str | None) -> Plan:
    names = [name for name in (a, b, *claim.c, *claim.d) if name is not None]
    seeds = tuple(len(claim.seeds[name]) for name in names)
    alpha = claims.head.alpha / claims.factor(claim, world)
    spreads = claims.pilot.spreads.get(world, {}) if claims.pilot else {}
    spread = spreads.get(f"{outcome} {claim.event}" if claim.event else outcome)
    detectable = provable = None
    if claim.event:
        spread = UNKNOWN_SHARE if spread is None else spread
        base = spread if claim.value is None else claim.value
        detectable = _least_share(claim, seeds, alpha, base)
        if claim.direction == "equal":
            provable = _least_margin(seeds, alpha, base)
    elif spread is not None:
        error = spread * math.sqrt(sum(1 / count for count in seeds))
        welch = sum(1 / count**2 / max(count - 1, 1) for count in seeds)  # of arms that spread alike
        freedom = sum(1 / count for count in seeds) ** 2 / welch
        detectable, provable = (  # Student's statistic is past the critical one with that chance
            float(error * special.nctdtrinc(freedom, missed, special.stdtrit(freedom, 1 - error_rate)))
            for missed, error_rate in ((1 - POWER, alpha / 2), ((1 - POWER) / 2, alpha))
        )
        smallest = {1: 0.5 ** seeds[0], 2: 1 / math.comb(sum(seeds), seeds[0])}.get(len(seeds), 0.0)
        if min(seeds) < 2 or 2 * smallest > alpha:
            detectable = math.inf
        if min(seeds) < 2 or smallest > alpha:
            provable = math.inf
    least, most = detectable, claim.of("plausible", outcome)
    words = "the least difference found is {:.3g}, and {:.3g} is plausible"
    if claim.direction == "equal":
        least, most = provable, claim.of("margin", outcome)
        words = "arms alike are shown to lie within {:.3g}, and the margin is {:.3g}"
    reason = ""
    if least is None:
        reason = f"no pilot has a spread of {outcome}"
    elif most is None:
        reason = f"no largest plausible effect on {outcome} is stated"
    elif least > most:
        reason = f"cannot be decided with so many seeds ({sum(seeds)} runs): {words.format(least, most)}"
    against = f"{claim.value:g}" if b is None else b
    return Plan(claim, world, outcome, a, against, seeds, alpha, spread, detectable, provable, reason)


def _least_share(claim: Claim, seeds: tuple[int, ...], alpha: float, base: float) -> float:
    """Return the least difference from a base share that is found in the claimed direction.

    The base is arm b's share of runs, or the constant. Infinite if no share would be found.
    """
    if len(seeds) == 2:
        weights = count_chances(seeds[1], np.array([base]))[0]
        tables = share_table(*seeds), share_table(*seeds[::-1]).T
        above, below = ((2 * table <= alpha) @ weights for table in tables)  # by each count of runs of a
    else:
        p = one_share_p_values(np.arange(seeds[0] + 1), seeds[0], base, None)
        above, below = 2 * p.greater <= alpha, 2 * p.less <= alpha
    chances = count_chances(seeds[0], SHARES)
    least = math.inf
    for opposite, decided, beyond in (("less", above, SHARES - base), ("greater", below, base - SHARES)):
        if claim.direction != opposite:
            found = beyond[(chances @ decided >= POWER) & (beyond > 0)]
            least = min(least, float(found.min(initial=math.inf)))
    return least


def _least_margin(seeds: tuple[int, ...], alpha: float, base: float) -> float:
    """Return the least margin within which arms of the base share are shown to lie; infinite if none."""
    counts = np.indices([runs + 1 for runs in seeds]).reshape(len(seeds), -1)
    of_arms = [count_chances(runs, np.array([base]))[0][k] for runs, k in zip(seeds, counts, strict=True)]
    chances = np.prod(of_arms, axis=0)

    def shown(margin: float) -> bool:
        if len(seeds) == 2:
            p = incidence_p_values(counts[0], seeds[0], counts[1], seeds[1], margin)
        else:
            p = one_share_p_values(counts[0], seeds[0], base, margin)
        return bool(chances @ (p.equivalent <= alpha) >= POWER)

    place = bisect_left(SHARES, True, lo=1, key=shown)
    return float(SHARES[place]) if place < len(SHARES) else math.inf
