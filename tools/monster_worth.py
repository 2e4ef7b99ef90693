"""What one monster is worth in returns, for margins in studies/claims.toml: `python -m tools.monster_worth`.

In each world the slope of the least-squares line of returns on monsters killed: of each run the return at the
end of training, and 14 times the share killed, mean of the last five evaluations. The runs are all published
ones that claims compare by their return.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pneuma.analysis.claims.claim_list import ClaimList, shipped_claims
from pneuma.analysis.claims.fixed_runs import find_claim_runs
from pneuma.analysis.outcomes import outcome
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.rows import Row
from pneuma.store.store import Store

MONSTERS = 14
RETURN, KILLS = "final-return", "late-share-killed"
NOWHERE = Path(__file__).with_name("no-results")
"""A results folder that is not there: only published tables are read."""


def main() -> None:
    claims, *_ = shipped_claims()
    index = RunIndex(Store(NOWHERE))
    for world in WORLDS:
        rows = compared_by_return(claims, index, world)
        print(f"{world}: {monster_worth(rows):.2g} ({len(rows)} runs)")


def compared_by_return(claims: ClaimList, index: RunIndex, world: str) -> list[Row]:
    rows: dict[str, Row] = {}
    for claim in claims.on("", world):
        if RETURN in claim.outcome:
            runs = find_claim_runs(index, claims.studies[claim.study].in_world(world), claim)
            rows |= {row.run_id: row for row in runs.data.rows}
    return [*rows.values()]


def monster_worth(rows: list[Row]) -> float:
    """Return by how much the return rises with one more monster killed."""
    killed = [MONSTERS * outcome(row, KILLS) for row in rows]
    returns = [outcome(row, RETURN) for row in rows]
    slope, _ = np.polyfit(killed, returns, 1)
    return float(slope)


if __name__ == "__main__":
    main()
