"""What curves have in common that show one quantity; `quantities.toml` declares it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from pneuma.env.fields import ACTION_NAMES

VALUES, SHARES, POWERS = "values", "shares", "powers"
"""What an axis has: numbers, shares in per cent, or numbers on a logarithmic scale."""


@dataclass(frozen=True)
class Quantity:
    """The title of a quantity's panel, the label and kind of its axis, and its least and greatest value."""

    title: str
    label: str
    kind: str = VALUES
    bounds: tuple[float, float] = (-np.inf, np.inf)

    @property
    def title_with_unit(self) -> str:
        """The title, with the unit that the label has in brackets."""
        _, bracket, unit = self.label.partition(" (")
        return self.title + bracket + unit


def _read_quantities() -> dict[str, Quantity]:
    declarations = tomllib.loads(files(__package__).joinpath("quantities.toml").read_text(encoding="utf-8"))
    action_declaration = declarations.pop("action")
    for number, name in enumerate(ACTION_NAMES):
        declarations[f"action_{number}"] = {
            **action_declaration,
            "title": action_declaration["title"].format(action=name),
        }
    return {name: Quantity(**declaration) for name, declaration in declarations.items()}


QUANTITIES = _read_quantities()
"""By name."""
