"""What commands say of the runs that they read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData


def what_is_shown(data: StudyData) -> dict[str, Any]:
    """Return which runs of a study a document is about."""
    amount = {"steps": data.steps, "seeds": sorted({*data.runs["seed"].tolist()})}
    settings = dict(data.study.settings)
    return {"study": data.study.name, "world": data.world or None, **amount, "settings": settings}


def nothing_yet(store: Store) -> str:
    """Return a message if no run is stored or published here; empty otherwise."""
    if store.runs() or store.published(shipped=False):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def with_unit(outcome: str) -> str:
    from pneuma.analysis.outcomes import find_outcome

    unit = "" if outcome == "diverged" else find_outcome(outcome).unit  # a run's status
    return f"{outcome} ({unit})" if unit else outcome
