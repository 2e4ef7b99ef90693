"""Levels: the shipped one, folders of tables, random ones, and what is refused."""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label

from pneuma.env import rules
from pneuma.env.fields import SCALES, make_env_config
from pneuma.env.level import Level
from pneuma.env.load_level import load_level, load_levels
from pneuma.env.random_level import random_level
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import EMPTY, begin
from .oracle import Pair as Place

CODES = {390: "bamboo", 391: "spirit"}
SOLID, COAST = rules.SOLID, rules.COAST

# Places by facts.md, section 1.
STARTS = [(204, -105), (389, 348), (-239, -798), (-517, 897), (-918, -35), (-47, 201)]
MONSTERS = [
    (-538, -531), (-724, -311), (-566, 124), (-1211, 187), (-1233, -351), (-922, -786), (-741, 577),
    (-164, 554), (758, 192), (763, -713), (-158, -96), (967, -238), (294, -594), (560, -141),
]  # fmt: skip


def layer(tiles: np.ndarray) -> str:
    """Return a layer as the text of a CSV file."""
    return "".join(",".join(map(str, row)) + "\n" for row in tiles)


def refusal(**settings: Any) -> str:
    """Return the message about a world that cannot be made."""
    with pytest.raises(UserError) as caught:
        Worlds(1, make_env_config(settings))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_shipped_level_has_the_published_places() -> None:
    thesis = load_level("thesis", CODES)
    assert thesis.starts.tolist() == [list(start) for start in STARTS]
    assert list(thesis.monsters) == [("bamboo", *home) for home in MONSTERS]


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
    for name, text in files.items():
        (folder / f"{name}.{'toml' if name == 'level' else 'csv'}").write_text(text)
    for name, text in ISLE.items():
        if name.removesuffix(".csv") not in files:
            (folder / name).write_text(text)
    return folder


def test_a_header_says_where_the_land_ends_and_any_obstacle_blocks(tmp_path: Path) -> None:
    header = 'title = "Other"\ncoast = [0, 2]\norigin = [1, 0.5]\ntile = 80\n'
    obstacles, ground = "-1,-1,-1,-1\n-1,-1,-1,-1\n7,-1,-1,0\n\n", "1,1,1,1\n1,1,1,1\n0,2,1,1\n"
    level = load_level(str(write_folder(tmp_path, level=header, obstacles=obstacles, ground=ground)), CODES)
    assert (level.title, level.left, level.top) == ("Other", -80.0, -40.0)
    assert level.terrain[2].tolist() == [COAST, COAST, rules.OPEN, SOLID]


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"ground": "1,1,1,1\n1,x,1,1\n"}, "ground.csv: row 2, column 2: 'x' is not a number"),
        ({"ground": "1,1,1,1\n1,1,1\n"}, "ground.csv: row 2 has 3 numbers, row 1 has 4"),
        ({"ground": "1,1.5,1,1\n"}, "ground.csv: row 1, column 2: code 1.5 is not a whole number of 32 bits"),
        ({"objects": "code,x,y\n4294967696,0,0\n"}, "objects.csv: row 2, column 1: code 4294967696 is not"),
        ({"ground": ""}, "ground.csv: contains no numbers"),
        ({"objects": "code,x,y\n400,0\n"}, "objects.csv: row 2 has 2 numbers, not 3"),
        ({"objects": "code,x,y\n400,0,nan\n"}, "objects.csv: row 2, column 3: 'nan' is not a number"),
        ({"ground": "1,1,1,1\n1,,1,1\n"}, "ground.csv: row 2, column 2: '' is not a number"),
        (
            {"obstacles": ("-1," * 999 + "-1\n") * 251},
            "obstacles.csv: has 251,000 tiles; 250,000",
        ),
        (
            {"obstacles": "-1," * 2**24},
            "obstacles.csv: cannot be read: is larger than 16 MB",
        ),
        ({"objects": "400,0,0\n"}, "objects.csv: the first line must be code,x,y"),
        ({"obstacles": "-1,-1\n"}, ": ground of (3, 4) tiles, and obstacles of (1, 2)"),
        ({"objects": "code,x,y\n399,0,0\n"}, "objects.csv: unknown code 399; known are 400, 390"),
        ({"objects": "code,x,y\n390,0,0\n"}, "objects.csv: has no start place"),
        ({"level": "coats = [0]\n"}, "level.toml, line 1: unknown key 'coats' (did you mean coast?)"),
    ],
)
def test_refusals_name_file_and_row(tmp_path: Path, files: dict[str, str], message: str) -> None:
    folder = write_folder(tmp_path, **files)
    assert refusal(level=str(folder)).replace(f"{folder}/", "").removeprefix(str(folder)).startswith(message)


@pytest.mark.parametrize("turned", [0, 2**31, 2**30, 2**29, 2**28, -(2**31), -(2**30), 2**29 - 2**31])
def test_how_tiled_turns_a_picture_changes_no_code(tmp_path: Path, turned: int) -> None:
    """Water is code 0, a start place 400, 7 an obstacle; bits 28 to 31 are Tiled's, with or without sign."""
    folder = write_folder(
        tmp_path,
        ground=layer(GROUND + turned),
        obstacles=f"-1,-1,-1,{7 + turned}\n-1,-1,-1,-1\n-1,-1,-1,-1\n",
        objects=f"code,x,y\n{400 + turned},-96,-64\n{390 + turned},96,64\n",
    )
    level = load_level(str(folder), CODES)
    assert (level.tile, level.left, level.top) == (64.0, -128.0, -96.0)
    assert np.array_equal(level.ground, GROUND)
    assert np.array_equal(level.terrain == COAST, GROUND == 0) and level.terrain[0, 3] == SOLID
    assert level.starts.tolist() == [[-96.0, -64.0]] and level.monsters == (("bamboo", 96.0, 64.0),)


# --- Where bodies begin ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("start", "monster", "message", "allowed"),
    [
        # An obstacle is from x = 64 to 128 and from y = 0 to 64; bodies of 47 x 48 and 24 x 50 px.
        ((43.0, 0.0), (-200.0, 0.0),
         "start place 0 at (43, 0) is the centre of a body of 47 x 48 px, which row 11",
         {"trees": "pass"}),
        ((0.0, 0.0), (139.0, 32.0),
         "(bamboo) at (139, 32) is the centre of a body of 24 x 50 px, which row 11",
         {"terrain_stops": "players"}),
        ((0.0, 0.0), (629.0, 0.0),
         "at (629, 0) reaches beyond the level, which has x from -640 to 640 and y from -640 to 640", {}),
        ((0.0, 0.0), (-1e20, 0.0), "(bamboo) at (-1e+20, 0) reaches beyond the level", {}),
    ],
)  # fmt: skip
def test_a_body_that_begins_in_what_stops_it_is_refused(
    tmp_path: Path, start: Place, monster: Place, message: str, allowed: dict[str, Any]
) -> None:
    level = replace(EMPTY, starts=(start,), monsters=(("bamboo", *monster),), obstacles=((11, 10),))
    folder = level.write(tmp_path)
    assert message in refusal(level=folder)
    if allowed:
        begin(1, level=folder, **allowed)
    else:
        assert message in refusal(level=folder, terrain_stops="players")
    replace(level, starts=((42.0, 0.0),), monsters=(("bamboo", 140.0, 32.0),)).write(tmp_path)
    begin(1, level=folder)  # they only touch it


@pytest.mark.parametrize(("tile", "door"), [(20, 3), (48, 1)])
def test_a_door_must_let_a_body_of_48_px_through(tmp_path: Path, tile: int, door: int) -> None:
    """Two rooms of 6 x 12 tiles, a start and a monster, and a door so many tiles high between."""
    walls = {*itertools.product((0, 7, 14), range(14)), *itertools.product(range(15), (0, 13))}
    levels = []
    for gap in (door, door - 1):
        closed = tuple(walls - {(7, 4 + row) for row in range(gap)})
        start, monster = (2.5 * tile, 4.5 * tile), ("bamboo", 12.5 * tile, 9.5 * tile)
        level = replace(EMPTY, columns=15, rows=14, tile=tile, origin=(0, 0), shore=0, obstacles=closed)
        levels.append(replace(level, starts=(start,), monsters=(monster,)).write(tmp_path / str(gap)))
    assert begin(1, level=levels[0]).level.monsters
    message = refusal(level=levels[1])
    assert "monster 0 (bamboo) at " in message
    assert message.endswith("is walled in or off the land, for a body of 48 px")


# --- Random levels: the same from the number alone, none out of reach; one drawn an episode -------


def digest(level: Level) -> str:
    homes = np.array([monster[1:] for monster in level.monsters])
    arrays = (level.ground, level.terrain, level.starts, homes)
    return hashlib.sha256(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)).hexdigest()


def test_the_islands_are_those_that_stored_runs_were_trained_on() -> None:
    """A change here changes what a stored run's level means: raise `RULES_VERSION` with it."""
    for name, expected in {"train:17": "85aea74cd4139a19", "test:17": "03c2f3f8faed4a98"}.items():
        (level,) = load_levels(make_env_config({"level": f"random:{name}"}), CODES)
        assert (digest(level)[:16], level.name) == (expected, f"random:{name}")


def test_mixed_monsters_stand_where_the_others_do() -> None:
    mixed = random_level("test", 5, "mixed")
    assert digest(mixed) == digest(random_level("test", 5))
    names = Counter(name for name, _, _ in mixed.monsters)
    assert names == {"bamboo": 8, "squid": 2, "raccoon": 2, "spirit": 2}
    assert refusal(monsters="mixed").startswith("monsters = mixed")


@pytest.mark.parametrize("split", ["train", "test"])
def test_every_monster_can_be_walked_to_from_every_start(split: str) -> None:
    for number in range(30):
        level = random_level(split, number)
        regions, _ = label(level.terrain == rules.OPEN)
        positions = np.concatenate([level.starts, [monster[1:] for monster in level.monsters]])
        columns, rows = (((positions - (level.left, level.top)) // 64).astype(int)).T
        (region,) = set(regions[rows, columns].tolist())
        assert region > 0


@pytest.mark.parametrize("scale", SCALES)
def test_a_place_is_observed_alike_whichever_levels_are_played_together(scale: str) -> None:
    """So that what was learned on some islands holds on others."""
    single = Worlds(1, make_env_config({"level": "random:train:5", "scale": scale}))
    names = ["middle_x", "middle_y", "scale_x", "scale_y", "xp_scale"]
    for level, count in (("random:train:5", 20), ("random:test:3", 2)):
        settings = {"level": level, "random_levels": count, "scale": scale}
        together = Worlds(1, make_env_config(settings))
        assert together.space == single.space
        assert [together.settings[name] for name in names] == [single.settings[name] for name in names]
        assert together.monster_stats["distance_scale"][0, 0] == single.monster_stats["distance_scale"][0, 0]
