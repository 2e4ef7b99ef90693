"""The short form of the storm (`make storm` runs the whole): kills and damage change no bit."""

from __future__ import annotations

import pytest

from .readers import TASKS, storm_of_readers
from .storm import ORPHAN_SECONDS, damage_sweep, kill_storm


@pytest.mark.slow
@pytest.mark.parametrize(("engine", "steps"), [("sb3", 2_560), ("batched", 51_200)])
def test_a_study_killed_at_random_moments_ends_with_the_same_bits(engine: str, steps: int) -> None:
    storm = kill_storm(engine, kills=2, steps=steps, seed=1)
    assert (storm.disturbances.total(), storm.faults) == (2, [])
    assert storm.longest_orphan <= ORPHAN_SECONDS


@pytest.mark.slow
def test_a_damaged_study_ends_with_the_same_bits() -> None:
    storm = damage_sweep("batched", steps=12_800, every=25)
    assert len(storm.disturbances) >= 2
    assert storm.faults == []


@pytest.mark.slow
def test_readers_and_trainers_of_one_study_lose_nothing() -> None:
    tasks_done, faults = storm_of_readers(seconds=5)
    assert set(tasks_done) == set(TASKS)
    assert faults == []
