"""The design check: whether a claim can be decided with its number of seeds, before any run.

    ClaimList with pilot spreads → [Plan], one for each contrast of a claim in a world

A claim of a direction can be decided where the least difference that is found with 80 % power, at its part of
alpha, is no greater than what is plausible; one of no difference where arms alike would be shown to lie
within the margin. Spreads come from a pilot on other seeds, written into the claims' file with the command
that printed them. A claim that cannot be decided in a world is not admitted there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from pneuma.analysis.claims import Claim, ClaimList
from pneuma.analysis.pvalues import count_chances, one_share_p_values, share_table

POWER = 0.8
"""The power at which contrasts are planned."""

SHARES = np.linspace(0, 1, 101)
"""True shares that are searched for the least detectable difference."""
UNKNOWN_SHARE = 0.5
"""The share of runs with an event if no pilot tells it: where shares vary most."""


@dataclass(frozen=True)
class Plan:
    """What the seeds of one contrast can show.

    Attributes:
        a, b: the arms; b is a number where a is held against one.
        seeds: of each arm.
        alpha: the contrast's own part of the list's error rate.
        spread: between runs, from the pilot; of an incidence the share of runs of arm b; None without one.
        detectable: the least difference that is found with 80 % power.
        provable: the least margin within which arms alike are shown to lie with 80 % power.
        reason: why it cannot be decided; empty where it can.
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

    A claim is admitted where one of its outcomes can be decided: in all its contrasts, or in any where it
    needs no more.
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
        detectable = _least_share(claim, seeds, alpha, spread if claim.value is None else claim.value)
    elif spread is not None:
        error = spread * math.sqrt(sum(1 / count for count in seeds))
        freedom = max(sum(seeds) - len(seeds), 1)
        detectable = float(error * (special.stdtrit(freedom, 1 - alpha / 2) + special.ndtri(POWER)))
        provable = float(error * (special.stdtrit(freedom, 1 - alpha) + special.ndtri((1 + POWER) / 2)))
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

    Of two arms the base is arm b's share of runs, of one the constant. Infinite where no share is found.
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
