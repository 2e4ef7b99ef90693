"""Laws of bodies, whatever is played: nobody runs through another or a wall, and who chases arrives.

Levels, characters and configurations are those that the kernel is held to the oracle on; here only
the kernel plays.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from pneuma.env.worlds import Worlds

from .oracle_cases import Case, cases, make_worlds
from .oracle_maps import KINDS, Map
from .oracle_moves import CONTACT_EPS

LAW = settings(
    max_examples=30,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
ROUNDING = 1e-6
OFF_GRID = 7
MIDDLE = 512.0  # of the 16 x 16 tiles of a `Map`


def boxes(worlds: Worlds, world: int) -> tuple[np.ndarray, np.ndarray]:
    """Return left, top, right and bottom of everybody's body, players first, and who lives."""
    level = int(worlds.worlds["level"][world])
    stats = (worlds.player_stats, worlds.monster_stats[level])
    sides = []
    for bodies, forms in zip((worlds.players[world], worlds.monsters[world]), stats, strict=True):
        x, y = bodies["x"] + forms["body_x"], bodies["y"] + forms["body_y"]
        wide, high = forms["half_width"], forms["half_height"]
        sides.append(np.stack([x - wide, y - high, x + wide, y + high], axis=1))
    living = np.concatenate([worlds.players[world]["hp"], worlds.monsters[world]["hp"]]) > 0
    return np.concatenate(sides), living


def overlaps(worlds: Worlds, world: int) -> set[tuple[int, int]]:
    """Return which living bodies overlap by more than a hair."""
    sides, living = boxes(worlds, world)
    low, high = sides[:, None, :2], sides[:, None, 2:]
    depth = np.minimum(high, high.swapaxes(0, 1)) - np.maximum(low, low.swapaxes(0, 1))
    deep = (depth > CONTACT_EPS + ROUNDING).all(axis=-1) & living & living[:, None]
    return {(one, other) for one, other in np.argwhere(deep).tolist() if one < other}


def trespassers(worlds: Worlds, world: int) -> Iterator[int]:
    """Yield whose body is off the grid, or on a tile that stops it."""
    level, row = worlds.levels[int(worlds.worlds["level"][world])], worlds.settings[0]
    rim = np.pad(level.terrain, 1, constant_values=OFF_GRID)
    corner = np.array([level.left, level.top] * 2) - level.tile
    inwards = np.array([ROUNDING, ROUNDING, -ROUNDING, -ROUNDING])
    sides, living = boxes(worlds, world)
    cells = np.floor((sides + inwards - corner) / level.tile).astype(int)
    for body in np.flatnonzero(living).tolist():
        left, top, right, bottom = cells[body].tolist()
        stops = row["player_stops"] if body < worlds.players.shape[1] else row["monster_stops"]
        tiles = rim[top : bottom + 1, left : right + 1].ravel().tolist()
        if any((int(stops) | 1 << OFF_GRID) >> tile & 1 for tile in tiles):
            yield body


def test_nobody_gets_into_another_or_into_what_stops_it(tmp_path: Path) -> None:
    """Players who begin at one place are inside each other; they may part, and not meet again."""
    folders = itertools.count()

    @LAW
    @given(cases(), st.integers(0, 2**32))
    def check(case: Case, seed: int) -> None:
        chosen = {**case.settings, "bodies": "block"}
        worlds = make_worlds(Case(**{**vars(case), "settings": chosen}), tmp_path / str(next(folders)))
        worlds.settings["ticks"] = 1
        worlds.seed(range(seed, seed + len(worlds)))
        worlds.reset()
        generator = np.random.default_rng(seed)
        before = [overlaps(worlds, world) for world in range(len(worlds))]
        count = worlds.players.shape[1]
        assert all(other < count for pairs in before for _, other in pairs)
        actions: Any = np.zeros(worlds.players.shape, np.int64)
        for tick in range(200):
            if tick % 20 == 0:
                actions = generator.integers(int(worlds.action_space.n), size=actions.shape)
            worlds.step(actions)
            for world in range(len(worlds)):
                after = overlaps(worlds, world)
                assert after <= before[world]
                assert not list(trespassers(worlds, world))
                before[world] = after

    check()


def test_who_chases_one_that_stands_arrives_and_bites(tmp_path: Path) -> None:
    folders = itertools.count()

    @LAW
    @given(
        st.sampled_from(sorted(KINDS)),
        st.floats(-195, 195),
        st.floats(-195, 195),
    )
    def check(kind: str, x: float, y: float) -> None:
        # Clear of the player, and within 180 px of its body: the raccoon notices least.
        assume(max(abs(x), abs(y)) > 60 and np.hypot(x, y) < 195)
        level = Map(starts=((MIDDLE, MIDDLE),), monsters=((kind, MIDDLE + x, MIDDLE + y),))
        worlds = make_worlds(Case({}, level, "", 1, 0, b"", b""), tmp_path / str(next(folders)))
        worlds.reset()
        worlds.players["busy"] = 1000  # it stands
        for _ in range(15):
            worlds.step(np.zeros((1, 1), np.int64))
        (player, monster), _ = boxes(worlds, 0)
        gaps = np.maximum(monster[:2] - player[2:], player[:2] - monster[2:])
        assert gaps.max() == pytest.approx(0, abs=CONTACT_EPS)
        assert worlds.players["hp"][0, 0] < 100

    check()
