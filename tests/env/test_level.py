"""Levels: the shipped one, and what is said of one that cannot be read."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pneuma.env import rules
from pneuma.env.level import Level, load_level, room_for_bodies
from pneuma.errors import UserError

from .arena import layer, write_level

CODES = {390: "bamboo"}

# Places by facts.md, section 1.
STARTS = [(204, -105), (389, 348), (-239, -798), (-517, 897), (-918, -35), (-47, 201)]
MONSTERS = [
    (-538, -531), (-724, -311), (-566, 124), (-1211, 187), (-1233, -351), (-922, -786), (-741, 577),
    (-164, 554), (758, 192), (763, -713), (-158, -96), (967, -238), (294, -594), (560, -141),
]  # fmt: skip


@pytest.fixture(scope="module")
def thesis() -> Level:
    return load_level("thesis", CODES)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a good level: one start and one monster in an open field."""
    return Path(write_level(tmp_path / "level", [(0.0, 0.0)], [(200.0, 200.0)]))


def complaint(folder: Path) -> str:
    """Return what is said of a level that cannot be read."""
    with pytest.raises(UserError) as caught:
        load_level(str(folder), CODES)
    message = str(caught.value)
    assert "\n" not in message
    return message


def open_to_the_edge(folder: Path) -> Level:
    """Return the level with land up to the edge of the grid."""
    (folder / "ground.csv").write_text(layer(np.ones((20, 20), np.int64)))
    return load_level(str(folder), CODES)


def replace_line(path: Path, number: int, line: str) -> None:
    lines = path.read_text().splitlines()
    lines[number - 1] = line
    path.write_text("\n".join(lines) + "\n")


# --- The shipped level ---------------------------------------------------------------------------


def test_the_shipped_level_has_the_published_places(thesis: Level) -> None:
    assert thesis.starts.tolist() == [list(place) for place in STARTS]
    assert list(thesis.monsters) == [("bamboo", *place) for place in MONSTERS]


# --- What is said of a bad level -----------------------------------------------------------------


def test_an_unknown_level_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(UserError, match=re.escape("unknown level 'thesiss' (did you mean thesis?)")):
        load_level("thesiss", CODES)


@pytest.mark.parametrize("cell", ["x", "", "1.5"])
def test_a_tile_that_is_no_number_is_named_by_row_and_column(folder: Path, cell: str) -> None:
    replace_line(folder / "ground.csv", 4, ",".join(["1", "1", cell, *["1"] * 17]))
    assert complaint(folder) == f"{folder / 'ground.csv'}, row 4, column 3: {cell!r} is not a tile code"


def test_an_unknown_code_is_named_with_the_known_ones(folder: Path) -> None:
    replace_line(folder / "objects.csv", 3, "399,10,10")
    assert complaint(folder) == f"{folder / 'objects.csv'}, row 3: unknown code 399; known are 400, 390"


# --- Room for bodies -----------------------------------------------------------------------------


@pytest.mark.parametrize("margin", [0.5, 29.0, 40.0, 70.0, 100.0])
@pytest.mark.parametrize("coast", [True, False])
def test_there_is_room_where_no_closed_tile_comes_nearer_than_the_margin(
    thesis: Level, folder: Path, coast: bool, margin: float
) -> None:
    """Compare with every tile against every half tile, and the tiles beyond the grid closed."""
    level = thesis if coast else open_to_the_edge(folder)
    rows, columns = level.terrain.shape
    closed = np.pad(level.terrain != rules.OPEN, 3, constant_values=True)
    closed_row, closed_column = np.nonzero(closed)
    top, left = (closed_row - 3) * 64.0, (closed_column - 3) * 64.0
    cell_top, cell_left = np.arange(2 * rows) * 32.0, np.arange(2 * columns) * 32.0
    near_y = (top < cell_top[:, None] + 32 + margin) & (top + 64 > cell_top[:, None] - margin)
    near_x = (left < cell_left[:, None] + 32 + margin) & (left + 64 > cell_left[:, None] - margin)
    meets = near_y.astype(np.int32) @ near_x.T.astype(np.int32)  # (2 rows, 2 columns)
    assert np.array_equal(room_for_bodies(level, margin), (meets == 0).astype(np.uint8))
    assert (meets == 0).any() and (meets > 0).any()
