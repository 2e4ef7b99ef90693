"""What the planned seeds of claims can decide, before there is any run.

    PlannedContrast → ContrastDesign: the expected half width of its interval, and its margin

The interval is made by the code that judges, of runs that do not differ: normal ones with a standard
deviation of 1, or runs half of which have the event. A claim states no spread, so that the half width of
means is in standard deviations; margin / half width is the largest one with which the seeds can decide.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from pneuma.analysis.answer import Answer
from pneuma.analysis.claims.claim_list import PlannedContrast
from pneuma.analysis.claims.contrasts import LOGARITHMIC, compare
from pneuma.analysis.claims.verify import list_row, selected_claims

EVENT_SHARE = 0.5
"""The share of runs with an event, unless the claim compares it with a number: shares vary most there."""
WITHOUT_UNIT = ("incidence", *LOGARITHMIC)
"""Kinds whose interval does not depend on how far runs spread."""


@dataclass(frozen=True, kw_only=True)
class ContrastDesign(PlannedContrast):
    """What the planned seeds can show of a contrast.

    Attributes:
        seeds: planned for each condition of a, then of b.
        half_width: of its interval; in standard deviations of runs, but of an incidence a share of runs, and
            of a hazard or a spread the logarithm of a ratio. NaN if so few runs have no interval.
        reason: why the seeds cannot decide it; empty if they can, with runs that spread little enough.
    """

    seeds: tuple[int, ...]
    half_width: float
    reason: str

    @property
    def largest_sd(self) -> float:
        """The largest standard deviation of runs with which the seeds can decide; NaN if none matters."""
        if self.margin is None or self.claim.kind in WITHOUT_UNIT:
            return math.nan
        return self.margin / self.half_width


def design_contrast(planned: PlannedContrast) -> ContrastDesign:
    """Return what the planned seeds of a contrast can show."""
    claim, a, b, margin = planned.claim, planned.a, planned.b, planned.margin
    seeds = {condition: len(claim.seeds_of(condition)) for condition in a + b}
    constant, share = 0.0, EVENT_SHARE
    if isinstance(planned.value, float) and planned.value and claim.is_incidence:
        constant = share = planned.value
    expected = {condition: _expected_runs(claim.kind, count, share) for condition, count in seeds.items()}
    contrast = compare(
        claim.kind,
        {condition: expected[condition] for condition in a},
        {condition: expected[condition] for condition in b},
        1 - planned.alpha,
        constant,
    )
    half_width = (contrast.simultaneous.high - contrast.simultaneous.low) / 2
    reason = contrast.reason
    if not reason and margin is not None and claim.kind in WITHOUT_UNIT and half_width > margin:
        reason = f"{sum(seeds.values())} runs tell it to ±{half_width:.3g} only"
    return ContrastDesign(**vars(planned), seeds=tuple(seeds.values()), half_width=half_width, reason=reason)


def _expected_runs(kind: str, count: int, share: float) -> np.ndarray:
    """Return runs as `compare` takes them, (runs,), of a hazard (2, runs)."""
    quantiles = (np.arange(count) + 0.5) / count
    has_event = (np.arange(count) < round(share * count)).astype(float)
    if kind == "incidence":
        return has_event
    if kind == "hazard":
        return np.stack([quantiles, has_event])
    scores = special.ndtri(quantiles)
    return scores / scores.std(ddof=1) if count > 1 else scores


# --- The answer -------------------------------------------------------------------------------------

LEGEND = (
    "Half width: of the interval that decides, if there is no difference; in standard deviations (SD) of",
    "runs, or of incidences as a share of runs, half of which have the event. The seeds can decide a claim",
    "if that is not above the margin: if runs have at most the SD of the last column.",
)
UNITS = {"incidence": "of runs", **dict.fromkeys(LOGARITHMIC, "of a logarithm")}


def design(
    claims_path: Path | None = None, claim_names: Sequence[str] = (), world: str | None = None
) -> Answer:
    """Show which differences the planned runs of claims can detect; the arguments are those of `verify`.

    Returns:
        The table `design` has a row for each claim, world, outcome and pair of conditions.
    """
    claim_lists, is_selected = selected_claims(claims_path, claim_names, world)
    designs: list[ContrastDesign] = []
    for claim_list in claim_lists:
        for claim in claim_list.claims.values():
            for claim_world in claim.worlds:
                if is_selected(claim, claim_world):
                    designs += map(design_contrast, claim_list.contrasts_of(claim, claim_world))
    return Answer(
        title="",
        about={"lists": list(map(list_row, claim_lists))},
        tables={"design": pd.DataFrame(map(_row, designs))},
        cells=[pd.DataFrame(map(_cells, designs))],
        legend=LEGEND,
    )


def _row(contrast: ContrastDesign) -> dict[str, Any]:
    return {
        "claim": contrast.claim.name,
        "world": contrast.world,
        "outcome": contrast.outcome,
        "a": ", ".join(contrast.a),
        "b": ", ".join(contrast.b),
        "seeds": list(contrast.seeds),
        "alpha": contrast.alpha,
        "half_width": contrast.half_width,
        "margin": contrast.margin,
        "largest_sd": contrast.largest_sd,
        "reason": contrast.reason,
    }


def _cells(contrast: ContrastDesign) -> dict[str, str]:
    half_width = margin = "–"
    decided = contrast.reason
    if contrast.half_width == contrast.half_width:
        half_width = f"{contrast.half_width:.3g} {UNITS.get(contrast.claim.kind, 'SD')}"
    if contrast.margin is not None:
        margin = f"{contrast.margin:.3g}"
    elif not decided:
        decided = "differences above the half width"
    if not decided and contrast.claim.kind not in WITHOUT_UNIT:
        decided = f"with an SD up to {contrast.largest_sd:.3g}"
    return {
        "claim": contrast.claim.name,
        "world": contrast.world,
        "outcome": contrast.outcome,
        "seeds": "/".join(map(str, contrast.seeds)),
        "half width": half_width,
        "margin": margin,
        "can be decided": decided or "yes",
    }
