"""Random levels: the same from the number alone, disjoint sides, none out of reach; one drawn an episode."""

from __future__ import annotations

import hashlib
from collections import Counter

import numpy as np
import pytest
from scipy.ndimage import label

from pneuma.env import rules
from pneuma.env.fields import SCALES, make_env_config
from pneuma.env.level import Level
from pneuma.env.load_level import load_levels
from pneuma.env.random_level import random_level
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

CODES = {390: "bamboo", 391: "spirit"}


def digest(level: Level) -> str:
    parts = (level.ground, level.terrain, level.starts, np.array([place[1:] for place in level.monsters]))
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def test_the_islands_are_those_that_stored_runs_were_trained_on() -> None:
    """A change here changes what a stored run's level means: raise `RULES_VERSION` with it."""
    for name, expected in {"train:17": "85aea74cd4139a19", "test:17": "03c2f3f8faed4a98"}.items():
        (level,) = load_levels(make_env_config({"level": f"random:{name}"}), CODES)
        assert (digest(level)[:16], level.name) == (expected, f"random:{name}")


def test_mixed_monsters_stand_where_the_others_do() -> None:
    mixed = random_level("test", 5, "mixed")
    assert digest(mixed) == digest(random_level("test", 5))
    kinds = Counter(kind for kind, _, _ in mixed.monsters)
    assert kinds == {"bamboo": 8, "squid": 2, "raccoon": 2, "spirit": 2}
    with pytest.raises(UserError, match="monsters = mixed"):
        make_env_config({"monsters": "mixed"})


@pytest.mark.parametrize("split", ["train", "test"])
def test_every_monster_can_be_walked_to_from_every_start(split: str) -> None:
    for number in range(30):
        level = random_level(split, number)
        regions, _ = label(level.terrain == rules.OPEN)
        places = np.concatenate([level.starts, [place[1:] for place in level.monsters]])
        columns, rows = (((places - (level.left, level.top)) // 64).astype(int)).T
        (home,) = {*regions[rows, columns].tolist()}
        assert home > 0


# --- Several levels: each episode draws one -------------------------------------------------------

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
