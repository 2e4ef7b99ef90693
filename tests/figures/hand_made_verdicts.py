"""Claims with verdicts that nobody measured, for tests of what pages and pictures make of them."""

from __future__ import annotations

from typing import Any

from pneuma.analysis.claims import Claim
from pneuma.analysis.contrasts import Contrast
from pneuma.analysis.intervals import Interval, no_interval
from pneuma.analysis.judgement import Comparison, Verdict
from pneuma.analysis.pvalues import PValues


def claim(name: str = "tanh-better", **fields: Any) -> Claim:
    """Return a claim on the mean share killed by tanh, unless fields say otherwise."""
    usual = {
        "quote": "improves performance", "section": "6.2", "study": "activation", "a": ("tanh",),
        "b": ("relu",), "outcome": "final-share-killed", "kind": "mean", "direction": "greater",
        "seeds": {"tanh": (0, 1), "relu": (0, 1)}, "steps": {"tanh": 9, "relu": 9}, "worlds": ("text",),
    }  # fmt: skip
    return Claim.model_validate({**usual, "name": name, **fields})


def comparison(
    verdict: str,
    effect: float,
    ends: tuple[float, float] | None = None,
    p: float = 1.0,
    seeds: tuple[int, int] = (10, 10),
    of: Claim | None = None,
    **more: Any,
) -> Comparison:
    """Return a contrast of tanh against relu that came to an effect."""
    own = of or claim()
    interval = Interval(*ends, "written") if ends else no_interval()
    contrast = Contrast(effect, interval, PValues(*[1.0] * 6), seeds, simultaneous=interval)
    return Comparison("tanh", "relu", own.outcome[0], contrast, verdict=verdict, p=p, **more)


def judged(own: Claim, **verdicts: tuple[str, str, tuple[Comparison, ...]]) -> dict[str, Verdict]:
    """Return a claim with its verdict, reason and contrasts in each place."""
    return {place: Verdict(own, place, *each) for place, each in verdicts.items()}
