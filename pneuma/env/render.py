"""Frames of the world: the whole map, or a view that follows a player.

A picture is drawn in art pixels, 16 per tile, over a background that is painted once, and then enlarged by a
whole factor. A strip above it shows the world's name and progress, and the player's HP and XP; in teams each
player has a strip. The same state gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, inf
from typing import Any

import numpy as np
from PIL import Image

from pneuma.env import rules, sprites
from pneuma.env.characters import FACINGS, TICKS_PER_STEP
from pneuma.env.ground import land_and_shore, paint_ground, tile_hash, visible_ground
from pneuma.env.level import GRASS, SAND, SNOW, Rectangle
from pneuma.env.worlds import Worlds

CAMERAS = ("map", "follow")
SEA = "#3d83c9"

VIEW = (15 * sprites.TILE, 11 * sprites.TILE)
"""Width and height, in art pixels, of what the following camera shows."""

FOLLOW_FACTOR, GIF_FACTOR = 4, 2
MAP_SIDE = 900
"""Approximate pixels along the longer side of the whole map."""

BAR_WIDTH = 12
PANEL_BAR = (48, 3)
PANEL_GAP = 6
"""Gap between items in the strip, and around them, in art pixels."""
PANEL_LINE = 7
PANEL_WIDTH = 360
"""Pixels of a frame's width for each step that the strips are enlarged by."""
BADGES = {
    "pneuma/Pneuma-v0": ("text", "3668a0"),
    "pneuma/PneumaGodot-v0": ("godot", "2f7d5b"),
    "pneuma/PneumaArena-v0": ("arena", "a5432f"),
}
"""What names a world in the strip, and the colour of its plate."""
STRIDE = 40.0  # pixels between two poses: a player's distance in one agent step
FLASH_TICKS = 12  # how long a bite shows
PLUSES = ((-9, 0), (8, 3), (-1, 8))
"""Signs of healing: how far aside of a player and above it they begin, in art pixels."""
PLAYER_PLATE = "7a6070"
FLAME_GAP = 40.0
"""Pixels from one flame to the next."""


@dataclass(frozen=True)
class Item:
    """A picture and its place on the map, in art pixels; a lower foot is drawn in front."""

    foot: float
    picture: np.ndarray
    left: int
    top: int


class Renderer:
    """Draws the current state of the worlds in a `Worlds` object.

    Attributes:
        size: width and height of a frame, with the strips.
        background: (height, width, 3) the bare ground of the whole level, in art pixels.
        shown: the box of what the map shows of it: the land and two tiles around.
    """

    def __init__(
        self,
        worlds: Worlds,
        camera: str = "map",
        panel: bool = True,
        zoom: int = FOLLOW_FACTOR,
        env_id: str = "",
    ) -> None:
        """Paint the background.

        Args:
            worlds: what is drawn.
            camera: "map" shows the whole level, "follow" a view centred on a player.
            panel: whether strips above the picture show HP, XP, step and monsters left.
            zoom: pixels for each art pixel of the view centred on a player.
            env_id: the environment whose name the strip shows; empty for none.
        """
        self.worlds = worlds
        self.camera = camera
        self._badge = BADGES.get(env_id)
        self._scenes: dict[int, tuple[np.ndarray, tuple[Item, ...]]] = {}
        self.background, self._obstacles = self._scene(0)
        self.shown = land_and_shore(worlds.levels)
        if camera == "follow":
            self._factor = zoom
            width, height = VIEW
        else:
            width, height = int(self.shown.width), int(self.shown.height)
            self._factor = max(round(MAP_SIDE / max(height, width)), 1)
        self._size = width * self._factor, height * self._factor
        self._panel_factor = min(max(self._size[0] // PANEL_WIDTH, 1), 3)
        self._panel = 0
        if panel:
            strips = len(self._strip_pieces(0, 0))
            panel_height = PANEL_GAP + strips * (PANEL_LINE + PANEL_GAP)
            self._panel = panel_height * self._panel_factor // 2 * 2  # even, as videos need it
        self.size = self._size[0], self._size[1] + self._panel

    @property
    def extent(self) -> Rectangle:
        """The box of what the map shows, in pixels of the world."""
        level = self.worlds.level
        scale = level.tile / sprites.TILE
        return Rectangle(
            left=level.left + scale * self.shown.left,
            top=level.top + scale * self.shown.top,
            right=level.left + scale * self.shown.right,
            bottom=level.top + scale * self.shown.bottom,
        )

    def _scene(self, level_index: int) -> tuple[np.ndarray, tuple[Item, ...]]:
        """Return the bare ground of a level, painted at the first call, and its obstacles."""
        if level_index not in self._scenes:
            level = self.worlds.levels[level_index]
            ground = visible_ground(level)
            obstacles = tuple(_obstacles(level.terrain == rules.SOLID, ground))
            self._scenes[level_index] = paint_ground(ground), obstacles
        return self._scenes[level_index]

    def frame(self, world_index: int = 0, player_index: int = 0) -> np.ndarray:
        """Return the frame of one world, (height, width, 3) uint8, with one of its players in view."""
        self.background, self._obstacles = self._scene(int(self.worlds.worlds["level"][world_index]))
        corner_x, corner_y = self._corner(world_index, player_index)
        width, height = self._size[0] // self._factor, self._size[1] // self._factor
        canvas = Image.new("RGB", (width, height), SEA)
        canvas.paste(Image.fromarray(self.background), (-corner_x, -corner_y))
        items = list(self._obstacles)
        items += self._monsters(world_index)
        items += self._bars(world_index)
        items += self._players(world_index)
        for item in sorted(items, key=lambda item: item.foot):
            sprites.blend(canvas, item.picture, item.left - corner_x, item.top - corner_y)
        frame = np.array(canvas.resize(self._size, Image.Resampling.NEAREST))
        if self._panel:
            return np.concatenate([self._strips(world_index, player_index), frame])
        return frame

    # --- Cameras ---------------------------------------------------------------------------------

    def _corner(self, world_index: int, player_index: int) -> tuple[int, int]:
        """Return left and top of what the camera shows of the level, in art pixels."""
        if self.camera == "map":
            return int(self.shown.left), int(self.shown.top)
        position = self.worlds.players[world_index, player_index]
        x, y = self._place(position["x"], position["y"])
        rows, columns = self.background.shape[:2]
        return _clamp(x, VIEW[0], columns), _clamp(y, VIEW[1], rows)

    def _place(self, x: float, y: float) -> tuple[int, int]:
        """Return the art pixel of a place in the world."""
        level = self.worlds.level
        scale = sprites.TILE / level.tile
        return int((x - level.left) * scale // 1), int((y - level.top) * scale // 1)

    # --- What stands in the world ----------------------------------------------------------------

    def _level_stats(self, world_index: int) -> np.ndarray:
        """Return the stats of a world's monsters."""
        return self.worlds.monster_stats[self.worlds.worlds["level"][world_index]]

    def _monsters(self, world_index: int) -> Iterator[Item]:
        monsters = self.worlds.monsters[world_index]
        level_stats = self._level_stats(world_index)
        monster_places = self.worlds.levels[self.worlds.worlds["level"][world_index]].monsters
        for monster, monster_stats, origin in zip(monsters, level_stats, monster_places, strict=True):
            if monster["hp"] <= 0:
                continue
            flash_colour = ""
            if monster["knocked"] // 8 % 2:
                flash_colour = sprites.WHITE
            pose = int((monster["x"] + monster["y"]) // (STRIDE / 2)) % 2
            picture = sprites.monster_picture(origin.name, pose, bool(monster["noticed"]), flash_colour)
            yield from self._standing(picture, monster, monster_stats)

    def _players(self, world_index: int) -> Iterator[Item]:
        bitten = self._bitten(world_index)
        for player_index, player in enumerate(self.worlds.players[world_index]):
            player_stats = self.worlds.player_stats[player_index]
            if player["hp"] <= 0:
                yield from self._standing(sprites.obstacle_picture("grave"), player, player_stats)
                continue
            flash_colour = ""
            if bitten[player_index]:
                flash_colour = sprites.RED
            pose = "stand"
            if player["busy"] > 0:
                pose = "strike"
            elif int((player["x"] + player["y"]) // STRIDE) % 2:  # which foot is in front
                pose = "stride"
            picture = sprites.player_picture(player_index, FACINGS[player["facing"]], pose, flash_colour)
            yield from self._standing(picture, player, player_stats)
            if player["busy"] == 0:
                continue
            if player["action_kind"] == rules.BLADE:
                yield from self._blow(player, player_stats)
            elif player["action_kind"] == rules.BURNING:
                yield from self._flames(player, player_stats)
            elif player["action_kind"] == rules.HEALING:
                yield from self._pluses(player, player_stats)

    def _bitten(self, world_index: int) -> np.ndarray:
        """Return which players were bitten a moment ago, (P,)."""
        monsters = self.worlds.monsters[world_index]
        is_living = (monsters["hp"] > 0)[:, None]
        fresh_ticks = (self._level_stats(world_index)["bite_ticks"] - FLASH_TICKS)[:, None]
        is_fresh = (monsters["bite"] > 0) & (monsters["bite"] > fresh_ticks) & is_living  # (M, players)
        return np.asarray(is_fresh.any(axis=0))

    def _standing(self, picture: np.ndarray, body: Any, stats: Any) -> Iterator[Item]:
        return _upright(picture, *self._place(body["x"], _foot(body, stats)))

    def _blow(self, player: Any, player_stats: Any) -> Iterator[Item]:
        """Yield a sword, and the arc over the box that it strikes."""
        facing, strike = player["facing"], player_stats["sword"]
        moment = int(sprites.SWINGS * (player_stats["swing"] - player["busy"]) // player_stats["swing"])
        x, y = player["x"] + strike["x"][facing], player["y"] + strike["y"][facing]
        half_width, half_height = strike["half_width"][facing], strike["half_height"][facing]
        left_edge, top_edge = self._place(x - half_width, y - half_height)
        right_edge, bottom_edge = self._place(x + half_width, y + half_height)
        arc = sprites.slash_picture(
            right_edge - left_edge + 1, bottom_edge - top_edge + 1, FACINGS[facing], moment
        )
        _, foot = self._place(0.0, _foot(player, player_stats))
        yield Item(max(foot, bottom_edge) + 0.1, arc, left_edge, top_edge)
        sword_foot = foot + 0.2
        if FACINGS[facing] == "up":
            sword_foot = foot - 0.2
        sword = sprites.sword_picture(FACINGS[facing], moment)
        hilt = self._place(player["x"] + strike["hilt_x"][facing], player["y"] + strike["hilt_y"][facing])
        yield _centred(sword_foot, sword, *hilt)

    def _flames(self, player: Any, player_stats: Any) -> Iterator[Item]:
        """Yield flames all over the box that burns, which die down in the last third."""
        facing, ticks = player["facing"], int(player_stats["flame_ticks"])
        age = ticks - int(player["busy"])
        flame_rows = min(3 * int(player["busy"]), ticks) * 13 // ticks
        strike = player_stats["flame"]
        width, height = 2 * strike["half_width"][facing], 2 * strike["half_height"][facing]
        columns = max(round(width / FLAME_GAP), 1)
        rows = max(round(height / FLAME_GAP), 1)
        for flame_row, flame_column in np.ndindex(rows, columns):
            x, y = self._place(
                player["x"] + strike["x"][facing] + width * ((flame_column + 0.5) / columns - 0.5),
                player["y"] + strike["y"][facing] + height * ((flame_row + 1) / rows - 0.5),
            )
            picture = sprites.flame_picture(age // 4 + flame_row + flame_column, max(flame_rows, 3))
            yield _above(y, picture, x, y)

    def _pluses(self, player: Any, player_stats: Any) -> Iterator[Item]:
        """Yield signs of healing, which rise over everything."""
        x, y = self._place(player["x"], player["y"])
        age = int(player_stats["heal_ticks"] - player["busy"])
        for across, rise in PLUSES:
            yield _centred(inf, sprites.plus_picture(), x + across, y - rise - age // 3)

    def _bars(self, world_index: int) -> Iterator[Item]:
        groups = (
            (self.worlds.monsters[world_index], self._level_stats(world_index), sprites.RED, 20),
            (self.worlds.players[world_index], self.worlds.player_stats, sprites.GOLD, 19),
        )
        for bodies, stats_by_body, colour, height in groups:
            for body, stats in zip(bodies, stats_by_body, strict=True):
                if 0 < body["hp"] < stats["hp"]:
                    bar = sprites.gauge_picture(body["hp"], stats["hp"], colour, BAR_WIDTH)
                    x, y = self._place(body["x"], _foot(body, stats))
                    yield Item(inf, bar, x - bar.shape[1] // 2, y - height)

    # --- The strips above ------------------------------------------------------------------------

    def _strips(self, world_index: int, player_index: int) -> np.ndarray:
        """Return the strips above a frame, one below the other."""
        strips = Image.new("RGB", (self._size[0], self._panel), f"#{sprites.PLATE}")
        factor = self._panel_factor
        line_top = PANEL_GAP
        for pieces in self._strip_pieces(world_index, player_index):
            column = PANEL_GAP
            for picture in pieces:
                height, width = picture.shape[:2]
                picture_top = line_top + (PANEL_LINE - height) // 2
                enlarged = picture.repeat(factor, 1).repeat(factor, 0)
                sprites.blend(strips, enlarged, column * factor, picture_top * factor)
                column += width + PANEL_GAP
            line_top += PANEL_LINE + PANEL_GAP
        return np.asarray(strips)

    def _strip_pieces(self, world_index: int, player_index: int) -> list[list[np.ndarray]]:
        """Return pictures for each strip: of the world and its player; in teams of the world, and of each."""
        badges = []
        if self._badge:
            badges.append(sprites.badge_picture(*self._badge))
        players = self.worlds.players.shape[1]
        if players == 1:
            return [badges + self._player_pieces(world_index, 0) + self._world_pieces(world_index)]
        strips = [badges + self._world_pieces(world_index)]
        for strip_player in range(players):
            plate = sprites.PLATE
            if strip_player == player_index:
                plate = PLAYER_PLATE
            player_badge = sprites.badge_picture(f"P{strip_player + 1}", plate)
            strips.append([player_badge] + self._player_pieces(world_index, strip_player))
        return strips

    def _player_pieces(self, world_index: int, player_index: int) -> list[np.ndarray]:
        """Return bars and numbers of a player; rounded up, so that only the dead have 0 HP."""
        player = self.worlds.players[world_index, player_index]
        player_stats = self.worlds.player_stats[player_index]
        hp, max_hp = player["hp"], player_stats["hp"]
        pictures = [
            sprites.gauge_picture(hp, max_hp, sprites.GOLD, *PANEL_BAR),
            sprites.text_picture(f"HP {ceil(hp)}/{ceil(max_hp)}"),
        ]
        if self.worlds.config.magic:
            energy, max_energy = player["energy"], player_stats["energy"]
            pictures.append(sprites.gauge_picture(energy, max(max_energy, 1.0), sprites.BLUE, *PANEL_BAR))
            pictures.append(sprites.text_picture(f"EN {int(energy)}/{ceil(max_energy)}"))
        pictures.append(sprites.text_picture(f"XP {ceil(player['xp'])}"))
        return pictures

    def _world_pieces(self, world_index: int) -> list[np.ndarray]:
        """Return the step, the monsters that are left, and how the episode has ended."""
        worlds, world_row = self.worlds, self.worlds.worlds[world_index]
        ticks = int(worlds.settings["ticks"][0])  # fewer while a step is shown in several frames
        strip_texts = [
            f"STEP {int(world_row['steps']) * ticks // TICKS_PER_STEP}",
            f"MONSTERS {world_row['monsters_left']}/{worlds.monsters.shape[1]}",
        ]
        if world_row["ending"] != rules.RUNNING:
            strip_texts.append(worlds.ending(world_index).replace("-", " "))
        return [sprites.text_picture(strip_text) for strip_text in strip_texts]


def _foot(body: Any, stats: Any) -> float:
    return float(body["y"] + stats["body_y"] + stats["half_height"])


def _above(foot: float, picture: np.ndarray, x: int, y: int) -> Item:
    return Item(foot, picture, x - picture.shape[1] // 2, y - picture.shape[0])


def _centred(foot: float, picture: np.ndarray, x: int, y: int) -> Item:
    return Item(foot, picture, x - picture.shape[1] // 2, y - picture.shape[0] // 2)


def _upright(picture: np.ndarray, x: int, foot: int) -> Iterator[Item]:
    yield _above(foot - 0.5, sprites.shadow_picture(picture.shape[1] - 2), x, foot + 2)
    yield _above(foot, picture, x, foot + 1)


def _obstacles(solid: np.ndarray, ground: np.ndarray) -> Iterator[Item]:
    names_by_ground = {SNOW: ("pine",), GRASS: ("tree", "tree", "rock"), SAND: ("cactus",)}
    for tile_row, tile_column in np.argwhere(solid).tolist():
        names = names_by_ground.get(int(ground[tile_row, tile_column]), ("rock",))
        picture = sprites.obstacle_picture(names[int(tile_hash(tile_row, tile_column)) % len(names)])
        middle = tile_column * sprites.TILE + sprites.TILE // 2
        foot = (tile_row + 1) * sprites.TILE - 2
        yield from _upright(picture, middle, foot)


def _clamp(centre: int, length: int, available: int) -> int:
    """Return the start of a window around a centre, moved to stay within the map if that is larger."""
    if length >= available:
        return (available - length) // 2
    return min(max(centre - length // 2, 0), available - length)
