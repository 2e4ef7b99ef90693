"""Levels as Tiled saves them, in .tmx maps, what is said of bad ones, and which files a level is made of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.env import rules

from .isle import BAMBOO, ENTITIES, GROUND, START, complaint, load

OPEN, SOLID, COAST = rules.OPEN, rules.SOLID, rules.COAST


GROUND_IDS = GROUND + 1  # of the first tileset, whose ids begin at 1
BLOCK_IDS = np.zeros((3, 4), np.int64)
ENTITY_IDS = np.where(ENTITIES == -1, 0, ENTITIES + 1001)  # of the second, from 1001


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "Isle"


def tile_layer(name: str, ids: Any, attributes: str = "") -> str:
    """Return a layer of tiles as Tiled writes it: a comma after every row but the last."""
    text = ids if isinstance(ids, str) else ",\n".join(",".join(str(tile) for tile in row) for row in ids)
    return (
        f'<layer id="1" name="{name}" width="4" height="3" {attributes}>\n'
        f'<data encoding="csv">\n{text}\n</data>\n</layer>\n'
    )


def object_layer(*objects: str, attributes: str = "") -> str:
    return f'<objectgroup id="9" name="Object Layer 1" {attributes}>{"".join(objects)}</objectgroup>\n'


TILESETS = (
    '<tileset firstgid="1001" source="things.tsx"/>\n'
    '<tileset firstgid="1" name="ground" tilewidth="64" tileheight="64" tilecount="6" columns="6">'
    '<tile id="2"><objectgroup><object id="1" name="outline" x="0" y="0" width="64" height="32"/>'
    "</objectgroup></tile></tileset>\n"
)
SIZES = 'width="4" height="3" tilewidth="64" tileheight="64"'
LAYERS = (
    tile_layer("Ground", GROUND_IDS),
    tile_layer("Floor Blocks", BLOCK_IDS),
    tile_layer("Entities", ENTITY_IDS),
)


def write_map(
    folder: Path,
    layers: Sequence[str] = LAYERS,
    properties: str = "",
    sizes: str = SIZES,
    tilesets: str = TILESETS,
    head: str = "",
    attributes: str = 'orientation="orthogonal" infinite="0"',
) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "isle.tmx"
    path.write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n{head}<map version="1.10" {attributes} {sizes}>\n'
        f"<properties>{properties}</properties>\n{tilesets}{''.join(layers)}</map>\n"
    )
    return path


def test_a_map_is_read_with_each_tilesets_own_codes(folder: Path) -> None:
    blocks = BLOCK_IDS.copy()
    blocks[1, 1], blocks[1, 2] = 1396, 1396 + 2**31  # 1001 + 395, and the same flipped
    level = load(write_map(folder, [LAYERS[0], tile_layer("obstacles", blocks), LAYERS[2]]))
    assert (level.title, level.tile, level.left, level.top) == ("isle", 64.0, -128.0, -96.0)
    assert np.array_equal(level.ground, GROUND)
    assert np.argwhere(level.terrain == SOLID).tolist() == [[1, 1], [1, 2]]
    assert level.starts.tolist() == [START] and level.monsters == (BAMBOO,)


def test_a_maps_properties_are_its_header(folder: Path) -> None:
    blocks = BLOCK_IDS.copy()
    blocks[1, 1] = 1001 + 7
    properties = (
        '<property name="title" value="Far &amp; away"/><property name="coast" value="0, 2"/>'
        '<property name="obstacles" type="int" value="7"/><property name="mine" value="?"/>'
    )
    grass = np.ones((3, 4), np.int64) + 1
    grass[1, 3], grass[1, 2] = 0 + 1, 2 + 1
    layers = [tile_layer("ground", grass), tile_layer("obstacles", blocks), LAYERS[2]]
    level = load(write_map(folder, layers, properties, 'width="4" height="3" tilewidth="48" tileheight="48"'))
    assert (level.title, level.tile, level.left) == ("Far & away", 48.0, -96.0)
    assert level.terrain[1].tolist() == [OPEN, SOLID, COAST, COAST]


@pytest.mark.parametrize(
    ("item", "place"),
    [
        ('name="start" x="100" y="50"', [-28.0, -46.0]),
        ('type="Start" name="here" x="100" y="50"', [-28.0, -46.0]),
        ('class="start" x="100" y="50"', [-28.0, -46.0]),
        ('name="START" x="100" y="50" width="20" height="10"', [-18.0, -41.0]),  # its middle
        ('gid="1401" x="100" y="80" width="64" height="64"', [4.0, -48.0]),  # by its lower left corner
        ('gid="3221226873" x="100" y="80" width="64" height="64"', [4.0, -48.0]),  # flipped both ways
        ('name="start" x="100" y="50" rotation="30"', [-28.0, -46.0]),  # a point has no angle
    ],
)
def test_objects_stand_where_tiled_shows_them(folder: Path, item: str, place: list[float]) -> None:
    objects = object_layer(f'<object id="5" {item}/>', '<object id="6" name="Spirit" x="200" y="100"/>')
    level = load(write_map(folder, [LAYERS[1], f'<group name="g">{objects}</group>']))
    assert level.starts.tolist() == [place]
    assert level.monsters == (("spirit", 72.0, 4.0),)
    assert (level.ground == -1).all()


BOMB = "<!DOCTYPE map [<!ENTITY a 'ha'>" + "".join(
    f"<!ENTITY {chr(98 + i)} '{f'&{chr(97 + i)};' * 10}'>" for i in range(12)
)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"head": BOMB + "]>\n"}, "a DOCTYPE or entities are declared"),
        ({"head": "<!doctype map>\n"}, "a DOCTYPE or entities are declared"),
        ({"attributes": 'infinite="1"'}, "the map is infinite; untick Infinite in Tiled's map properties"),
        ({"attributes": 'orientation="isometric"'}, "not an orthogonal map of Tiled's"),
        ({"attributes": "broken"}, "not XML: "),
        ({"sizes": 'width="4" height="3" tilewidth="64" tileheight="32"'}, "tiles of 64 x 32 px"),
        ({"sizes": 'width="4" height="3" tilewidth="4" tileheight="4"'}, "tile = 4.0 is not allowed"),
        (
            {"sizes": 'width="4" height="1001" tilewidth="64" tileheight="64"'},
            "height = '1001' is not allowed",
        ),
        ({"sizes": 'width="4" tilewidth="64" tileheight="64"'}, "height = '' is not allowed"),
        ({"layers": LAYERS[::2]}, "no layer of tiles named obstacles"),
        (
            {"layers": LAYERS[1:], "properties": '<property name="coast" value="0"/>'},
            "no layer of tiles named ground",
        ),
        ({"properties": '<property name="coast" value="sea"/>'}, "coast = 'sea' is not allowed"),
        ({"layers": LAYERS[:2]}, "no start place (code 400)"),
        ({"tilesets": '<tileset name="x"/>'}, "tileset: firstgid = '' is not allowed"),
    ],
)
def test_maps_that_cannot_be_read_are_told_why(folder: Path, changes: dict[str, Any], told: str) -> None:
    path = write_map(folder, **changes)
    separator = ", " if told.startswith("tileset") else ": "
    assert complaint(path).startswith(f"{path}{separator}{told}")


@pytest.mark.parametrize(
    ("item", "told"),
    [
        ('name="tree" x="1" y="1"', "'tree' is neither a start nor a monster"),
        ('x="1" y="1"', "is neither a start nor a monster"),
        ('gid="1400" x="1" y="1"', "is neither a start nor a monster"),
        ('gid="x" x="1" y="1"', "gid = 'x' is not allowed"),
        ('name="bamboo" x="1"', "y = '' is not allowed"),
        ('name="bamboo" x="nan" y="1"', "x = 'nan' is not allowed"),
        ('name="bamboo" x="1" y="1" width="9" height="9" rotation="45"', "turned by an angle"),
    ],
)
def test_objects_of_a_map_that_cannot_be_are_named(folder: Path, item: str, told: str) -> None:
    path = write_map(folder, [*LAYERS, object_layer(f'<object id="12" {item}/>')])
    message = complaint(path)
    assert message.startswith(f"{path}, object 12: ") and told in message
