"""Random levels: the same from the number alone, disjoint sides, none out of reach; one drawn an episode."""

from __future__ import annotations

import hashlib
from collections import Counter

import numpy as np
import pytest

from pneuma.env import rules
from pneuma.env.fields import SCALES, make_env_config
from pneuma.env.level import Level
from pneuma.env.load_level import load_level
from pneuma.env.random_level import random_level
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

CODES = {390: "bamboo", 391: "spirit"}
MANY = 60

Tile = tuple[int, int]


@pytest.fixture(scope="module")
def levels() -> dict[str, list[Level]]:
    """Return the first islands of both sides."""
    return {split: [random_level(split, number) for number in range(MANY)] for split in ("train", "test")}


def all_of(levels: dict[str, list[Level]]) -> list[Level]:
    return [*levels["train"], *levels["test"]]


def digest(level: Level) -> str:
    parts = (level.ground, level.terrain, level.starts, np.array([place[1:] for place in level.monsters]))
    return hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).hexdigest()


def places(level: Level) -> np.ndarray:
    """Return x and y of everybody, start places first, shape (places, 2)."""
    return np.concatenate([level.starts, [place[1:] for place in level.monsters]])


def tile_of(level: Level, x: float, y: float) -> Tile:
    return int((y - level.top) // 64), int((x - level.left) // 64)


def test_a_number_gives_the_same_island_in_any_order(levels: dict[str, list[Level]]) -> None:
    for number in (7, 3, 59, 0):
        for split in ("test", "train"):
            again = load_level(f"random:{split}:{number}", CODES)
            assert digest(again) == digest(levels[split][number])
            assert again.name == f"random:{split}:{number}" == levels[split][number].name


def test_the_islands_are_those_that_stored_runs_were_trained_on() -> None:
    """A change here changes what a stored run's level means: raise `RULES_VERSION` with it."""
    found = {name: digest(load_level(name, CODES))[:16] for name in ("random:train:17", "random:test:17")}
    assert found == {"random:train:17": "85aea74cd4139a19", "random:test:17": "03c2f3f8faed4a98"}


def test_mixed_monsters_stand_where_the_others_do(levels: dict[str, list[Level]]) -> None:
    mixed = random_level("test", 5, "mixed")
    assert digest(mixed) == digest(levels["test"][5])
    kinds = Counter(kind for kind, _, _ in mixed.monsters)
    assert kinds == {"bamboo": 8, "squid": 2, "raccoon": 2, "spirit": 2}
    with pytest.raises(UserError, match="monsters = mixed"):
        make_env_config({"monsters": "mixed"})


def test_every_monster_can_be_walked_to_from_every_start(levels: dict[str, list[Level]]) -> None:
    for level in all_of(levels):
        reached = np.zeros((50, 57), bool)
        reached[tile_of(level, *level.starts[0])] = True
        size = 0
        while size != np.count_nonzero(reached):
            size = int(np.count_nonzero(reached))
            spread = reached.copy()
            spread[1:] |= reached[:-1]
            spread[:-1] |= reached[1:]
            spread[:, 1:] |= reached[:, :-1]
            spread[:, :-1] |= reached[:, 1:]
            reached = spread & (level.terrain == rules.OPEN)
        assert all(reached[tile_of(level, x, y)] for x, y in places(level))


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
