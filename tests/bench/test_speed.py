"""The benchmarks of speed: by hand where they reckon, and that they run where they measure."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.bench import engines, env
from pneuma.env.worlds import Worlds


def test_worst_case_keeps_every_monster_busy() -> None:
    worlds = Worlds(2)
    worlds.reset()
    env.engage(worlds)
    for _ in range(300):
        worlds.step(np.zeros((2, 1), np.int64) + 4)
        assert (worlds.monsters["noticed"] == 1).all()
    assert (worlds.worlds["ending"] == 0).all() and (worlds.worlds["monsters_left"] == 14).all()


@pytest.mark.slow
def test_the_compiled_engine_is_the_faster_one() -> None:
    ours, theirs = engines.engine_rates(
        [engines.engine_run("small", "batched", 0, 256)], engines.engine_run("small", "sb3", 0, 256), 2
    )
    assert len(ours) == len(theirs) == 2 and max(ours) > max(theirs)
