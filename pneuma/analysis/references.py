"""What a study's conditions can be held against: players of known skill, and each other's returns."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pneuma.analysis.outcomes import is_return
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError

PLAYERS = ("random player", "scripted hunter")
NEAR = 0.02
"""Levels that lie no further apart are drawn as one line."""

_COLUMNS = {
    "share_killed": ("random_share_killed", "hunter_share_killed"),
    "argmax_share_killed": ("random_share_killed", "hunter_share_killed"),
}


_OF_RETURNS = ("reward", "players")
"""Settings of which a return is the sum: where they differ, returns are in unlike units."""


def have_one_return(data: StudyData, conditions: Iterable[str] | None = None) -> bool:
    """Tell whether conditions, or all, have the same reward and as many players: else no returns compare."""
    names = data.conditions if conditions is None else conditions
    settings = [data.settings(own[0]) for name in names if (own := data.of_condition(name))]
    return len({str([own.get(key) for key in _OF_RETURNS]) for own in settings}) <= 1


def refuse_unlike_returns(data: StudyData, outcome: str, conditions: Iterable[str] | None = None) -> None:
    """Refuse to compare conditions, or all, by an outcome that is of another unit in some.

    Raises:
        UserError: for a return, where rewards or numbers of players differ.
    """
    if is_return(outcome) and not have_one_return(data, conditions):
        raise UserError(
            f"outcome {outcome}: returns of unlike rewards, or of more players, cannot be compared; "
            "name another, such as final-share-killed"
        )


def reference_levels(data: StudyData, quantity: str) -> dict[str, dict[str, float]]:
    """Return the level of each of `PLAYERS` in every condition, as far as evaluations recorded it.

    A normalised score is 0 and 1 for them by its definition; returns of theirs are not recorded.
    """
    if quantity == "score":
        return {condition: dict(zip(PLAYERS, (0.0, 1.0), strict=True)) for condition in data.conditions}
    if quantity not in _COLUMNS or "evaluations" not in data.tables:
        return {}
    levels = {}
    for condition in data.conditions:
        tables = [data.run_table(run, "evaluations") for run in data.of_condition(condition)]
        rows = [table[[*_COLUMNS[quantity]]].to_numpy(float) for table in tables if len(table)]
        if rows:
            levels[condition] = dict(zip(PLAYERS, np.concatenate(rows).mean(axis=0).tolist(), strict=True))
    return levels


def shared_levels(data: StudyData, quantity: str) -> dict[str, float]:
    """Return the levels that hold for all conditions; none where their environments differ in them."""
    levels = [list(level.values()) for level in reference_levels(data, quantity).values()]
    if not levels or np.ptp(levels, axis=0).max() > NEAR:
        return {}
    return dict(zip(PLAYERS, np.mean(levels, axis=0).tolist(), strict=True))
