"""Which condition has which colour: in every figure of a study the same, and the same in related studies.

A study's conditions take the looks of `style` in their order. But some configurations stand in several
studies under other names: Table 6.2 is `tanh` beside ReLU, `non-stationary` beside the other Adam.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pneuma.figures.crossed import read_name
from pneuma.figures.style import condition_look

MOST_IN_A_PANEL = 7
"""Conditions that share a panel at most: so many looks can be told apart."""

OWN_PLACES = {
    **dict.fromkeys(
        ("table-6-2", "tanh", "non-stationary", "smallest", "0.1", "thesis", "final", "alone"), 0
    ),
    **dict.fromkeys(("relu", "stationary"), 1),
    "leaky-relu": 2,
}
"""Looks that a name has wherever it stands: what Table 6.2 is called, and what it is set against."""


def condition_looks(conditions: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the look of each of a study's conditions.

    Of more conditions than share a panel, those that differ in crossed factors alone look alike: each has
    a panel or row of its own there, and `tanh` is to be seen as such under every limit.

    Args:
        conditions: all of the study's, of which a figure may show some.
    """
    kinds = {name: read_name(name).kind if len(conditions) > MOST_IN_A_PANEL else name for name in conditions}
    places = _places(list(dict.fromkeys(kinds.values())))
    return {name: condition_look(places[kind]) for name, kind in kinds.items()}


def _places(kinds: Sequence[str]) -> dict[str, int]:
    """Give each its own place where it has one that is still free, and the others what is left."""
    places: dict[str, int] = {}
    for kind in kinds:
        place = OWN_PLACES.get(kind)
        if place is not None and place not in places.values():
            places[kind] = place
    free = (place for place in range(len(kinds)) if place not in places.values())
    for kind in kinds:
        if kind not in places:
            places[kind] = next(free)
    return places
