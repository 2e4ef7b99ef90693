"""Which factors a study crosses, as its conditions resolved; nobody has to name them.

    a study's conditions → the settings in which they differ → factors, and the level that each condition has

Settings that do not take every combination of their values vary together, and are one factor: those that
a factor's values set at once, or those in which named conditions differ one at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from math import prod
from typing import Any

from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.values import as_tuple, shown_value

_NO_FACTORS = ("seed", "steps", "engine")

Group = tuple[str, ...]
"""Settings that make up one factor."""


@dataclass(frozen=True)
class Crossing:
    """A full crossing of two or more factors.

    Attributes:
        factors: name to levels, in the study's order.
        levels: of each condition, one of every factor, in the factors' order.
    """

    factors: Mapping[str, tuple[str, ...]]
    levels: Mapping[str, tuple[str, ...]]


def find_crossing(data: StudyData) -> Crossing:
    """Return what a study crosses, its conditions without a finished run included.

    Raises:
        UserError: where engines are mixed, fewer than two factors are crossed, or a combination is missing.
    """
    _check_engines(data)
    settings = _shown_settings(data)
    groups = _groups(list(settings.values()))
    names = [" + ".join(group) for group in groups]
    levels = {condition: tuple(_level(own, group) for group in groups) for condition, own in settings.items()}
    if len(groups) < 2:
        told = f"its conditions differ in {names[0]} alone" if names else "its conditions do not differ"
        raise UserError(
            f"study {data.study} is not crossed: {told}; take one whose conditions are every "
            "combination of two factors' values ([factors] in its file), and all of them"
        )
    factors = {name: tuple(dict.fromkeys(own[i] for own in levels.values())) for i, name in enumerate(names)}
    missing = next((cell for cell in product(*factors.values()) if cell not in levels.values()), None)
    if missing:
        told = ", ".join(f"{name} {level}" for name, level in zip(factors, missing, strict=True))
        raise UserError(f"study {data.study} is not fully crossed: no condition has {told}; add it")
    return Crossing(factors, levels)


def _check_engines(data: StudyData) -> None:
    engines: dict[str, str] = {}
    for run in data.runs:
        engines.setdefault(str(data.settings(run).get("engine")), run.condition)
    if len(engines) > 1:
        told = ", ".join(f"{condition} by {engine}" for engine, condition in engines.items())
        raise UserError(
            f"engines are mixed: {told}; choose the runs of one with --engine {next(iter(engines))}"
        )


def condition_settings(data: StudyData) -> dict[str, dict[str, Any]]:
    """Return the settings of every condition, of those without a finished run too; lists as tuples."""
    found: dict[str, dict[str, Any]] = {}
    for run in data.record["runs"]:
        found.setdefault(run["condition"], {key: as_tuple(value) for key, value in run["run"].items()})
    return found


def _shown_settings(data: StudyData) -> dict[str, dict[str, str]]:
    """Return every condition's settings that may be factors, as people read them."""
    return {
        condition: {key: shown_value(value) for key, value in own.items() if key not in _NO_FACTORS}
        for condition, own in condition_settings(data).items()
    }


def _groups(settings: Sequence[Mapping[str, str]]) -> list[Group]:
    """Return the factors: groups of differing settings, each two of which are crossed."""
    keys = dict.fromkeys(key for own in settings for key in own)
    groups: list[Group] = [(key,) for key in keys if len({own.get(key) for own in settings}) > 1]
    while pair := next((pair for pair in combinations(groups, 2) if not _crossed(settings, *pair)), None):
        groups[groups.index(pair[0])] = pair[0] + pair[1]
        groups.remove(pair[1])
    return groups


def _crossed(settings: Sequence[Mapping[str, str]], one: Group, other: Group) -> bool:
    sizes = [len({_level(own, group) for own in settings}) for group in (one, other)]
    return len({(_level(own, one), _level(own, other)) for own in settings}) == prod(sizes)


def _level(own: Mapping[str, str], group: Group) -> str:
    return " + ".join(own.get(key, "none") for key in group)
