"""Signs of collapse, by the columns of updates."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.analysis.signs import ONE_ACTION, update_signs

STEP = np.array([100.0, 200.0, 300.0])


@pytest.mark.parametrize(
    ("shares", "held"),
    [
        ([0.0, 0.0, 0.0, 0.0, 0.0], True),  # magic has two actions more, which have no columns
        ([0.1, 0.0, 0.0, 0.0, 0.0], False),
        ([0.0, 0.0, 1.0, 0.0, 0.0], True),
        ([0.2, 0.2, 0.2, 0.2, 0.2], False),
    ],
)
def test_a_policy_that_only_casts_spells_has_one_action(shares: list[float], held: bool) -> None:
    columns = {f"action_{i}": np.full(3, own) for i, own in enumerate(shares)}
    assert update_signs(STEP, columns, 5)[ONE_ACTION] == ([(100.0, 300.0)] if held else [])
