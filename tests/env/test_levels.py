"""Levels: the shipped one, folders of tables, and what is said of bad ones."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.env import rules
from pneuma.env.fields import make_env_config
from pneuma.env.level import Level
from pneuma.env.load_level import load_level
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import EMPTY, Place, begin

CODES = {390: "bamboo", 391: "spirit"}
SOLID, COAST = rules.SOLID, rules.COAST
Tile = tuple[int, int]

# Places by facts.md, section 1.
STARTS = [(204, -105), (389, 348), (-239, -798), (-517, 897), (-918, -35), (-47, 201)]
MONSTERS = [
    (-538, -531), (-724, -311), (-566, 124), (-1211, 187), (-1233, -351), (-922, -786), (-741, 577),
    (-164, 554), (758, 192), (763, -713), (-158, -96), (967, -238), (294, -594), (560, -141),
]  # fmt: skip


def load(path: Path) -> Level:
    return load_level(str(path), CODES)


def layer(tiles: np.ndarray) -> str:
    """Return a layer as the text of a CSV file."""
    return "".join(",".join(str(code) for code in row) + "\n" for row in tiles)


def complaint(**settings: Any) -> str:
    """Return what is said of a world that cannot be made."""
    with pytest.raises(UserError) as caught:
        Worlds(1, make_env_config(settings))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_shipped_level_has_the_published_places() -> None:
    thesis = load_level("thesis", CODES)
    assert thesis.starts.tolist() == [list(place) for place in STARTS]
    assert list(thesis.monsters) == [("bamboo", *place) for place in MONSTERS]


# --- Folders -------------------------------------------------------------------------------------

# 4 x 3 tiles of 64 px around the origin: x from -128 to 128, y from -96 to 96.
GROUND = np.array([[1, 1, 1, 1], [1, 2, 2, 1], [0, 0, 1, 1]])
ISLE = {
    "ground.csv": layer(GROUND),
    "obstacles.csv": layer(np.full((3, 4), -1)),
    "objects.csv": "code,x,y\n400,-96,-64\n390,96,64\n",
}


def write_folder(folder: Path, **files: str) -> Path:
    """Write the isle with other files; `level` stands for level.toml, the others for tables."""
    folder.mkdir(exist_ok=True)
    named = {f"{name}.{'toml' if name == 'level' else 'csv'}": text for name, text in files.items()}
    for name, text in {**ISLE, **named}.items():
        (folder / name).write_text(text)
    return folder


def test_a_folder_needs_no_header(tmp_path: Path) -> None:
    level = load(write_folder(tmp_path / "Isle"))
    assert (level.tile, level.left, level.top) == (64.0, -128.0, -96.0)
    assert level.starts.tolist() == [[-96.0, -64.0]] and level.monsters == (("bamboo", 96.0, 64.0),)
    assert np.array_equal(level.ground, GROUND)
    assert np.array_equal(level.terrain == COAST, GROUND == 0)


def test_a_header_says_where_the_land_ends_and_any_obstacle_blocks(tmp_path: Path) -> None:
    header = 'title = "Other"\ncoast = [0, 2]\norigin = [1, 0.5]\ntile = 80\n'
    obstacles, ground = "-1,-1,-1,-1\n-1,-1,-1,-1\n7,-1,-1,0\n", "1,1,1,1\n1,1,1,1\n0,2,1,1\n"
    level = load(write_folder(tmp_path, level=header, obstacles=obstacles, ground=ground))
    assert (level.title, level.left, level.top) == ("Other", -80.0, -40.0)
    assert level.terrain[2].tolist() == [COAST, COAST, rules.OPEN, SOLID]


@pytest.mark.parametrize(
    ("files", "told"),
    [
        ({"ground": "1,1,1,1\n1,x,1,1\n"}, "ground.csv: row 2: column 2: Input should be a valid integer"),
        ({"ground": "1,1,1,1\n1,1,1\n"}, "ground.csv: row 2 has 3 tiles, row 1 has 4"),
        ({"ground": "4294967296\n"}, "ground.csv: row 1: column 1: Input should be less than 4294967296"),
        ({"objects": "code,x,y\n400,0\n"}, "objects.csv: row 2: column 3: Field required"),
        ({"objects": "code,x,y\n400,0,nan\n"}, "objects.csv: row 2: column 3: Input should be a finite"),
        ({"obstacles": "-1,-1\n"}, ": ground of (3, 4) tiles, and obstacles of (1, 2)"),
        ({"objects": "code,x,y\n399,0,0\n"}, "objects.csv: unknown code 399; known are 400, 390"),
        ({"objects": "code,x,y\n390,0,0\n"}, "objects.csv: no start place"),
        ({"level": "coats = [0]\n"}, "level.toml, line 1: unknown key 'coats' (did you mean coast?)"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_told_with_file_and_row(tmp_path: Path, files: dict[str, str], told: str) -> None:
    folder = write_folder(tmp_path, **files)
    assert complaint(level=str(folder)).startswith(f"{folder}{'' if told.startswith(':') else '/'}{told}")


@pytest.mark.parametrize("turned", [2**31, 2**30, 2**29, 2**28, -(2**31), -(2**30), 2**29 - 2**31])
def test_how_tiled_turns_a_picture_changes_no_code(tmp_path: Path, turned: int) -> None:
    """Water is code 0, a start place 400, 7 an obstacle; bits 28 to 31 are Tiled's, with or without sign."""
    level = load(
        write_folder(
            tmp_path,
            ground=layer(GROUND + turned),
            obstacles=f"-1,-1,-1,{7 + turned}\n-1,-1,-1,-1\n-1,-1,-1,-1\n",
            objects=f"code,x,y\n{400 + turned},-96,-64\n{390 + turned},96,64\n",
        )
    )
    assert np.array_equal(level.ground, GROUND)
    assert np.array_equal(level.terrain == COAST, GROUND == 0) and level.terrain[0, 3] == SOLID
    assert level.starts.tolist() == [[-96.0, -64.0]] and level.monsters == (("bamboo", 96.0, 64.0),)


# --- Where bodies begin, and walk ----------------------------------------------------------------

ORIGIN = (0.0, 0.0)


@pytest.mark.parametrize(
    ("starts", "monsters", "obstacles", "told", "allowed"),
    [
        # 8 px inside two obstacles, from x = 64 and from y = 64: no step would ever get it out.
        ([(300.0, 300.0), (48.5, 48.0)], [(-200.0, -200.0)], [(11, 10), (10, 11)],
         "start place 1 at (48.5, 48) has a body of 47 x 48 px, stuck in row 11, column 12",
         {"trees": "pass"}),
        ([(200.0, 200.0)], [(-380.0, 32.0)], [(3, 10)], "(bamboo) at (-380, 32) has a body of 24 x 50",
         {"terrain_stops": "players"}),
        ([ORIGIN], [(200.0, 0.0), (33.0, 0.0)], [], "(bamboo) at (33, 0) begins inside start place 0",
         {}),
        ([ORIGIN], [(200.0, 0.0), (223.0, 49.0)], [], "(bamboo) at (200, 0) begins inside monster 1",
         {}),
        ([ORIGIN, (46.0, 47.0)], [(200.0, 0.0)], [], "start place 0 at (0, 0) begins inside start place 1",
         {}),
    ],
)  # fmt: skip
def test_bodies_that_begin_in_what_stops_them_are_refused(
    tmp_path: Path, starts: list[Place], monsters: list[Place], obstacles: list[Tile], told: str,
    allowed: dict[str, Any],
) -> None:  # fmt: skip
    """A pixel less and they touch: 34 px to the right of a player, 24 x 50 px for two bamboos, 47 x 48."""

    def settings() -> dict[str, Any]:
        bamboos = tuple(("bamboo", x, y) for x, y in monsters)
        level = replace(EMPTY, starts=tuple(starts), monsters=bamboos, obstacles=tuple(obstacles))
        return {"level": level.write(tmp_path), "players": len(starts)}

    assert told in complaint(**settings())
    if "begins inside" in told:
        last = starts if len(starts) > 1 else monsters
        last[-1] = (last[-1][0] + 1, last[-1][1])
    begin(1, **settings(), **allowed)


@pytest.mark.parametrize(("tile", "door"), [(64, 1), (48, 1), (47, 2), (24, 2), (23, 3)])
def test_a_door_must_let_a_body_of_48_px_through(tmp_path: Path, tile: int, door: int) -> None:
    """Two rooms of 6 x 12 tiles, a start and a monster, and a door so many tiles high between."""
    walls = {(column, row) for column in (0, 7, 14) for row in range(14)}
    walls |= {(column, row) for column in range(15) for row in (0, 13)}

    def hall(gap: int) -> str:
        closed = tuple(walls - {(7, 4 + row) for row in range(gap)})
        start, monster = (2.5 * tile, 4.5 * tile), ("bamboo", 12.5 * tile, 9.5 * tile)
        level = replace(EMPTY, columns=15, rows=14, tile=tile, origin=(0, 0), shore=0, obstacles=closed)
        return replace(level, starts=(start,), monsters=(monster,)).write(tmp_path)

    assert begin(1, level=hall(door)).level.monsters
    assert "monster 0 (bamboo) at " in (told := complaint(level=hall(door - 1)))
    assert told.endswith("is walled in or off the land, for a body of 48 px")
