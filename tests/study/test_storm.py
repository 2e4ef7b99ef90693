"""The short form of the storm (`make storm` runs the whole): kills and damage change no bit."""

from __future__ import annotations

from .storm import ORPHAN_SECONDS, damage_sweep, kill_storm


def test_a_study_killed_at_random_moments_ends_with_the_same_bits() -> None:
    tally = kill_storm(kills=2, steps=2_560, seed=1)
    assert sum(tally.kills.values()) == 2
    assert (tally.differences, tally.complaints) == ([], [])
    assert tally.longest_orphan <= ORPHAN_SECONDS


def test_a_damaged_study_ends_with_the_same_bits() -> None:
    tally = damage_sweep(steps=512, every=25)
    assert len(tally.kills) >= 2
    assert (tally.differences, tally.complaints) == ([], [])
