"""The thesis's reward in other units, for the study `betas-and-units`."""

from __future__ import annotations

import numpy as np


def hundredth(events: np.ndarray, players: np.ndarray, stats: np.ndarray) -> np.ndarray:
    """Return a hundredth of the reward as printed (thesis section 5.3): (N, P)."""
    return 0.01 * (players["xp"] - players["hp"] / stats["hp"])
