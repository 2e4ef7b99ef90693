"""Several random levels: each episode draws one, and plays there as a world of that level alone."""

from __future__ import annotations

import pytest

from pneuma.config import SCALES, make_env_config
from pneuma.env.worlds import Worlds

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
