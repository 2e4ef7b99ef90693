"""The benchmarks of speed: by hand where they reckon, and that they run where they measure."""

from __future__ import annotations

import numpy as np

from pneuma.bench import env
from pneuma.env.worlds import Worlds


def test_worst_case_keeps_every_monster_busy() -> None:
    worlds = Worlds(2)
    worlds.reset()
    env.engage(worlds)
    for _ in range(300):
        worlds.step(np.zeros((2, 1), np.int64) + 4)
        assert (worlds.monsters["noticed"] == 1).all()
    assert (worlds.worlds["ending"] == 0).all() and (worlds.worlds["monsters_left"] == 14).all()
