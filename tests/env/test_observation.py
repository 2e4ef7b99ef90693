"""Observations: what stands where, in which order, and within which bounds."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env.worlds import Worlds

from .arena import STAND, Place, play, stage


def seen(worlds: Worlds) -> np.ndarray:
    """Return the observation of the first world's only player."""
    return np.asarray(worlds.observations[0, 0])


def seen_monsters(worlds: Worlds) -> np.ndarray:
    """Return the monsters' part, one row of four each."""
    return seen(worlds)[4:].reshape(-1, 4)


def look(arena: str, *monsters: Place, players: tuple[Place, ...] = ((0.0, 0.0),)) -> Worlds:
    """Set up a world in which nothing moves and observe it."""
    worlds = stage(arena, *monsters, players=players, still=True)
    play(worlds, STAND)
    return worlds


# --- Values --------------------------------------------------------------------------------------


def test_a_position_is_measured_from_the_middle_of_the_land() -> None:
    # The shipped land spans x from -1536 to 1408 and y from -1088 to 1344: its middle is (-64, 128),
    # its halves 1472 and 1216. Start 0 is at (204, -105).
    worlds = Worlds(1)
    worlds.reset(starts=np.array([0]))
    assert seen(worlds)[:4] == pytest.approx([268 / 1472, -233 / 1216, 1.0, 0.0])


def test_hp_and_xp_are_shares(arena: str) -> None:
    worlds = stage(arena)
    worlds.players["hp"], worlds.players["xp"] = 43, 3
    play(worlds, STAND)
    assert seen(worlds)[2:4] == pytest.approx([0.43, 3 / 4])  # of 100 HP, and of four monsters' XP


def test_a_monster_is_seen_by_distance_direction_and_hp(arena: str) -> None:
    worlds = look(arena, (180.0, -240.0))
    # (180, -240) is 300 = one notice radius away, along (0.6, -0.8).
    assert seen_monsters(worlds)[0] == pytest.approx([1.0, 0.6, -0.8, 1.0])
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, STAND)
    assert seen_monsters(worlds)[0, 3] == 0.5


# --- Order ---------------------------------------------------------------------------------------


def test_the_nearest_comes_first(arena: str) -> None:
    worlds = look(arena, (-400.0, 0.0), (0.0, 200.0), (-100.0, 0.0), (0.0, -300.0))
    assert (seen_monsters(worlds)[:, 0] * 300).tolist() == pytest.approx([100, 200, 300, 400])
    assert seen_monsters(worlds)[:, 1].tolist() == [-1, 0, 0, -1]  # each with its own direction
    assert seen_monsters(worlds)[:, 2].tolist() == [0, 1, -1, 0]


# --- Names and bounds ----------------------------------------------------------------------------


def test_the_space_is_float32_and_finite() -> None:
    space = Worlds(1).space
    assert space.dtype == np.float32
    assert np.isfinite(space.low).all() and np.isfinite(space.high).all()
    # No two places of 57 x 50 tiles of 64 px are further apart than hypot(3648, 3200) = 4852.6 px.
    assert space.high[4] == pytest.approx(4852.6 / 300, abs=1e-3)
