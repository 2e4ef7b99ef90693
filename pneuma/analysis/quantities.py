"""What curves have in common that show one quantity; `quantities.toml` declares it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

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


_DECLARATIONS = tomllib.loads(files(__package__).joinpath("quantities.toml").read_text(encoding="utf-8"))
QUANTITIES = {name: Quantity(**declaration) for name, declaration in _DECLARATIONS.items()}
"""By name."""
