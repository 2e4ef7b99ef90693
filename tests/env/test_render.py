"""Frames of the world, and what they are drawn from.

The arena's grid spans -640 … 640 on both axes, so that the art pixel of a place is (x + 640) / 4.
"""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env import rules
from pneuma.env.render import Renderer
from pneuma.env.worlds import Worlds

from .arena import ATTACK, DOWN, LEFT, RIGHT, begin, play, stage

MIDDLE = 160  # the art pixel of (0, 0)
BODY = 12  # no picture of a body reaches further from its centre


def changed(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Return x and y of the pixels in which two frames differ, shape (2, count)."""
    rows, columns = np.nonzero((before != after).any(axis=-1))
    return np.stack([columns, rows])


def bare(worlds: Worlds) -> np.ndarray:
    """Return the whole map at 16 px a tile without the panel; it is drawn three times as large."""
    return Renderer(worlds, panel=False).frame()[::3, ::3]


def test_player_is_drawn_where_the_state_says(arena: str) -> None:
    worlds = stage(arena)
    before = bare(worlds)
    worlds.players["x"], worlds.players["y"] = 200.0, -120.0
    x, y = changed(before, bare(worlds))
    old = (abs(x - MIDDLE) <= BODY) & (abs(y - MIDDLE) <= BODY)
    new = (abs(x - MIDDLE - 50) <= BODY) & (abs(y - MIDDLE + 30) <= BODY)
    assert (old | new).all()
    assert old.sum() > 100 and new.sum() > 100  # a body is about 12 x 12 art pixels


def test_ground_is_blue_exactly_where_the_coast_is() -> None:
    """In the middle of every tile of the shipped level; borders may wander by a few pixels."""
    worlds = Worlds(1)
    centres = Renderer(worlds).background[8::16, 8::16].astype(int)
    blue = centres[..., 2] - centres[..., 0] > 40
    np.testing.assert_array_equal(blue, worlds.level.terrain == rules.COAST)


@pytest.mark.parametrize(
    ("place", "corner"),
    [
        ((0.0, 0.0), (MIDDLE - 120, MIDDLE - 88)),  # half of a view of 240 x 176 art pixels
        ((-540.0, -540.0), (0, 0)),
        ((540.0, 540.0), (320 - 240, 320 - 176)),
        ((-540.0, 40.0), (0, MIDDLE + 10 - 88)),
    ],
    ids=str,
)
def test_following_camera_is_the_map_around_the_player(
    arena: str, place: tuple[float, float], corner: tuple[int, int]
) -> None:
    """Law: every art pixel is the map's, four times as large; the window never leaves the map."""
    worlds = stage(arena, players=(place,))
    left, top = corner
    expected = bare(worlds)[top : top + 176, left : left + 240].repeat(4, 0).repeat(4, 1)
    np.testing.assert_array_equal(Renderer(worlds, "follow", panel=False).frame(), expected)


def test_same_state_gives_the_same_bytes() -> None:
    first, second = begin(2, seed=5, players=3), begin(2, seed=5, players=3)
    for worlds in (first, second):
        play(worlds, RIGHT, ATTACK, DOWN, LEFT)
    for camera in ("map", "follow"):
        here, there = (Renderer(worlds, camera).frame(1, 2) for worlds in (first, second))
        assert here.tobytes() == there.tobytes()
