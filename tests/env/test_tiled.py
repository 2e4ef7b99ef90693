"""Levels as Tiled leaves them, in folders of CSV layers, and what is said of bad ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneuma.env import rules

from .isle import BAMBOO, EMPTY, ENTITIES, GROUND, START, complaint, load, write_folder

OPEN, SOLID, COAST = rules.OPEN, rules.SOLID, rules.COAST


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "Isle"


# --- Folders of CSV layers -----------------------------------------------------------------------


def test_a_folder_needs_no_header(folder: Path) -> None:
    level = load(write_folder(folder, Ground=GROUND))
    assert (level.title, level.tile, level.left, level.top) == ("Isle", 64.0, -128.0, -96.0)
    assert level.starts.tolist() == [START]
    assert level.monsters == (BAMBOO,)
    assert np.array_equal(level.ground, GROUND)
    assert np.array_equal(level.terrain == COAST, GROUND == 0)  # no codes given: what is drawn as water


def test_the_header_says_where_the_land_ends(folder: Path) -> None:
    write_folder(folder, Ground=GROUND)
    (folder / "level.toml").write_text('title = "Other"\ncoast = [0]\norigin = [1, 0.5]\ntile = 80\n')
    level = load(folder)
    assert (level.title, level.left, level.top) == ("Other", -80.0, -40.0)
    assert np.argwhere(level.terrain == COAST).tolist() == [[2, 0], [2, 1]]
    assert level.monsters == (("bamboo", 200.0, 160.0),)  # tile (3, 2): 3.5 x 80 - 80, 2.5 x 80 - 40


@pytest.mark.parametrize("flags", range(16))
@pytest.mark.parametrize("signed", [False, True])
def test_flipped_tiles_are_what_they_are_unflipped(folder: Path, flags: int, signed: bool) -> None:
    turned = flags * 2**28
    turned -= 2**32 if signed and turned >= 2**31 else 0
    blocks = EMPTY.astype(object)
    blocks[1, 2] = turned + 395
    level = load(write_folder(folder, FloorBlocks=blocks, Ground=GROUND + turned))
    assert np.argwhere(level.terrain == SOLID).tolist() == [[1, 2]]
    assert np.array_equal(level.ground, GROUND)


def test_entities_come_from_a_layer_and_a_table_together(folder: Path) -> None:
    level = load(write_folder(folder, Objects="code,x,y\n400,10,-20\n391,-30.5,40\n"))
    assert level.starts.tolist() == [START, [10.0, -20.0]]
    assert level.monsters == (BAMBOO, ("spirit", -30.5, 40.0))


@pytest.mark.parametrize(
    ("name", "row", "column", "code", "known"),
    [
        ("FloorBlocks", 0, 3, 7, "-1, 395; list it as `obstacles` if it blocks"),
        ("FloorBlocks", 2, 0, 0, "-1, 395; list it as `obstacles` if it blocks"),
        ("Entities", 1, 1, 389, "-1, 400, 390, 391, 392, 393"),
        ("Ground", 1, 2, 3, "-1, 0, 1, 2; name it in [ground]"),
    ],
)
def test_unknown_codes_are_named(
    folder: Path, name: str, row: int, column: int, code: int, known: str
) -> None:
    layers = {"FloorBlocks": EMPTY.copy(), "Entities": ENTITIES.copy(), "Ground": GROUND.copy()}
    layers[name][row, column] = code
    write_folder(folder, **layers)
    (folder / "level.toml").write_text('[ground]\n0 = "water"\n1 = "grass"\n2 = "sand"\n')
    where = f"{folder / f'map_{name}.csv'}, row {row + 1}, column {column + 1}"
    assert complaint(folder) == f"{where}: unknown code {code}; known are {known}"


@pytest.mark.parametrize("shape", [(1001, 2), (2, 1001)])
def test_more_than_1000_tiles_a_side_are_refused(folder: Path, shape: tuple[int, int]) -> None:
    message = complaint(write_folder(folder, FloorBlocks=np.full(shape, -1)))
    told = f"{shape[0]} x {shape[1]} tiles; at most 1000 a side are allowed"
    assert message == f"{folder / 'map_FloorBlocks.csv'}: {told}"


@pytest.mark.parametrize(
    "line",
    [
        "ground = 3", 'ground = "12"', "[ground]\ngrass = 1", '[ground]\n0 = "watre"', "[ground]\n0 = 7",
        "obstacles = [-1]",
    ],
)  # fmt: skip
def test_values_of_the_header_that_cannot_be_are_named_with_their_line(folder: Path, line: str) -> None:
    write_folder(folder)
    (folder / "level.toml").write_text(f'title = "A"\n{line}\n')
    assert complaint(folder).startswith(f"{folder / 'level.toml'}, line ")


# --- Who can walk where --------------------------------------------------------------------------


def write_hall(folder: Path, tile: int, door: int) -> Path:
    """Write two rooms of 6 x 12 tiles, a start and a monster, and a door so many tiles high between."""
    blocks, entities = np.full((14, 15), -1), np.full((14, 15), -1)
    blocks[[0, -1]] = blocks[:, [0, 7, -1]] = 395
    blocks[4 : 4 + door, 7] = -1
    entities[4, 2], entities[9, 12] = 400, 390
    write_folder(folder, FloorBlocks=blocks, Entities=entities)
    (folder / "level.toml").write_text(f"tile = {tile}\n")
    return folder


@pytest.mark.parametrize(("tile", "door"), [(64, 1), (48, 1), (47, 2), (32, 2), (24, 2), (23, 3)])
def test_a_door_must_let_a_body_of_48_px_through(folder: Path, tile: int, door: int) -> None:
    assert load(write_hall(folder, tile, door)).monsters
    message = complaint(write_hall(folder, tile, door - 1))
    assert "the bamboo is walled in or off the land" in message
    assert message.startswith(f"{folder / 'map_Entities.csv'}, row 10, column 13: ")
