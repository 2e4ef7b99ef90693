"""Levels as Tiled leaves them: folders of CSV layers, .tmx maps, and what is said of bad ones."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.env import rules
from pneuma.env.level import Level, level_files, load_level
from pneuma.errors import UserError

from .arena import layer, player_at, stage, write_level

CODES = {390: "bamboo", 391: "spirit"}
OPEN, SOLID, COAST = rules.OPEN, rules.SOLID, rules.COAST

# 4 x 3 tiles of 64 px around the origin: x from -128 to 128, y from -96 to 96. The start is in the
# upper left tile, the bamboo in the lower right one.
EMPTY = np.full((3, 4), -1)
GROUND = np.array([[1, 1, 1, 1], [1, 2, 2, 1], [0, 0, 1, 1]])
ENTITIES = np.array([[400, -1, -1, -1], [-1, -1, -1, -1], [-1, -1, -1, 390]])
START, BAMBOO = [-96.0, -64.0], ("bamboo", 96.0, 64.0)


def write_folder(folder: Path, **layers: Any) -> Path:
    """Write layers, arrays or text, as Tiled would name them for a map called `map`."""
    folder.mkdir(exist_ok=True)
    for name, tiles in {"FloorBlocks": EMPTY, "Entities": ENTITIES, **layers}.items():
        if tiles is not None:
            text = tiles if isinstance(tiles, str) else layer(tiles)
            (folder / f"map_{name}.csv").write_text(text)
    return folder


def load(path: Path) -> Level:
    return load_level(str(path), CODES)


def complaint(path: Path) -> str:
    """Return what is said of a level that cannot be read."""
    with pytest.raises(UserError) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


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
    assert (level.terrain == OPEN).all()  # no codes given, no coast


def test_a_folder_needs_no_ground_and_has_no_coast_then(folder: Path) -> None:
    level = load(write_folder(folder))
    assert (level.ground == -1).all() and (level.terrain == OPEN).all()
    assert level.land == (-128.0, -96.0, 128.0, 96.0)


def test_a_coast_needs_ground(folder: Path) -> None:
    write_folder(folder)
    (folder / "level.toml").write_text("coast = [0]\n")
    assert complaint(folder) == f"{folder / 'ground.csv'}: no such layer"


def test_the_header_says_where_the_land_ends(folder: Path) -> None:
    write_folder(folder, Ground=GROUND)
    (folder / "level.toml").write_text('title = "Other"\ncoast = [0]\norigin = [1, 0.5]\ntile = 80\n')
    level = load(folder)
    assert (level.title, level.left, level.top) == ("Other", -80.0, -40.0)
    assert np.argwhere(level.terrain == COAST).tolist() == [[2, 0], [2, 1]]
    assert level.monsters == (("bamboo", 200.0, 160.0),)  # tile (3, 2): 3.5 x 80 - 80, 2.5 x 80 - 40


@pytest.mark.parametrize(
    "name", ["obstacles", "island_Obstacles", "FLOORBLOCKS", "my map-Blocks", "a.b Floor Blocks"]
)
def test_the_last_word_of_a_files_name_says_which_layer_it_is(folder: Path, name: str) -> None:
    blocks = EMPTY.copy()
    blocks[1, 2] = 395
    write_folder(folder, FloorBlocks=None)
    (folder / f"{name}.CSV").write_text(layer(blocks))
    (folder / "map_Grass.csv").write_text("not a layer of ours")
    assert np.argwhere(load(folder).terrain == SOLID).tolist() == [[1, 2]]


def test_two_files_for_one_layer_are_refused(folder: Path) -> None:
    write_folder(folder, Blocks=EMPTY)
    assert complaint(folder) == (
        f"{folder}: map_Blocks.csv and map_FloorBlocks.csv are both named obstacles; keep one"
    )


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


def test_either_of_them_may_hold_the_start(folder: Path) -> None:
    without = np.where(ENTITIES == 400, -1, ENTITIES)
    assert complaint(write_folder(folder, Entities=without)) == (
        f"{folder / 'map_Entities.csv'}: no start place (code 400)"
    )
    level = load(write_folder(folder, Entities=without, Objects="code,x,y\n400,0,0\n"))
    assert level.starts.tolist() == [[0.0, 0.0]] and level.monsters == (BAMBOO,)


def test_a_layer_where_the_table_belongs_is_told_its_name(folder: Path) -> None:
    message = complaint(write_folder(folder, Objects=ENTITIES))
    assert message.startswith(f"{folder / 'map_Objects.csv'}, row 2: expected code,x,y")
    assert "called entities" in message


@pytest.mark.parametrize(
    ("name", "row", "column", "code", "known"),
    [
        ("FloorBlocks", 0, 3, 7, "-1, 395; list it as `obstacles` if it blocks"),
        ("FloorBlocks", 2, 0, 0, "-1, 395; list it as `obstacles` if it blocks"),
        ("Entities", 1, 1, 393, "-1, 400, 390, 391"),
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


def test_any_ground_is_known_where_none_is_named(folder: Path) -> None:
    assert load(write_folder(folder, Ground=GROUND + 99)).ground[0, 0] == 100


def test_the_header_may_list_more_obstacles(folder: Path) -> None:
    blocks = EMPTY.copy()
    blocks[0, 2], blocks[1, 1], blocks[1, 2] = 7, 395, 12
    write_folder(folder, FloorBlocks=blocks)
    (folder / "level.toml").write_text("obstacles = [7, 12]\n")
    assert np.argwhere(load(folder).terrain == SOLID).tolist() == [[0, 2], [1, 1], [1, 2]]


@pytest.mark.parametrize("cell", ["4294967296", "-2", "16777216", "1_0", "٣", "99999999999999", '"1"'])
def test_numbers_that_no_tile_has_are_refused(folder: Path, cell: str) -> None:
    write_folder(folder, Ground=f"1,1,1,1\n1,{cell},1,1\n1,1,1,1\n")
    assert complaint(folder) == f"{folder / 'map_Ground.csv'}, row 2, column 2: {cell!r} is not a tile code"


@pytest.mark.parametrize("shape", [(1001, 2), (2, 1001)])
def test_more_than_1000_tiles_a_side_are_refused(folder: Path, shape: tuple[int, int]) -> None:
    message = complaint(write_folder(folder, FloorBlocks=np.full(shape, -1)))
    told = f"{shape[0]} x {shape[1]} tiles; at most 1000 a side are allowed"
    assert message == f"{folder / 'map_FloorBlocks.csv'}: {told}"


@pytest.mark.parametrize("name", ["Ground", "Entities"])
def test_layers_of_unequal_size_are_refused(folder: Path, name: str) -> None:
    tiles = ENTITIES if name == "Entities" else GROUND
    message = complaint(write_folder(folder, **{name: tiles[:, :3]}))
    assert "3 x 3" in message and "3 x 4" in message and str(folder) in message


def test_blank_lines_at_the_end_and_a_byte_order_mark_do_no_harm(folder: Path) -> None:
    write_folder(folder, Ground="\ufeff" + layer(GROUND) + "\r\n\n")
    assert np.array_equal(load(folder).ground, GROUND)


@pytest.mark.parametrize("name", ["map_Ground.csv", "map_Objects.csv", "level.toml"])
def test_files_that_are_no_text_are_named(folder: Path, name: str) -> None:
    write_folder(folder)
    (folder / name).write_bytes(b"\xff\xfe1\x00")
    assert complaint(folder) == f"{folder / name}: cannot be read: it is not UTF-8 text"


@pytest.mark.parametrize("line", ["ground = 3", 'ground = "12"', "[ground]\ngrass = 1", "obstacles = [-1]"])
def test_values_of_the_header_that_cannot_be_are_named_with_their_line(folder: Path, line: str) -> None:
    write_folder(folder)
    (folder / "level.toml").write_text(f'title = "A"\n{line}\n')
    assert complaint(folder).startswith(f"{folder / 'level.toml'}, line 2: ")


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


@pytest.mark.parametrize(
    ("tile", "door"), [(64, 1), (48, 1), (47, 2), (32, 2), (24, 2), (23, 3), (16, 3), (8, 6)]
)
def test_a_door_must_let_a_body_of_48_px_through(folder: Path, tile: int, door: int) -> None:
    assert load(write_hall(folder, tile, door)).monsters
    message = complaint(write_hall(folder, tile, door - 1))
    assert message.endswith("the bamboo is walled in or off the land")
    assert message.startswith(f"{folder / 'map_Entities.csv'}, row 10, column 13: ")


@pytest.mark.parametrize(("door", "passes"), [(1, False), (2, True)])
def test_the_rules_agree_on_who_passes_a_door(folder: Path, door: int, passes: bool) -> None:
    # Tiles of 32 px; the door's column is x from -16 to 16, its upper edge y = (4 - 7) x 32 = -96.
    write_hall(folder, 32, 2)
    worlds = stage(str(folder), players=[(-60.0, -96.0 + 16.0 * door)])
    if door == 1:
        worlds._arrays.terrain[0, 5, 7] = SOLID
        worlds._arrays.room[:] = 0
    for _ in range(6):
        worlds.step(np.array([[rules.RIGHT]]))
    assert (player_at(worlds)[0] > 60.0) is passes


def test_a_start_that_is_cut_off_is_the_one_that_is_named(folder: Path) -> None:
    write_hall(folder, 64, 0)
    table = "code,x,y\n400,200,0\n391,250,0\n"  # both in the room on the right
    (folder / "objects.csv").write_text(table)
    message = complaint(folder)
    assert (
        message == f"{folder / 'map_Entities.csv'}, row 5, column 3: the start is walled in or off the land"
    )


def test_a_body_may_overlap_a_closed_tile_but_not_stand_in_one(tmp_path: Path) -> None:
    # The obstacle fills x and y from 64 to 128; a bamboo is 24 x 50 px.
    beside = write_level(tmp_path / "a", [(0.0, 0.0)], [(63.0, 96.0)], [(11, 11)])
    assert load(Path(beside)).monsters == (("bamboo", 63.0, 96.0),)
    inside = write_level(tmp_path / "b", [(0.0, 0.0)], [(64.0, 96.0)], [(11, 11)])
    assert "the bamboo at 64,96 is walled in" in complaint(Path(inside))


# --- Maps of Tiled's -----------------------------------------------------------------------------

GROUND_IDS = GROUND + 1  # of the first tileset, whose ids begin at 1
BLOCK_IDS = np.zeros((3, 4), np.int64)
ENTITY_IDS = np.where(ENTITIES == -1, 0, ENTITIES + 1001)  # of the second, from 1001


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


def test_a_folder_and_a_map_make_the_same_level(tmp_path: Path) -> None:
    """The shipped level written as a map: every array is the same, but for where the origin is."""
    shipped = load_level("thesis", {390: "bamboo"})
    ids = np.where(shipped.ground == -1, 0, shipped.ground + 1)
    blocks = np.where(shipped.terrain == SOLID, 1396, 0)
    names = [("start", x, y) for x, y in shipped.starts] + list(shipped.monsters)
    items = [
        f'<object id="{index}" name="{name}" x="{x - shipped.left}" y="{y - shipped.top}"><point/></object>'
        for index, (name, x, y) in enumerate(names)
    ]
    path = write_map(
        tmp_path,
        [tile_layer("Ground", ids), tile_layer("Obstacles", blocks), object_layer(*items)],
        '<property name="coast" value="0"/>',
        'width="57" height="50" tilewidth="64" tileheight="64"',
    )
    level = load(path)
    assert np.array_equal(level.ground, shipped.ground) and np.array_equal(level.terrain, shipped.terrain)
    shift = np.array([level.left - shipped.left, level.top - shipped.top])
    assert shift.tolist() == [-32.0, 0.0]  # the middle of 57 columns is half a tile right of column 28
    assert np.array_equal(level.starts, shipped.starts + shift)
    assert level.monsters == tuple((kind, x - 32.0, y) for kind, x, y in shipped.monsters)


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
        ({"sizes": 'width="4" height="3" tilewidth="4" tileheight="4"'}, "tilewidth = '4' is not allowed"),
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


def ids_but(row: int, column: int, tile: int) -> np.ndarray:
    ids = ENTITY_IDS.copy()
    ids[row, column] = tile
    return ids


@pytest.mark.parametrize(
    ("layer_text", "told"),
    [
        (tile_layer("Entities", ids_but(1, 2, 1400)), "row 2, column 3: unknown code 399; known are"),
        (tile_layer("Entities", ids_but(1, 2, -1)), "row 2, column 3: tile -1 belongs to no tileset"),
        (
            tile_layer("Entities", "1401,0,x,0,\n0,0,0,0,\n0,0,0,1391"),
            "row 1, column 3: 'x' is not a tile code",
        ),
        (tile_layer("Entities", "1401,0,0,0,\n0,0,0,\n0,0,0,1391"), "row 2: 3 tiles, where row 1 has 4"),
        (tile_layer("Entities", "1401,0,0,0,\n0,0,0,1391"), "2 x 4 tiles, where the map has 3 x 4"),
        (tile_layer("Entities", ""), "the layer is empty"),
        (tile_layer("Entities", ENTITY_IDS, 'offsetx="3"'), "shifted against the tiles"),
        (
            '<layer name="Entities"><data encoding="base64" compression="zlib">eJw=</data></layer>',
            "not stored as CSV",
        ),
        ('<layer name="Entities"><data><tile gid="1401"/></data></layer>', "not stored as CSV"),
        ('<layer name="Entities"/>', "not stored as CSV"),
    ],
)
def test_layers_of_a_map_that_cannot_be_read_are_named(folder: Path, layer_text: str, told: str) -> None:
    path = write_map(folder, [*LAYERS[:2], layer_text])
    where = f"{path}, layer 'Entities'"
    assert complaint(path).startswith((f"{where}: {told}", f"{where}, {told}"))


def test_a_tile_of_no_tileset_and_a_second_layer_of_a_name_are_refused(folder: Path) -> None:
    path = write_map(folder, tilesets='<tileset firstgid="2" source="x.tsx"/>')
    assert complaint(path) == f"{path}, layer 'Ground', row 3, column 1: tile 1 belongs to no tileset"
    path = write_map(folder, tilesets="")
    assert complaint(path) == f"{path}, layer 'Ground', row 1, column 1: tile 2 belongs to no tileset"
    path = write_map(folder, [*LAYERS, tile_layer("more blocks", BLOCK_IDS)])
    assert complaint(path) == f"{path}, layer 'more blocks': the second layer named obstacles; keep one"


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
        ('name="bamboo" x="-1" y="1"', "the bamboo is walled in or off the land"),
    ],
)
def test_objects_of_a_map_that_cannot_be_are_named(folder: Path, item: str, told: str) -> None:
    path = write_map(folder, [*LAYERS, object_layer(f'<object id="12" {item}/>')])
    message = complaint(path)
    assert message.startswith(f"{path}, object 12: ") and told in message


def test_a_map_in_another_encoding_hides_no_entities(folder: Path) -> None:
    path = write_map(folder, head="<!DOCTYPE map [<!ENTITY a 'ha'>]>\n")
    text = path.read_text()
    for encoding in ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-le"):
        path.write_bytes(text.replace("UTF-8", encoding).encode(encoding))
        assert complaint(path) == f"{path}: cannot be read: it is not UTF-8 text"


# --- Which files a level depends on --------------------------------------------------------------


def test_a_level_depends_on_its_layers_and_its_header(folder: Path) -> None:
    write_folder(folder, Ground=GROUND, Grass=GROUND)
    (folder / "notes.txt").write_text("")
    names = ["map_Entities.csv", "map_FloorBlocks.csv", "map_Ground.csv"]
    assert level_files(str(folder)) == [folder / name for name in names]
    (folder / "level.toml").write_text("")
    assert level_files(str(folder)) == [folder / "level.toml", *(folder / name for name in names)]
    path = write_map(folder)
    assert level_files(str(path)) == [path]


def test_levels_that_are_no_files_of_the_users_depend_on_none() -> None:
    assert level_files("thesis") == level_files("random:train:3") == level_files("random:test:3") == []


@pytest.mark.parametrize("name", ["thesi", "nowhere/map.tmx", "nowhere"])
def test_files_of_an_unknown_level_are_asked_for_in_vain(name: str) -> None:
    for ask in (level_files, lambda level: load_level(level, CODES)):
        with pytest.raises(UserError, match=r"unknown level .* known are thesis, random:train:N.*\.tmx file"):
            ask(name)
