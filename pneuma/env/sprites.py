"""Pictures of everything in the world, made from the art in `sprite_art.py`.

A picture is a uint8 array of shape (height, width, 4): red, green, blue and opacity of art pixels,
of which a tile is 16 wide. The ground is painted as a whole, because shores and the seams between
snow, grass and sand run across tiles. `render.py` puts it all together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from pneuma.env import sprite_art as art
from pneuma.env.tiled import GROUNDS

TILE = 16
"""Art pixels along a tile."""

FACINGS = ("down", "left", "up", "right")
"""Names of `rules.DOWN`, `LEFT`, `UP` and `RIGHT`."""

SWINGS = ("begin", "strike", "follow")
"""Three moments of a sword's swing."""

WHITE, RED, GOLD, PLATE = "fffaf0", "e8503f", "ffcf3f", "2a1b33"

_QUARTER_TURNS = {"up": 0, "left": 1, "down": 2, "right": 3}


# --- Who and what stands in the world ------------------------------------------------------------


@cache
def player_picture(index: int, facing: str, pose: str, flash: str = "") -> np.ndarray:
    """Return the picture of player `index`, in the cloak that is theirs.

    Args:
        index: which player; from the ninth on, cloaks repeat.
        facing: one of `FACINGS`.
        pose: "stand", "stride" or "strike".
        flash: a colour to flash in, or none.
    """
    colours = art.COLOURS | art.TINTS[index % len(art.TINTS)]
    drawn = _read_sheets((art.PLAYER_UP_AND_DOWN, art.PLAYER_ASIDE), colours)
    if facing == "right":
        return _kept(_flashed(np.fliplr(drawn[f"left-{pose}"]), flash))
    return _kept(_flashed(drawn[f"{facing}-{pose}"], flash))


@cache
def monster_picture(kind: str, pose: int, alert: bool = False, flash: str = "") -> np.ndarray:
    """Return the picture of a monster, or of a stranger where the kind is unknown.

    Args:
        kind: as in `data/characters.toml`.
        pose: 0 or 1, as it shifts its weight.
        alert: whether it has noticed somebody; its eyes show it.
        flash: a colour to flash in, or none.
    """
    colours = art.COLOURS | (art.ALERT_EYES if alert else {})
    drawn = _read_sheets((art.BAMBOO_AND_STRANGER, art.OTHER_MONSTERS), colours)
    return _kept(_flashed(drawn.get(f"{kind}-{pose}", drawn[f"stranger-{pose}"]), flash))


@cache
def obstacle_picture(name: str) -> np.ndarray:
    """Return the picture of a pine, tree, rock, cactus or grave."""
    return _kept(read_sheet(art.OBSTACLES, art.COLOURS)[name])


@cache
def sword_picture(facing: str, moment: str) -> np.ndarray:
    """Return a sword at one of the `SWINGS`; its centre is the weapon's place."""
    drawn = _read_sheets((art.SWORD, art.SLASH), art.COLOURS)
    picture = np.zeros((18, 24, 4), np.uint8)
    trail = picture[3:10, 2:22]
    trail[...] = drawn["slash"]
    if moment == "begin":
        trail[...] = 0
        _lay(picture, np.fliplr(drawn["slanting"]), 0, 5)
    elif moment == "strike":
        trail[:, 12:] = 0
        trail[..., 3] //= 2
        _lay(picture, drawn["straight"], 9, 3)
    else:
        trail[..., 3] //= 4
        _lay(picture, drawn["slanting"], 11, 5)
    return _kept(np.rot90(picture, _QUARTER_TURNS[facing]))


@cache
def shadow_picture(width: int) -> np.ndarray:
    """Return the shadow, a flat ellipse, of something `width` art pixels wide."""
    height = max(width // 3, 3)
    y = (2 * np.arange(height) + 1 - height)[:, None] * width
    x = (2 * np.arange(width) + 1 - width)[None] * height
    picture = np.zeros((height, width, 4), np.uint8)
    picture[x * x + y * y <= (width * height) ** 2] = (*rgb(art.COLOURS["#"]), 80)
    return _kept(picture)


# --- Bars and text -------------------------------------------------------------------------------


@cache
def bar_picture(filled: int, width: int, colour: str, height: int = 1) -> np.ndarray:
    """Return a framed bar, of whose `width` art pixels the first `filled` are coloured."""
    picture = np.empty((height + 2, width + 2, 4), np.uint8)
    picture[...] = (*rgb(art.COLOURS["#"]), 255)
    picture[1:-1, 1:-1] = (*rgb("7a6070"), 255)
    picture[1:-1, 1 : 1 + filled] = (*rgb(colour), 255)
    return _kept(picture)


def text_picture(text: str, colour: str = WHITE) -> np.ndarray:
    """Return a line of text, 7 art pixels high, in capitals; what has no glyph is left blank."""
    glyphs, gap = _glyphs(colour), np.zeros((7, 1, 4), np.uint8)
    pieces = [piece for letter in text.upper() for piece in (glyphs.get(letter, gap.repeat(3, 1)), gap)]
    return np.concatenate(pieces or [gap], axis=1)


@cache
def _glyphs(colour: str) -> dict[str, np.ndarray]:
    return _read_sheets(art.FONT, {"#": colour})


# --- What can be done with pictures --------------------------------------------------------------


def blend(canvas: np.ndarray, picture: np.ndarray, left: int, top: int) -> None:
    """Paint a picture onto an RGB canvas, shape (height, width, 3); what lies outside is cut off."""
    first_row, first_column = max(-top, 0), max(-left, 0)
    last_row = min(picture.shape[0], canvas.shape[0] - top)
    last_column = min(picture.shape[1], canvas.shape[1] - left)
    if last_row <= first_row or last_column <= first_column:
        return
    piece = picture[first_row:last_row, first_column:last_column]
    under = canvas[top + first_row : top + last_row, left + first_column : left + last_column]
    opacity = piece[..., 3:].astype(np.uint16)
    under[...] = (under * (255 - opacity) + piece[..., :3] * opacity + 127) // 255


def enlarge(picture: np.ndarray, factor: int) -> np.ndarray:
    """Return a picture or a frame with every pixel a square of `factor`."""
    return picture if factor == 1 else picture.repeat(factor, 1).repeat(factor, 0)


def reduce(picture: np.ndarray, factor: int) -> np.ndarray:
    """Return a frame with every square of `factor` averaged to a pixel."""
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    whole = picture[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
    return (whole.sum(axis=(1, 3), dtype=np.uint32) // factor**2).astype(np.uint8)


def rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of six hexadecimal digits."""
    red, green, blue = bytes.fromhex(colour)
    return red, green, blue


def read_sheet(sheet: str, colours: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Return the pictures of a sheet of text by their names."""
    names, *rows = [line.split() for line in sheet.strip().splitlines()]
    columns = zip(*rows, strict=True)
    return {name: _read_grid(column, colours) for name, column in zip(names, columns, strict=True)}


def _read_sheets(sheets: Sequence[str], colours: Mapping[str, str]) -> dict[str, np.ndarray]:
    return {name: picture for sheet in sheets for name, picture in read_sheet(sheet, colours).items()}


def _read_grid(rows: Sequence[str], colours: Mapping[str, str]) -> np.ndarray:
    picture = np.zeros((len(rows), len(rows[0]), 4), np.uint8)
    for y, row in enumerate(rows):
        for x, letter in enumerate(row):
            if letter in colours:
                picture[y, x] = (*rgb(colours[letter]), 255)
    return picture


def _lay(picture: np.ndarray, other: np.ndarray, left: int, top: int) -> None:
    """Put the opaque part of another picture on top of a picture."""
    place = picture[top : top + other.shape[0], left : left + other.shape[1]]
    np.copyto(place, other, where=other[..., 3:] > 0)


def _flashed(picture: np.ndarray, colour: str) -> np.ndarray:
    """Return the picture with its inside two thirds of the way to a colour, or as it is."""
    if not colour:
        return picture
    flashed = picture.copy()
    inside = (picture[..., 3] > 0) & (picture[..., :3] != rgb(art.COLOURS["#"])).any(axis=-1)
    flashed[inside, :3] = (picture[inside, :3].astype(np.uint16) + 2 * np.array(rgb(colour))) // 3
    return flashed


def _kept(picture: np.ndarray) -> np.ndarray:
    """Return a picture that is safe to share: contiguous, and nobody can paint on it."""
    picture = np.ascontiguousarray(picture)
    picture.flags.writeable = False
    return picture


# --- The ground ----------------------------------------------------------------------------------

WATER, SNOW, GRASS, SAND, BRIDGE = range(5)

_SOFT = (WATER, SNOW, GRASS, SAND)
_ROUNDING = 6
_RAIL = 4


def paint_ground(ground: np.ndarray) -> np.ndarray:
    """Paint a map's ground, shape (16 rows, 16 columns, 3) uint8.

    Args:
        ground: (rows, columns) of indices into `GROUNDS`.
    """
    kinds = _soften(np.where(ground == BRIDGE, WATER, ground))
    image = _texture(ground.shape, WATER)
    for kind in (SNOW, GRASS, SAND):
        np.copyto(image, _texture(ground.shape, kind), where=(kinds == kind)[..., None])
    _paint_water(image, kinds)
    _paint_banks(image, kinds)
    for row, column in np.argwhere(ground == BRIDGE):
        _paint_bridge(image, ground, int(row), int(column))
    return image


def tile_hash(row: np.ndarray | int, column: np.ndarray | int, salt: int = 0) -> np.ndarray:
    """Return 32 well-mixed bits for every tile: what varies from tile to tile follows from them."""
    mixed = np.array(row, np.uint64) * np.uint64(0x9E3779B1) ^ np.array(column, np.uint64) * np.uint64(
        0x85EBCA77
    )
    for factor in (0xC2B2AE3D, 0x2C1B3C6D):
        mixed = (mixed + np.uint64(salt)) & np.uint64(0xFFFFFFFF)
        mixed = (mixed ^ (mixed >> np.uint64(15))) * np.uint64(factor)
    return (mixed >> np.uint64(16) & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _texture(shape: tuple[int, ...], kind: int) -> np.ndarray:
    """Return a whole map of one ground, each tile in the variant that its hash says."""
    rows, columns = shape
    drawn = _ground_pictures(kind)
    variants = np.concatenate([drawn, drawn[:, :, ::-1]])  # and each the other way round
    row, column = np.ogrid[:rows, :columns]
    mixed = tile_hash(row, column, kind)
    chosen = np.array(art.GROUND_WEIGHTS)[mixed % 8] % len(drawn) + mixed // 8 % 2 * len(drawn)
    tiles = variants[chosen]  # (rows, columns, 16, 16, 3)
    image = tiles.swapaxes(1, 2).reshape(rows * TILE, columns * TILE, 3)
    plain = (image == rgb(art.GROUND_COLOURS[GROUNDS[kind]]["."])).all(axis=-1)
    image[plain & (_wobble(shape, 10 + kind, 32) > 8)] = rgb(art.PATCHES[GROUNDS[kind]])
    return image


@cache
def _ground_pictures(kind: int) -> np.ndarray:
    """Return the variants of one ground, shape (variants, 16, 16, 3)."""
    sheet = {SNOW: art.SNOW, GRASS: art.GRASS, SAND: art.SAND}.get(kind, art.WATER_AND_BRIDGE)
    colours = art.GROUND_COLOURS[GROUNDS[kind]]
    drawn = {
        name: picture
        for name, picture in read_sheet(sheet, colours).items()
        if name.startswith(GROUNDS[kind])
    }
    return np.stack(list(drawn.values()))[..., :3]


def _soften(ground: np.ndarray) -> np.ndarray:
    """Return the ground of every art pixel, corners rounded and borders a little uneven.

    Each pixel takes the ground of which there is most in a small square around it, plus a smooth
    wobble; whole numbers throughout, so that every processor paints the same.
    """
    kinds = np.zeros((ground.shape[0] * TILE, ground.shape[1] * TILE), np.uint8)
    most = np.full(kinds.shape, -1000, np.int32)
    for kind in _SOFT:
        here = ground == kind
        if not here.any():
            continue
        share = _sum_around(here.repeat(TILE, 0).repeat(TILE, 1), _ROUNDING)
        share += np.where(share > 0, _wobble(ground.shape, kind), -1000)
        kinds[share > most] = kind
        np.maximum(most, share, out=most)
    return kinds


def _sum_around(pixels: np.ndarray, radius: int) -> np.ndarray:
    """Return the sum of the pixels in a square of 2 radius + 1 around each."""
    total = pixels.astype(np.int32)
    for axis in (0, 1):
        widths = [(radius + 1, radius) if other == axis else (0, 0) for other in (0, 1)]
        running = np.pad(total, widths, mode="edge").cumsum(axis=axis, dtype=np.int32)
        total = _window_sums(running, axis, 2 * radius + 1)
    return total


def _window_sums(running: np.ndarray, axis: int, length: int) -> np.ndarray:
    """Return sums over windows from running sums along an axis."""
    running = np.moveaxis(running, axis, 0)
    return np.moveaxis(running[length:] - running[:-length], 0, axis)


def _wobble(shape: tuple[int, ...], salt: int, step: int = 8) -> np.ndarray:
    """Return smooth noise from -36 to 36 over all art pixels, by lattice points `step` apart."""
    counts = [length * TILE // step + 2 for length in shape]
    row, column = np.ogrid[: counts[0], : counts[1]]
    noise = tile_hash(row, column, 100 + salt).astype(np.int32) % 73 - 36
    weight = np.arange(step, dtype=np.int32)
    for axis in (0, 1):
        noise = np.moveaxis(noise, axis, 0)
        low, high = noise[:-1].repeat(step, 0), noise[1:].repeat(step, 0)
        part = np.tile(weight, len(noise) - 1)[:, None]
        noise = np.moveaxis((low * (step - part) + high * part) // step, 0, axis)
    rounded = _sum_around(noise[: shape[0] * TILE, : shape[1] * TILE], step // 4)
    return rounded // (2 * (step // 4) + 1) ** 2


def _paint_water(image: np.ndarray, kinds: np.ndarray) -> None:
    """Lighten the shallows and draw foam along the shore."""
    water, land = kinds == WATER, kinds != WATER
    shape = (kinds.shape[0] // TILE, kinds.shape[1] // TILE)
    noise = _wobble(shape, 7)
    shallow = water & (_sum_around(land, 9) + noise > 50)
    image[shallow] = rgb(art.EDGES["water"][1])
    near = [_sum_around(land, radius) > 0 for radius in (1, 4, 5)]
    image[water & (near[0] | (near[2] & ~near[1] & (noise > 6)))] = rgb(art.EDGES["water"][0])


def _paint_banks(image: np.ndarray, kinds: np.ndarray) -> None:
    """Draw the rims where the land ends or turns, and the banks that face south."""
    water = np.pad(kinds == WATER, 4, mode="edge")
    height, width = kinds.shape

    def water_at(down: int, right: int = 0) -> np.ndarray:
        return water[4 + down : 4 + down + height, 4 + right : 4 + right + width]

    rim = water_at(0, -1) | water_at(0, 1) | water_at(-1)
    rim[1:] |= (kinds[1:] != kinds[:-1]) & (kinds[:-1] != WATER)
    upper, lower = water_at(3) | water_at(4), water_at(1) | water_at(2)
    for kind in (SNOW, GRASS, SAND):
        here = kinds == kind
        for where, colour in zip((rim, upper, lower), art.EDGES[GROUNDS[kind]], strict=True):
            image[here & where] = rgb(colour)


def _paint_bridge(image: np.ndarray, ground: np.ndarray, row: int, column: int) -> None:
    """Draw one tile of a bridge: planks across the way that it leads, rails over the water."""
    variants = _ground_pictures(BRIDGE)
    planks = variants[int(tile_hash(row, column)) % len(variants)]
    upright = _leads_down(ground, row, column)
    if not upright:
        image, ground, row, column = image.swapaxes(0, 1), ground.T, column, row
    top, left = row * TILE, column * TILE
    ends = [_ground_at(ground, row + way, column) not in (WATER, BRIDGE) for way in (-1, 1)]
    first, last = max(top - _RAIL * ends[0], 0), min(top + TILE + _RAIL * ends[1], image.shape[0])
    image[first:last, left : left + TILE] = planks[np.arange(first - top, last - top) % TILE]
    for way, edge in ((-1, left), (1, left + TILE - 2)):
        if _ground_at(ground, row, column + way) == WATER:
            for place, letter in ((edge, "-"), (edge + 1, "#")):
                image[first:last, place] = rgb(art.GROUND_COLOURS["bridge"][letter])


def _leads_down(ground: np.ndarray, row: int, column: int) -> bool:
    """Tell whether a bridge meets land both above and below."""
    for way in (-1, 1):
        here = row
        while _ground_at(ground, here, column) == BRIDGE:
            here += way
        if _ground_at(ground, here, column) == WATER:
            return False
    return True


def _ground_at(ground: np.ndarray, row: int, column: int) -> int:
    inside = 0 <= row < ground.shape[0] and 0 <= column < ground.shape[1]
    return int(ground[row, column]) if inside else WATER
