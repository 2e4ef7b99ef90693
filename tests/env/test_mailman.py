"""The mailman's day (thesis Fig. 2.1): what it refuses, and how days go; more in engines/test_tabular.py."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from pneuma.env.mailman import GO_HOME, GO_ON, HOME, LETTERS, POST_OFFICE, MailmanEnv


@pytest.mark.parametrize(
    ("actions", "day"),
    [
        ((GO_ON, GO_ON), [(LETTERS, 0.0, False), (HOME, 1.0, True)]),
        ((GO_ON, GO_HOME), [(LETTERS, 0.0, False), (HOME, 1.0, True)]),
        ((GO_HOME,), [(HOME, -1.0, True)]),
    ],
)
def test_a_day_without_slips_goes_as_chosen(
    actions: tuple[int, ...], day: list[tuple[int, float, bool]]
) -> None:
    env = MailmanEnv()
    assert env.reset(seed=0)[0] == POST_OFFICE
    assert [(int(told[0]), told[1], told[2]) for told in map(env.step, map(np.int64, actions))] == day
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.int64(GO_ON))
