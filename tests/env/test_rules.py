"""The rules: moving among tiles."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env import rules
from pneuma.env.worlds import Worlds

from .arena import (
    DOWN,
    EAST,
    LEFT,
    NORTH,
    RIGHT,
    SOUTH,
    UP,
    WEST,
    Place,
    play,
    player_at,
    stage,
)

HALF_WIDTH, HALF_HEIGHT = 23.5, 24.0  # of a player's body of 47 x 48 px
AT_X, AT_Y = -1.5, 2.0  # its centre from the player's place
DIRECTIONS = {LEFT: (-1, 0), RIGHT: (1, 0), UP: (0, -1), DOWN: (0, 1)}

# --- Walking -------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", DIRECTIONS)
def test_a_step_walks_40_px_the_way_it_says_and_turns_there(arena: str, way: int) -> None:
    worlds = stage(arena, facing=(way + 1) % 4)
    play(worlds, way)
    dx, dy = DIRECTIONS[way]
    assert player_at(worlds) == (40.0 * dx, 40.0 * dy)  # 300 px/s: 5 px a tick, 8 ticks
    assert worlds.players["facing"][0, 0] == way


# --- Walls ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("way", "before", "flush"),
    [
        (LEFT, (-545.0, 100.0), (WEST, 100.0)),
        (RIGHT, (545.0, 100.0), (EAST, 100.0)),
        (UP, (100.0, -545.0), (100.0, NORTH)),
        (DOWN, (100.0, 545.0), (100.0, SOUTH)),
        (RIGHT, (220.0, 30.0), (234.0, 30.0)),  # the obstacle's left edge at 256, less 22
        (LEFT, (356.0, 30.0), (345.0, 30.0)),  # 320 + 25
        (DOWN, (290.0, -41.0), (290.0, -26.0)),  # 0 - 26
        (UP, (290.0, 101.0), (290.0, 86.0)),  # 64 + 22
    ],
)
def test_coast_and_obstacles_stop_a_player_flush(arena: str, way: int, before: Place, flush: Place) -> None:
    worlds = stage(arena, players=[before])
    play(worlds, way)
    assert player_at(worlds) == flush
    play(worlds, way)  # nor does pushing on move the player
    assert player_at(worlds) == flush


# --- Any place, by geometry ----------------------------------------------------------------------


def boxes_that_block(worlds: Worlds) -> np.ndarray:
    """Return left, top, right, bottom of every tile that is not open, shape (4, tiles)."""
    level = worlds.level
    rows, columns = np.nonzero(level.terrain != rules.OPEN)
    left, top = level.left + columns * level.tile, level.top + rows * level.tile
    return np.stack([left, top, left + level.tile, top + level.tile])


def clear_places(worlds: Worlds, count: int) -> np.ndarray:
    """Return random places, on 64ths of a pixel, where a player stands clear of tiles: (count, 2)."""
    left, top, right, bottom = (int(64 * side) for side in worlds.level.land)
    generator = np.random.default_rng(5)
    x = generator.integers(left, right, (3 * count, 1)) / 64
    y = generator.integers(top, bottom, (3 * count, 1)) / 64
    box_left, box_top, box_right, box_bottom = boxes_that_block(worlds)
    across = (x + AT_X - HALF_WIDTH < box_right) & (x + AT_X + HALF_WIDTH > box_left)
    down = (y + AT_Y - HALF_HEIGHT < box_bottom) & (y + AT_Y + HALF_HEIGHT > box_top)
    free = ~(across & down).any(axis=1)
    return np.concatenate([x[free], y[free]], axis=-1)[:count]


@pytest.mark.parametrize("way", DIRECTIONS)
def test_anywhere_a_step_goes_as_far_as_the_nearest_tile_allows(way: int) -> None:
    worlds = Worlds(4000)
    worlds.reset()
    worlds.monsters["hp"] = 0  # or they would be in the way
    places = clear_places(worlds, len(worlds))
    worlds.players["x"], worlds.players["y"] = places[:, :1], places[:, 1:]
    play(worlds, way)

    left, top, right, bottom = boxes_that_block(worlds)
    x, y = places[:, :1] + AT_X, places[:, 1:] + AT_Y
    beside = (x - HALF_WIDTH < right) & (x + HALF_WIDTH > left)
    level_with = (y - HALF_HEIGHT < bottom) & (y + HALF_HEIGHT > top)
    gaps = {  # to each tile in the way; negative behind
        LEFT: np.where(level_with, x - HALF_WIDTH - right, np.inf),
        RIGHT: np.where(level_with, left - x - HALF_WIDTH, np.inf),
        UP: np.where(beside, y - HALF_HEIGHT - bottom, np.inf),
        DOWN: np.where(beside, top - y - HALF_HEIGHT, np.inf),
    }[way]
    free = np.where(gaps >= 0, gaps, np.inf).min(axis=1)
    walked = np.minimum(free, 40.0)
    dx, dy = DIRECTIONS[way]
    assert np.array_equal(worlds.players["x"][:, 0], places[:, 0] + dx * walked)
    assert np.array_equal(worlds.players["y"][:, 0], places[:, 1] + dy * walked)
    assert (walked < 40).sum() > 100  # walls were met
