"""What is given to the compiled rules by hand: they look no index up twice, so it is looked at before.

Arrays of actions, masks and start places; and a state that somebody has written.
"""

from __future__ import annotations

import numpy as np

from pneuma.env.characters import FACINGS
from pneuma.env.level import Level


def checked(given: np.ndarray, shape: int | tuple[int, ...], kinds: str, what: str) -> np.ndarray:
    """Return what was given as the compiled rules take it: booleans, or int64.

    Raises:
        ValueError: where its shape or kind is another.
    """
    array = np.asarray(given)
    wanted = (shape,) if isinstance(shape, int) else shape
    if array.shape != wanted or array.dtype.kind not in kinds:
        of = "booleans" if kinds == "b" else "whole numbers"
        raise ValueError(f"{what}: must be {of} of shape {wanted}, not {array.dtype} of {array.shape}")
    return np.ascontiguousarray(array, np.bool_ if kinds == "b" else np.int64)


def refuse_nowhere(level: Level, players: np.ndarray, monsters: np.ndarray) -> None:
    """Refuse living bodies, (N, P) and (N, M), that are nowhere on a level's grid, or face nowhere.

    Raises:
        ValueError: saying which, and where the grid is.
    """
    left, top, right, bottom = level.grid
    for name, bodies in (("players", players), ("monsters", monsters)):
        x, y = bodies["x"], bodies["y"]
        on_grid = (left <= x) & (x < right) & (top <= y) & (y < bottom)  # NaN is nowhere
        if not (on_grid | (bodies["hp"] <= 0)).all():
            raise ValueError(
                f"{name}: x or y lies off the grid, {left:g} to {right:g}, {top:g} to {bottom:g}"
            )
    if players["facing"].min() < 0 or players["facing"].max() >= len(FACINGS):
        raise ValueError("players: facing is none of 0 to 3")
