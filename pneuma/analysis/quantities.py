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


def _read_quantities() -> dict[str, Quantity]:
    rows = tomllib.loads(files(__package__).joinpath("quantities.toml").read_text(encoding="utf-8"))
    action = rows.pop("action")
    for number, name in enumerate(ACTION_NAMES):
        rows[f"action_{number}"] = {**action, "title": action["title"].format(action=name)}
    return {name: Quantity(**row) for name, row in rows.items()}


QUANTITIES = _read_quantities()
"""By name."""
