"""The benchmarks of speed: by hand where they reckon, and that they run where they measure."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.bench import engines, env
from pneuma.env.worlds import Worlds

from ..cli.calls import described, printed


def test_ratios_are_the_medians_of_rounds_and_are_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """By hand: 10 over 5, 30 over 6 and 24 over 8 steps a second are 2, 5 and 3."""
    monkeypatch.setattr(engines, "CASES", (("small", 10, 512, 256, 3),))
    monkeypatch.setattr(engines, "engine_rates", lambda *_: ([10.0, 30.0, 24.0], [5.0, 6.0, 8.0]))
    monkeypatch.setattr(engines, "bench_engines", engines.measure)
    told = described("bench", "engines", "--json")
    case = "small network, 10 runs"
    assert told["ratios"] == {case: 3.0}
    assert told["cases"][0] == {"case": case, "engine": "batched", "runs": 10, "steps_per_second": 24.0}
    assert f"{case}: batched over sb3, median of rounds: 3.00\n" in printed("bench", "engines")


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
