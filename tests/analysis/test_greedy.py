"""Why greedy agents are stuck, in windows made by hand."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

GREEDY = runpy.run_path(str(Path(__file__).parents[2] / "studies/scripts/greedy.py"))
STEPS = 50
STRIKE, LEFT, RIGHT = 4, 1, 3


def window(x: Any = 0.0, actions: Any = LEFT, hits: Any = 0, distance: float = 500.0) -> Any:
    each = (x, 0.0, actions, hits, distance, True)
    return GREEDY["Played"](*(np.broadcast_to(np.asarray(value), STEPS) for value in each))


TO_AND_FRO = np.arange(STEPS) % 2 * 40.0
CASES = {
    "against terrain": window(),
    "against a monster": window(distance=80.0),
    "striking": window(actions=STRIKE),
    "to and fro": window(x=TO_AND_FRO, actions=np.where(TO_AND_FRO > 0, RIGHT, LEFT)),
    "": window(x=np.arange(STEPS) * 40.0),
}


@pytest.mark.parametrize("reason", CASES)
def test_the_reason_why_an_agent_is_stuck(reason: str) -> None:
    assert GREEDY["why_stuck"](CASES[reason]) == reason


def test_who_lands_a_blow_is_not_stuck() -> None:
    assert GREEDY["why_stuck"](window(actions=STRIKE, hits=np.arange(STEPS) == 7)) == ""


def test_only_whole_windows_of_running_episodes_count() -> None:
    """Two worlds of two windows: one stands still throughout, the other ends within its first window."""
    still = GREEDY["Played"](
        *(np.full((2 * STEPS, 2), value) for value in (0.0, 0.0, LEFT, 0, 500.0)),
        np.stack([np.ones(2 * STEPS, bool), np.arange(2 * STEPS) < 20], axis=1),
    )
    assert GREEDY["stuck"](still)["against terrain"] == GREEDY["stuck"](still)["stuck"] == 1.0
