"""Learning rate and clip range that fall as Stable-Baselines3 counts progress, in both engines."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from pneuma.config import make_run
from pneuma.engines.records import Checkpoint

from . import trained
from .trained import train_once

RATE = 2.0**-10
SMALL: dict[str, object] = {
    **trained.SMALL, "env": "CartPole-v1", "learning_rate": RATE, "clip_range": 0.25, "steps": 256,
}  # fmt: skip
LINEAR = {"learning_rate_schedule": "linear", "clip_range_schedule": "linear"}


def weights(checkpoint: Checkpoint) -> Mapping[str, np.ndarray]:
    return {
        name: array for name, array in checkpoint.arrays.items() if name.startswith(("networks/", "policy/"))
    }


@pytest.mark.parametrize("engine", ["batched", "sb3"])
def test_an_update_takes_the_values_of_the_steps_that_are_left_after_it(engine: str) -> None:
    """After the first of four updates three quarters are left, after the last one nothing."""
    falling, kept = ({**SMALL, "engine": engine, **fields} for fields in (LINEAR, {}))
    _, taken = train_once(make_run(falling))
    _, less = train_once(make_run({**kept, "learning_rate": 0.75 * RATE, "clip_range": 0.75 * 0.25}))
    _, constant = train_once(make_run(kept))
    np.testing.assert_equal(weights(taken[0]), weights(less[0]))
    with pytest.raises(AssertionError):
        np.testing.assert_equal(weights(taken[0]), weights(constant[0]))
    np.testing.assert_equal(weights(taken[3]), weights(taken[2]))
