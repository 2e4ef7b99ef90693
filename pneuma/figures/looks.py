"""Which condition has which colour: in all figures of a selection the same, and the same in related studies.

A selection's conditions take the looks of `style` in their order. But some configurations stand in several
studies under other names: Table 6.2 is `tanh` beside ReLU, `non-stationary` beside the other Adam.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pneuma.figures.crossed import read_name
from pneuma.figures.style import COLOURS, condition_look

MOST_IN_A_PANEL = 7
"""Conditions that share a panel at most: so many looks can be told apart."""

OWN_PLACES = {
    **dict.fromkeys(
        ("table-6-2", "tanh", "non-stationary", "adam", "smallest", "0.1", "thesis", "final", "alone", "ppo"),
        0,
    ),
    **dict.fromkeys(("relu", "l2", "trpo"), 1),
    **dict.fromkeys(("leaky-relu", "rmsprop", "dqn"), 2),
    **dict.fromkeys(("stationary", "double-dqn"), 3),
    **dict.fromkeys(("sgd", "a2c"), 4),
    "momentum": 5,
    "upgd": 6,
}
"""Looks that a name has wherever it stands: what Table 6.2 is called, what it is set against, and methods."""
TUNED = "-tuned"
"""What ends the name of a method that was tuned, beside the same untuned."""


def condition_looks(conditions: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the look of each of a study's conditions.

    A method that was tuned and the same untuned have one colour, and other dashes and markers.
    Of more conditions than share a panel, those that differ in crossed factors alone look alike: each has
    a panel or row of its own there, and `tanh` is to be seen as such under every limit.

    Args:
        conditions: all of the selection's, of which a figure may show some.
    """
    kinds = {name: read_name(name).kind if len(conditions) > MOST_IN_A_PANEL else name for name in conditions}
    tuned = {kind.removesuffix(TUNED) for kind in kinds.values() if kind.endswith(TUNED)}
    places = _places(list(dict.fromkeys(kind.removesuffix(TUNED) for kind in kinds.values())))
    return {
        name: condition_look(places[kind.removesuffix(TUNED)] + (len(COLOURS) if kind in tuned else 0))
        for name, kind in kinds.items()
    }


def told_apart(looks: Mapping[str, dict[str, Any]], names: Sequence[str]) -> dict[str, str]:
    """Return a colour for each of some conditions that colour alone tells apart, unlike where it can be.

    Conditions that are alike on purpose stay so.
    """
    colours: dict[str, str] = {}  # by look
    alike = {name: str(sorted(looks[name].items(), key=str)) for name in names}
    for name in names:
        if looks[name]["color"] not in colours.values():
            colours.setdefault(alike[name], looks[name]["color"])
    left = [colour for colour in COLOURS if colour not in colours.values()]
    for name in names:
        if alike[name] not in colours:
            colours[alike[name]] = left.pop(0) if left else looks[name]["color"]
    return {name: colours[alike[name]] for name in names}


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
