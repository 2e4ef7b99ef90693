"""Pictures of everything in the world, from the pixel art in the folder `art`.

A picture is a uint8 array of shape (height, width, 4): red, green, blue and opacity of art pixels. A tile is
16 of them wide. `ground.py` paints what they stand on, and `render.py` combines the pictures.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from PIL import Image

from pneuma.env.characters import FACINGS

ART = Path(__file__).parent / "art"
TILE = 16
"""Art pixels along a tile."""

POSES = ("stand", "stride", "strike")
SWINGS = 3
"""Moments of a sword's swing."""
FLICKERS = 4
"""Moments of a flame."""
OBSTACLES = ("pine", "tree", "rock", "cactus", "grave")
LETTERS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ/-:.+"

WHITE, RED, GOLD, BLUE, PLATE, OUTLINE = "fffaf0", "e8503f", "ffcf3f", "58a8ff", "2a1b33", "33203a"
STEEL = "e8f4ff"

_QUARTER_TURNS = {"up": 0, "left": 1, "down": 2, "right": 3}


# --- Who and what stands in the world ------------------------------------------------------------


def read_art(file_name: str) -> np.ndarray:
    """Return a sheet of pictures, (height, width, 4)."""
    return np.asarray(Image.open(ART / file_name).convert("RGBA"))


@cache
def player_picture(player_index: int, facing: str, pose: str, flash_colour: str = "") -> np.ndarray:
    """Return the picture of a player, from 0 to 7, in its own cloak and one of the `POSES`."""
    sheet = read_art("players.png")
    top = TILE * player_index
    left_side = TILE * (len(POSES) * FACINGS.index(facing) + POSES.index(pose))
    return _flashed(sheet[top : top + TILE, left_side : left_side + TILE], flash_colour)


@cache
def monster_picture(monster_name: str, pose: int, alert: bool = False, flash_colour: str = "") -> np.ndarray:
    """Return the picture of a monster in one of two poses; its eyes show if it has noticed a player.

    `art/monsters/NAME.png` holds both poses, calm above alert; others look like `stranger.png`.
    """
    if not (ART / "monsters" / f"{monster_name}.png").is_file():
        monster_name = "stranger"
    sheet = read_art(f"monsters/{monster_name}.png")
    height, width = sheet.shape[0] // 2, sheet.shape[1] // 2
    pictures = sheet[alert * height : (alert + 1) * height]
    return _flashed(pictures[:, pose * width : (pose + 1) * width], flash_colour)


@cache
def obstacle_picture(obstacle: str) -> np.ndarray:
    column = TILE * OBSTACLES.index(obstacle)
    return read_art("obstacles.png")[:, column : column + TILE]


@cache
def sword_picture(facing: str, moment: int) -> np.ndarray:
    """Return a sword at one of the `SWINGS`; its centre is the weapon's place."""
    upright = np.split(read_art("sword.png"), SWINGS, axis=1)[moment]
    return np.rot90(upright, _QUARTER_TURNS[facing])


@cache
def shadow_picture(width: int) -> np.ndarray:
    """Return the shadow, a flat ellipse, of a body `width` art pixels wide."""
    height = max(width // 3, 3)
    y = (2 * np.arange(height) + 1 - height)[:, None] * width
    x = (2 * np.arange(width) + 1 - width)[None] * height
    picture = np.zeros((height, width, 4), np.uint8)
    picture[x * x + y * y <= (width * height) ** 2] = _opaque(OUTLINE, 80)
    return picture


# --- What passes within a second ------------------------------------------------------------------


@cache
def slash_picture(width: int, height: int, facing: str, moment: int) -> np.ndarray:
    """Return the arc of a sword over the box that it strikes: pale all over, bright where the blade passes.

    The box, of so many art pixels, lies ahead of a player that faces one of `FACINGS`; `moment` counts from
    0 to `SWINGS` - 1.
    """
    turns = _QUARTER_TURNS[facing]
    box_rows, box_columns = height, width
    if turns % 2:
        box_rows, box_columns = width, height
    ahead = (2 * np.arange(box_rows) + 1)[::-1, None] / (2 * box_rows)  # 1 at the far end, 0 at the player
    aside = (2 * np.arange(box_columns) + 1)[None] / box_columns - 1
    distance = ahead**4 + aside**4
    inside = distance <= 1.05
    picture = np.zeros((box_rows, box_columns, 4), np.uint8)
    picture[inside] = _opaque(STEEL, 90)
    passed = inside & (aside <= 2 * (moment + 1) / SWINGS - 1) & (ahead > 0.25)
    picture[passed & (distance > 0.45)] = _opaque(STEEL, 170)
    picture[passed & (distance > 0.7)] = _opaque(WHITE, 240)
    return np.rot90(picture, turns)


@cache
def flame_picture(moment: int, height: int) -> np.ndarray:
    """Return a flame, flickering by moments; of its 13 rows only the lowest show as it goes out."""
    flames = np.split(read_art("flame.png"), FLICKERS, axis=1)
    return flames[moment % FLICKERS][-height:]


@cache
def plus_picture() -> np.ndarray:
    """Return the sign of healing."""
    return read_art("plus.png")


# --- Bars and text -------------------------------------------------------------------------------


def gauge_picture(points: float, full_points: float, colour: str, width: int, height: int = 1) -> np.ndarray:
    """Return a framed bar of the points that are left; it is empty only if there are none."""
    filled_width = min(round(width * float(points) / float(full_points)), width)
    if points > 0:
        filled_width = max(filled_width, 1)
    picture = np.empty((height + 2, width + 2, 4), np.uint8)
    picture[...] = _opaque(OUTLINE)
    picture[1:-1, 1:-1] = _opaque("7a6070")
    picture[1:-1, 1 : 1 + filled_width] = _opaque(colour)
    return picture


@cache
def badge_picture(text: str, colour: str) -> np.ndarray:
    """Return a line of text on a plate of a colour, 9 art pixels high."""
    letters = text_picture(text)
    height, width = letters.shape[:2]
    plate = Image.new("RGBA", (width + 3, height + 2), f"#{colour}")
    blend(plate, letters, 2, 1)
    return np.asarray(plate)


def text_picture(text: str) -> np.ndarray:
    """Return a line of text, 7 art pixels high, in capitals; characters without a glyph are blank."""
    letter_gap = np.zeros((7, 1, 4), np.uint8)
    pieces = []
    for letter in text.upper():
        pieces.append(_glyphs().get(letter, letter_gap.repeat(3, 1)))
        pieces.append(letter_gap)
    return np.concatenate(pieces or [letter_gap], axis=1)


@cache
def _glyphs() -> dict[str, np.ndarray]:
    glyphs = {}
    letter_pictures = np.split(read_art("font.png"), len(LETTERS), axis=1)
    for letter, letter_picture in zip(LETTERS, letter_pictures, strict=True):
        inked_columns = np.flatnonzero(letter_picture[..., 3].any(axis=0))
        glyphs[letter] = letter_picture[:, : inked_columns[-1] + 1]
    return glyphs


# --- What can be done with pictures --------------------------------------------------------------


def blend(canvas: Image.Image, picture: np.ndarray, left_edge: int, top_edge: int) -> None:
    """Paint a picture onto a canvas; parts outside are cut off."""
    picture_image = Image.fromarray(picture)
    canvas.paste(picture_image, (left_edge, top_edge), picture_image)


def rgb(colour: str) -> list[int]:
    return list(bytes.fromhex(colour))


def _opaque(colour: str, opacity: int = 255) -> list[int]:
    """Return a colour with its opacity."""
    return [*rgb(colour), opacity]


def _flashed(picture: np.ndarray, colour: str) -> np.ndarray:
    """Return the picture with its inside two thirds of the way to a colour, or unchanged."""
    if not colour:
        return picture
    flashed = picture.copy()
    is_inside = (picture[..., 3] > 0) & (picture[..., :3] != rgb(OUTLINE)).any(axis=-1)
    flashed[is_inside, :3] = (picture[is_inside, :3].astype(np.uint16) + 2 * np.array(rgb(colour))) // 3
    return flashed
