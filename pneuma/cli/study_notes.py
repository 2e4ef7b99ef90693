"""What commands say of the runs that they read."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData


def nothing_yet(store: Store) -> str:
    """Return a message if no run is stored or published here; empty otherwise."""
    if store.runs() or store.published(shipped=False):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def told_step(data: StudyData) -> str:
    """Return at which step runs are compared, if their budgets differ; empty otherwise."""
    from pneuma.analysis.frames import common_step, step_words

    step = common_step(data)
    return f"Budgets differ: all values are those at step {step:,}, {step_words(data)}." if step else ""


def with_unit(outcome: str) -> str:
    from pneuma.analysis.outcomes import find_outcome

    unit = "" if outcome == "diverged" else find_outcome(outcome).unit  # a run's status
    return f"{outcome} ({unit})" if unit else outcome
