"""Worlds: the laws that hold whatever is played, starts, and several players."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pneuma.env.players import Hunter
from pneuma.env.worlds import Worlds

from .arena import RIGHT, STATE_ARRAYS, begin, bits, play, state_bits


def test_every_world_is_alone_as_in_company() -> None:
    company = begin(6, seed=40)
    alone = [begin(1, seed=40 + i) for i in range(6)]
    hunter, generator = Hunter(company), np.random.default_rng(3)
    for _ in range(400):
        drawn = generator.integers(5, size=(6, 1))
        actions = np.where(generator.random((6, 1)) < 0.5, drawn, hunter.act(company))
        company.step(actions)
        over = company.worlds["ending"] != 0
        for i, world in enumerate(alone):
            world.step(actions[i : i + 1])
            assert state_bits(world) == state_bits(company, slice(i, i + 1))
            world.reset(over[i : i + 1])
        company.reset(over)


def test_what_a_mask_leaves_out_is_not_reset() -> None:
    worlds = begin(6)
    play(worlds, RIGHT, RIGHT)
    mask = np.array([True, False, False, True, False, True])
    before = bits(*(getattr(worlds, name)[~mask] for name in STATE_ARRAYS))
    worlds.reset(mask)
    assert bits(*(getattr(worlds, name)[~mask] for name in STATE_ARRAYS)) == before
    assert worlds.worlds["steps"].tolist() == [0, 2, 2, 0, 2, 0]


def test_starts_are_drawn_uniformly_in_one_world_after_another() -> None:
    drawn = begin(3000).worlds["start"]
    counts = np.bincount(drawn, minlength=6)
    # 500 of each expected; chi-square with 5 degrees of freedom is above 20.5 once in a thousand.
    assert len(counts) == 6 and ((counts - 500) ** 2 / 500).sum() < 20.5


def test_a_chosen_start_is_taken_and_draws_no_number() -> None:
    worlds = Worlds(6)
    worlds.seed(range(6))
    worlds.reset(starts=np.array([5, 4, 3, 2, 1, 0]))
    assert worlds.players["x"][:, 0].tolist() == [-47, -918, -517, -239, 389, 204]
    assert worlds.players["y"][:, 0].tolist() == [201, -35, 897, -798, 348, -105]
    assert (worlds.worlds["draws"] == 0).all()


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (lambda worlds: worlds.step(np.full((2, 1), 5)), "are outside 2 of Discrete"),
        (lambda worlds: worlds.step(np.zeros(3, np.int64)), r"actions \[0 0 0\] are outside 2 of"),
        (lambda worlds: worlds.reset(np.ones(2, np.int64)), "mask: must be booleans of shape"),
        (lambda worlds: worlds.reset(starts=np.array([0, 6])), "start 6 is none of the level's 6"),
    ],
)
def test_what_the_rules_could_not_take_is_refused(asked: Callable[[Worlds], object], told: str) -> None:
    """They look nothing up twice: an index that is too large would read beyond an array."""
    worlds = begin(2)
    before = worlds.worlds.tobytes() + worlds.players.tobytes()
    with pytest.raises(ValueError, match=told):
        asked(worlds)
    assert worlds.worlds.tobytes() + worlds.players.tobytes() == before
