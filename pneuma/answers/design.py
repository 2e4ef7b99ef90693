"""Which differences the planned runs of claims can detect; no run is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.claims.contrasts import LOGARITHMIC
from pneuma.analysis.claims.design import WITHOUT_UNIT, PlannedContrast, plan_contrasts
from pneuma.answers.verdicts import list_row, selected_claims

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
    planned: list[PlannedContrast] = []
    for claim_list in claim_lists:
        for claim in claim_list.claims.values():
            for claim_world in claim.worlds:
                if is_selected(claim, claim_world):
                    planned += plan_contrasts(claim_list, claim, claim_world)
    return Answer(
        title="",
        about={"lists": list(map(list_row, claim_lists))},
        tables={"design": pd.DataFrame(map(_row, planned))},
        cells=[pd.DataFrame(map(_cells, planned))],
        legend=LEGEND,
    )


def _row(contrast: PlannedContrast) -> dict[str, Any]:
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


def _cells(contrast: PlannedContrast) -> dict[str, str]:
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
