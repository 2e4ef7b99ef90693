"""Frames of the world: the whole map, or a window that follows a player; and a window to show them in.

A frame is drawn in art pixels, 16 a tile, over a background that is painted once, then enlarged by
a whole factor, and gets a panel of numbers. It is NumPy throughout and follows from the state
alone: the same state gives the same bytes. Only `Window` needs pygame-ce.
"""

from __future__ import annotations

import importlib
import os
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pneuma.env import rules, sprites
from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.level import LEVELS, Level
from pneuma.errors import UserError, unknown_name

if TYPE_CHECKING:
    from pneuma.env.worlds import Worlds

CAMERAS = ("map", "follow")
SEA = "3d83c9"

VIEW = (15 * sprites.TILE, 11 * sprites.TILE)
"""Width and height, in art pixels, of what the following camera shows."""

FOLLOW_FACTOR = 4
KEYS = {"up": "w", "down": "s", "left": "a", "right": "d", "space": "", "escape": ""}
"""The keys that a window tells of, and the letter, if any, that does the same."""

USUAL_TILE = 64.0
"""Side in pixels of the tiles for which the art is drawn: 4 pixels of the world an art pixel."""

MOST_TILES = 90_000
BAR_WIDTH, PANEL_WIDTH = 12, 110
STRIDE = 40.0  # pixels that a body walks between two poses: a player's way in one agent step
FLASH_TICKS = 12  # how long a bite shows


@dataclass(frozen=True)
class Item:
    """A picture and where it goes, in art pixels of the map; those with a lower foot go in front."""

    foot: float
    picture: np.ndarray
    left: int
    top: int


class Renderer:
    """Draws the worlds of a `Worlds` object as they are at the moment.

    Attributes:
        size: width and height of a frame.
        background: (height, width, 3) the bare ground of the whole map, in art pixels.
    """

    def __init__(
        self, worlds: Worlds, camera: str = "map", size: tuple[int, int] | None = None, panel: bool = True
    ) -> None:
        """Paint the background.

        Args:
            worlds: whose state to draw, now and later.
            camera: "map" for the whole level, "follow" for a window centred on a player.
            size: width and height of a frame; the picture is enlarged by the greatest whole factor
                that fits, and a map that is too large is reduced by the smallest.
            panel: whether to write HP, XP, step and monsters left into the upper left corner.

        Raises:
            UserError: for an unknown camera, a size without a single pixel, or a level too large.
        """
        if camera not in CAMERAS:
            raise unknown_name("camera", camera, CAMERAS)
        if size is not None and min(size) < 1:
            raise UserError(f"size = {size[0]} x {size[1]} is not allowed: both of at least 1")
        self.worlds = worlds
        self.camera = camera
        self.panel = panel
        level = worlds.level
        self._split = max(round(level.tile / USUAL_TILE), 1)  # large tiles are drawn as several
        self._zoom = max(round(USUAL_TILE / level.tile), 1)  # among small ones, bodies are drawn larger
        self._scale = sprites.TILE * self._split / level.tile
        self._scenes: dict[int, tuple[np.ndarray, tuple[Item, ...]]] = {}
        self.background, _ = self._scene(0)
        height, width = self.background.shape[:2]
        if camera == "map":
            self.size = size or (width, height)
        else:
            self.size = size or (VIEW[0] * FOLLOW_FACTOR, VIEW[1] * FOLLOW_FACTOR)

    def _scene(self, index: int) -> tuple[np.ndarray, tuple[Item, ...]]:
        """Return the bare ground of a level, painted at the first call, and its obstacles."""
        if index not in self._scenes:
            level = self.worlds.levels[index]
            ground = ground_kinds(level).repeat(self._split, 0).repeat(self._split, 1)
            if ground.size > MOST_TILES:
                raise UserError(
                    f"level {level.name}: too large to draw; at most {MOST_TILES:,} tiles of 64 px"
                )
            solid = (level.terrain == rules.SOLID).repeat(self._split, 0).repeat(self._split, 1)
            self._scenes[index] = sprites.paint_ground(ground), tuple(_obstacles(solid, ground))
        return self._scenes[index]

    def frame(self, world: int = 0, player: int = 0) -> np.ndarray:
        """Return the frame of one world, shape (height, width, 3) uint8.

        Args:
            world: which of the worlds.
            player: whom the camera follows and the panel speaks of.
        """
        self.background, self._obstacles = self._scene(int(self.worlds.worlds["level"][world]))
        frame = self._whole_map(world) if self.camera == "map" else self._follow(world, player)
        if self.panel:
            self._draw_panel(frame, world, player)
        return frame

    # --- Cameras ---------------------------------------------------------------------------------

    def _whole_map(self, world: int) -> np.ndarray:
        canvas = self.background.copy()
        self._draw(canvas, world, 0, 0)
        width, height = self.size
        factor = min(width // canvas.shape[1], height // canvas.shape[0])
        if factor == 0:
            canvas = sprites.reduce(canvas, max(-(-canvas.shape[1] // width), -(-canvas.shape[0] // height)))
        return _centre(sprites.enlarge(canvas, max(factor, 1)), self.size)

    def _follow(self, world: int, player: int) -> np.ndarray:
        width, height = self.size
        factor = max(min(width // VIEW[0], height // VIEW[1]) // self._zoom, 1)
        row = self.worlds.players[world, player]
        x, y = self._place(row["x"], row["y"])
        rows, columns = self.background.shape[:2]
        left, columns = _clamp(x, -(-width // factor), columns)
        top, rows = _clamp(y, -(-height // factor), rows)
        canvas = self.background[top : top + rows, left : left + columns].copy()
        self._draw(canvas, world, left, top)
        return _centre(sprites.enlarge(canvas, factor), self.size)

    def _place(self, x: float, y: float) -> tuple[int, int]:
        """Return the art pixel of a place in the world."""
        level = self.worlds.level
        return int((x - level.left) * self._scale // 1), int((y - level.top) * self._scale // 1)

    # --- What stands in the world ----------------------------------------------------------------

    def _draw(self, canvas: np.ndarray, world: int, left: int, top: int) -> None:
        """Draw everything that stands in a world onto a canvas whose corner is at (left, top)."""
        height, width = canvas.shape[:2]
        items = [*self._obstacles, *self._monsters(world), *self._players(world)]
        for item in sorted(items, key=lambda item: item.foot):
            across, down = item.left - left, item.top - top
            if -item.picture.shape[1] < across < width and -item.picture.shape[0] < down < height:
                sprites.blend(canvas, item.picture, across, down)
        for item in self._bars(world):
            sprites.blend(canvas, item.picture, item.left - left, item.top - top)

    def _monsters(self, world: int) -> Iterator[Item]:
        level = int(self.worlds.worlds["level"][world])
        kinds = self.worlds.levels[level].monsters
        for monster, stats, (kind, _, _) in zip(
            self.worlds.monsters[world], self.worlds.monster_stats[level], kinds, strict=True
        ):
            if monster["hp"] <= 0:
                continue
            flash = sprites.WHITE if monster["knocked"] // 8 % 2 else ""
            pose = int((monster["x"] + monster["y"]) // (STRIDE / 2)) % 2
            picture = sprites.monster_picture(kind, pose, bool(monster["noticed"]), flash)
            yield from self._standing(picture, monster, stats)

    def _players(self, world: int) -> Iterator[Item]:
        bitten = self._bitten(world)
        for index, (player, stats) in enumerate(
            zip(self.worlds.players[world], self.worlds.player_stats, strict=True)
        ):
            if player["hp"] <= 0:
                yield from self._standing(sprites.obstacle_picture("grave"), player, stats)
                continue
            flash = sprites.RED if bitten >> index & 1 else ""
            yield from self._standing(_player_picture(index, player, flash), player, stats)
            if player["busy"] > 0 and player["armed"]:
                yield self._sword(player, stats)

    def _bitten(self, world: int) -> int:
        """Return the bits of the players that some living monster has only just bitten."""
        level = int(self.worlds.worlds["level"][world])
        monsters, stats = self.worlds.monsters[world], self.worlds.monster_stats[level]
        fresh = monsters["bite"] > (stats["bite_ticks"] - FLASH_TICKS)[:, None]  # (M, players)
        fresh &= (monsters["bite"] > 0) & (monsters["hp"] > 0)[:, None]
        return sum(1 << int(index) for index in np.flatnonzero(fresh.any(axis=0)))

    def _standing(self, picture: np.ndarray, body: Any, stats: Any) -> Iterator[Item]:
        """Yield a picture with its feet at the lower edge of a body, and its shadow."""
        x, y = self._place(body["x"], body["y"] + stats["half_height"])
        picture = sprites.enlarge(picture, self._zoom)
        height, width = picture.shape[:2]
        shadow = sprites.shadow_picture(width - 2)
        yield Item(y - 0.5, shadow, x - (width - 2) // 2, y + 2 - shadow.shape[0])
        yield Item(y, picture, x - width // 2, y + 1 - height)

    def _sword(self, player: Any, stats: Any) -> Item:
        """Return a player's sword, centred where the rules have its box."""
        way, facing = player["facing"], sprites.FACINGS[player["facing"]]
        moment = sprites.SWINGS[int(3 * (stats["swing"] - player["busy"]) // stats["swing"])]
        picture = sprites.enlarge(sprites.sword_picture(facing, moment), self._zoom)
        x, y = self._place(player["x"] + stats["sword_x"][way], player["y"] + stats["sword_y"][way])
        _, foot = self._place(0.0, player["y"] + stats["half_height"])
        height, width = picture.shape[:2]
        return Item(foot + (-0.2 if facing == "up" else 0.2), picture, x - width // 2, y - height // 2)

    def _bars(self, world: int) -> Iterator[Item]:
        """Yield the HP bars of all who are hurt and alive, monsters first."""
        level = int(self.worlds.worlds["level"][world])
        groups = (
            (self.worlds.monsters, self.worlds.monster_stats[level], sprites.RED, 17),
            (self.worlds.players, self.worlds.player_stats, sprites.GOLD, 16),
        )
        for bodies, all_stats, colour, height in groups:
            for body, stats in zip(bodies[world], all_stats, strict=True):
                if 0 < body["hp"] < stats["hp"]:
                    bar = sprites.bar_picture(_filled(body["hp"], stats["hp"], BAR_WIDTH), BAR_WIDTH, colour)
                    bar = sprites.enlarge(bar, self._zoom)
                    x, y = self._place(body["x"], body["y"] + stats["half_height"])
                    yield Item(0.0, bar, x - bar.shape[1] // 2, y - (height + 3) * self._zoom)

    # --- The panel -------------------------------------------------------------------------------

    def _draw_panel(self, frame: np.ndarray, world: int, player: int) -> None:
        """Write a player's HP and XP and how far the world is into the upper left corner."""
        row, stats = self.worlds.players[world, player], self.worlds.player_stats[player]
        texts = [sprites.text_picture(line) for line in self._panel_lines(world, player)]
        width = max(PANEL_WIDTH, *(text.shape[1] for text in texts))
        filled = _filled(row["hp"], stats["hp"], width - 2)
        bar = sprites.bar_picture(filled, width - 2, sprites.GOLD, height=3)
        factor = max(frame.shape[0] // 320, 1)
        plate = sprites.enlarge(sprites.plate_picture([bar, *texts]), factor)
        sprites.blend(frame, plate, 4 * factor, 4 * factor)

    def _panel_lines(self, world: int, player: int) -> list[str]:
        worlds = self.worlds
        row, stats, state = worlds.players[world, player], worlds.player_stats[player], worlds.worlds[world]
        ticks = int(worlds.settings["ticks"][0])  # fewer while a step is shown in several frames
        name = f"P{player + 1}  " if worlds.players.shape[1] > 1 else ""
        lines = [  # rounded up, so that only the dead have 0 HP
            f"{name}HP {ceil(row['hp'])}/{ceil(stats['hp'])}  XP {ceil(row['xp'])}",
            f"STEP {int(state['steps']) * ticks // TICKS_PER_STEP}  "
            f"MONSTERS {state['monsters_left']}/{worlds.monsters.shape[1]}",
        ]
        if state["ending"] != rules.RUNNING:
            lines.append(worlds.ending(world).replace("-", " "))
        return lines


def ground_kinds(level: Level) -> np.ndarray:
    """Return what every tile of a level is made of, (rows, columns) of indices into `sprites.GROUNDS`.

    The level's `level.toml` may name the codes in its table `[ground]`; without, they are those of
    the shipped level. Any other code is grass, and where the land ends there is always water.
    """
    kinds = np.full(level.ground.shape, sprites.GRASS)
    for code, name in _ground_names(level.name).items():
        if name in sprites.GROUNDS:
            kinds[level.ground == code] = sprites.GROUNDS.index(name)
    return np.where(level.terrain == rules.COAST, sprites.WATER, kinds)


def _ground_names(name: str) -> dict[int, object]:
    """Return the names of a level's ground codes."""
    for folder in (LEVELS / name, Path(name)):
        header = folder / "level.toml"
        if header.is_file():
            names = tomllib.loads(header.read_text(encoding="utf-8-sig")).get("ground")
            if names:
                return {int(code): name for code, name in names.items()}
    return dict(enumerate(sprites.GROUNDS))


def _obstacles(solid: np.ndarray, ground: np.ndarray) -> Iterator[Item]:
    """Yield what stands in the way, by what it stands on."""
    kinds = {sprites.SNOW: ("pine",), sprites.GRASS: ("tree", "tree", "rock"), sprites.SAND: ("cactus",)}
    shadow = sprites.shadow_picture(14)
    for row, column in np.argwhere(solid).tolist():
        names = kinds.get(int(ground[row, column]), ("rock",))
        picture = sprites.obstacle_picture(names[int(sprites.tile_hash(row, column)) % len(names)])
        foot, left = (row + 1) * sprites.TILE - 2, column * sprites.TILE
        yield Item(foot - 0.5, shadow, left + 1, foot + 2 - shadow.shape[0])
        yield Item(foot, picture, left, foot + 1 - picture.shape[0])


def _player_picture(index: int, player: Any, flash: str) -> np.ndarray:
    """Return a player as they stand, walk or strike; which foot is in front follows from the place."""
    facing = sprites.FACINGS[player["facing"]]
    if player["busy"] > 0:
        return sprites.player_picture(index, facing, "strike", flash)
    phase = int((player["x"] + player["y"]) // STRIDE) % 2
    return sprites.player_picture(index, facing, "stride" if phase else "stand", flash)


def _filled(hp: float, full: float, width: int) -> int:
    """Return how much of a bar is filled; somebody alive always has something."""
    return min(max(round(width * float(hp) / float(full)), int(hp > 0)), width)


def _clamp(centre: int, length: int, available: int) -> tuple[int, int]:
    """Return start and length of a window around a centre that does not leave the map."""
    if length >= available:
        return 0, available
    return min(max(centre - length // 2, 0), available - length), length


def _centre(picture: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a picture cut, or surrounded by water, to a width and height."""
    width, height = size
    if picture.shape[:2] == (height, width):
        return picture
    frame = np.empty((height, width, 3), np.uint8)
    frame[...] = sprites.rgb(SEA)
    part = picture[:height, :width]
    top, left = (height - part.shape[0]) // 2, (width - part.shape[1]) // 2
    frame[top : top + part.shape[0], left : left + part.shape[1]] = part
    return frame


class Window:
    """A window on the screen that shows frames and tells which keys are held; needs pygame-ce.

    Attributes:
        closed: whether somebody has closed it.
    """

    def __init__(self, size: tuple[int, int], title: str) -> None:
        """Open a window for frames of this width and height.

        Raises:
            UserError: when pygame-ce is not installed, or there is no screen.
        """
        self._pygame = _load_pygame()
        try:
            self._pygame.display.init()
            self._screen = self._pygame.display.set_mode(size)
        except self._pygame.error as error:
            raise UserError(f"no window can be opened: {error}") from None
        self._pygame.display.set_caption(title)
        self._clock = self._pygame.time.Clock()
        self._names = _key_names(self._pygame)
        self._tapped: set[int] = set()
        self.closed = False

    def show(self, frame: np.ndarray, frames_per_second: float) -> None:
        """Show a frame, then wait for as long as the rate asks.

        Args:
            frame: (height, width, 3) uint8; one of another size than the window is stretched to it.
            frames_per_second: at most; 0 for no waiting.
        """
        self._tapped.clear()
        if not self._listen():
            return
        height, width = frame.shape[:2]
        image = self._pygame.image.frombuffer(np.ascontiguousarray(frame), (width, height), "RGB")
        if image.get_size() != self._screen.get_size():
            image = self._pygame.transform.scale(image, self._screen.get_size())
        self._screen.blit(image, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(frames_per_second)

    def keys(self) -> set[str]:
        """Return which of "up", "down", "left", "right", "space" and "escape" are held.

        A key that was only tapped since the last frame counts. W, A, S and D are arrows as well.
        """
        if not self._listen():
            return set()
        held = self._pygame.key.get_pressed()
        codes = {code for code in self._names if held[code] or code in self._tapped}
        return {self._names[code] for code in codes}

    def close(self) -> None:
        """Close the window; closing twice does no harm."""
        if not self.closed:
            self._pygame.display.quit()
        self.closed = True

    def _listen(self) -> bool:
        """Note what happened to the window and its keys since the last time; tell whether it is open."""
        for event in [] if self.closed else self._pygame.event.get():
            if event.type == self._pygame.KEYDOWN:
                self._tapped.add(event.key)
            elif event.type == self._pygame.QUIT:
                self.close()
        return not self.closed


def _key_names(pygame: Any) -> dict[int, str]:
    """Return our name of every key that pygame tells by a code."""
    names = {getattr(pygame, f"K_{name.upper()}"): name for name in KEYS}
    return names | {getattr(pygame, f"K_{letter}"): name for name, letter in KEYS.items() if letter}


def _load_pygame() -> Any:
    """Import pygame-ce, without its greeting on standard output."""
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        return importlib.import_module("pygame")
    except ImportError:
        raise UserError("a window needs pygame-ce: pip install 'pneuma[play]'") from None
