"""Claims with verdicts that nobody measured, for tests of what pages and pictures make of them."""

from __future__ import annotations

from typing import Any

from pneuma.analysis.claims.claim_list import Claim
from pneuma.analysis.claims.contrasts import Contrast
from pneuma.analysis.claims.verdicts import PREREGISTERED, ClaimContrast, Verdict
from pneuma.analysis.intervals import Interval, no_interval


def claim(name: str = "tanh-better", outcome: str = "final-share-killed", **fields: Any) -> Claim:
    """Return a claim on the mean share killed by tanh, unless fields say otherwise."""
    usual = {
        "quote": "improves performance", "section": "6.2", "study": "activation", "a": ("tanh",),
        "b": ("relu",), "kind": "mean", "direction": "greater", "seeds": (0, 1), "steps": 9,
        "worlds": ("text",),
    }  # fmt: skip
    return Claim.model_validate({**usual, "name": name, "outcome": tuple(outcome.split()), **fields})


def comparison(
    verdict: str,
    effect: float,
    ends: tuple[float, float] | None = None,
    seeds: tuple[int, int] = (10, 10),
    of: Claim | None = None,
    means: tuple[float, float] | None = None,
    **more: Any,
) -> ClaimContrast:
    """Return a contrast of tanh against relu that came to an effect."""
    one_claim = of or claim()
    interval = Interval(*ends, "written") if ends else no_interval()
    contrast = Contrast(effect, interval, interval, seeds, means or (0.5 + effect, 0.5))
    where: dict[str, Any] = {
        "world": "text",
        "outcome": one_claim.outcome[0],
        "a": one_claim.a,
        "b": one_claim.b,
        **more,
    }
    place = "text", where["outcome"]
    planned: dict[str, Any] = {"value": one_claim.value_of(*place), "margin": one_claim.margin_of(*place)}
    planned["direction"] = one_claim.direction_of(where["outcome"])
    return ClaimContrast(claim=one_claim, **where, **planned, contrast=contrast, verdict=verdict)


def judged(one_claim: Claim, **verdicts: tuple[str, str, tuple[ClaimContrast, ...]]) -> dict[str, Verdict]:
    """Return a claim with its verdict, reason and contrasts in each world."""
    return {world: Verdict(one_claim, world, *each, label=PREREGISTERED) for world, each in verdicts.items()}
