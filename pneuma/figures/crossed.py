"""What a crossed condition is called: 'reward=thesis, scale=raw, relu' is relu in one cell of two factors."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class CrossedName:
    """A condition's name, taken apart.

    Attributes:
        levels: factor and level, in the name's order; none where nothing is crossed.
        own: what is left of the name; '' where there are levels alone.
    """

    levels: tuple[tuple[str, str], ...]
    own: str

    @property
    def kind(self) -> str:
        """What it is in every cell: its own name, or the whole one where it has no other."""
        return self.own or ", ".join("=".join(level) for level in self.levels)

    @property
    def short(self) -> str:
        """Its levels without the factors, and its own name."""
        return ", ".join([*(level for _, level in self.levels), *filter(None, [self.own])])


def read_name(condition: str) -> CrossedName:
    """Take a condition's name apart."""
    parts = re.split(r", (?![^\[]*\])", condition)  # a level may be a list: betas=[0.9, 0.999]
    crossed = next((place for place, part in enumerate(parts) if "=" not in part), len(parts))
    levels = (part.partition("=")[::2] for part in parts[:crossed])
    return CrossedName(tuple(levels), ", ".join(parts[crossed:]))


def are_crossed(conditions: Sequence[str]) -> bool:
    """Tell whether all of these have the same factors; changes of one setting at a time have not."""
    kinds = {tuple(factor for factor, _ in read_name(name).levels) for name in conditions}
    return len(kinds) == 1 and kinds != {()}


def row_names(conditions: Sequence[str], characters: int) -> tuple[list[str], str]:
    """Return what conditions are called beside their rows, and what the names consist of if that is not said.

    Crossed ones of which a name is longer than so many characters go by their levels alone, if these tell
    them apart.
    """
    short = [read_name(name).short for name in conditions]
    if not are_crossed(conditions) or max(map(len, conditions)) <= characters or not all(short):
        return list(conditions), ""
    return (
        (short, f"Rows: {parts_of(conditions)}.") if len({*short}) == len(short) else (list(conditions), "")
    )


def parts_of(conditions: Sequence[str]) -> str:
    """Return what names of crossed conditions consist of: their factors, and what each is called itself."""
    named = any(read_name(name).own for name in conditions)
    return ", ".join([*factors_of(conditions), *["condition"] * named])


def factors_of(conditions: Sequence[str]) -> list[str]:
    """Return the factors that any of these is crossed by, in order."""
    return list(dict.fromkeys(factor for name in conditions for factor, _ in read_name(name).levels))
