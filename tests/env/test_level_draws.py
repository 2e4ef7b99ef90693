"""Several random levels: each episode draws one, and plays there as a world of that level alone."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.config import SCALES, make_env_config
from pneuma.env.worlds import Worlds

from .arena import TOLD_ARRAYS, begin, bits

LEVEL = "random:train:5"


def test_an_episode_draws_its_level_and_then_its_start() -> None:
    worlds = Worlds(1, make_env_config({"level": LEVEL, "random_levels": 4}))
    worlds.worlds["key"] = 0
    drawn = []
    for _ in range(2):
        worlds.reset()
        drawn.append((int(worlds.worlds["level"][0]), int(worlds.worlds["start"][0])))
    # The published stream of key 0 begins 0xE220…, 0x6E78…, 0x06C4…, 0xF88B…: as shares of 2**64
    # 0.883, 0.432, 0.026 and 0.971. Of 4 levels and 6 starts: 3.53, 2.59, 0.11, 5.83.
    assert drawn == [(3, 2), (0, 5)]


def test_levels_are_drawn_uniformly() -> None:
    worlds = begin(2000, level=LEVEL, random_levels=4)
    counts = np.bincount(worlds.worlds["level"], minlength=4)
    # 500 of each expected; chi-square with 3 degrees of freedom is above 16.3 once in a thousand.
    assert ((counts - 500) ** 2 / 500).sum() < 16.3


def test_a_world_plays_as_on_its_level_alone() -> None:
    company = begin(8, seed=1, level=LEVEL, random_levels=3, scale="raw", players=2)
    alone = []
    for world in range(8):
        level = f"random:train:{5 + int(company.worlds['level'][world])}"
        alone.append(Worlds(1, make_env_config({"level": level, "scale": "raw", "players": 2})))
        alone[world].reset(starts=company.worlds["start"][world : world + 1].astype(np.int64))
    generator = np.random.default_rng(0)
    for _ in range(300):
        actions = np.repeat(generator.integers(5, size=(8, 1)), 2, axis=1)
        company.step(actions)
        for world, worlds in enumerate(alone):
            worlds.step(actions[world : world + 1])
            for name in ("players", "monsters", *TOLD_ARRAYS):
                here, there = getattr(worlds, name)[0], getattr(company, name)[world]
                assert bits(here) == bits(there), name
    assert len(set(company.worlds["level"].tolist())) == 3


@pytest.mark.parametrize("scale", SCALES)
def test_a_place_is_seen_the_same_whichever_levels_are_played_together(scale: str) -> None:
    """So that what was learned on some islands holds on others."""
    alone, together, tested = (
        Worlds(1, make_env_config({"level": level, "random_levels": count, "scale": scale}))
        for level, count in ((LEVEL, 1), (LEVEL, 20), ("random:test:3", 2))
    )
    for other in (together, tested):
        assert other.space == alone.space
        names = ("middle_x", "middle_y", "scale_x", "scale_y", "xp_scale")
        assert [other.settings[name] for name in names] == [alone.settings[name] for name in names]
        assert other.monster_stats["distance_scale"][0, 0] == alone.monster_stats["distance_scale"][0, 0]
