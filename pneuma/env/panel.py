"""The strip above a picture of the world: a player's HP and XP, and how far the world is."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from pneuma.env import rules, sprites
from pneuma.env.characters import TICKS_PER_STEP

if TYPE_CHECKING:
    from pneuma.env.worlds import Worlds

BAR_WIDTH, BAR_HEIGHT = 48, 3
GAP = 6  # art pixels between two things, and around all
LINE = 7
USUAL_WIDTH = 360
"""Of all things side by side, in art pixels; where there is less room they take several lines."""


class Panel:
    """Draws the strip of one width, which has the same height at any moment.

    Attributes:
        height: in pixels.
    """

    def __init__(self, worlds: Worlds, width: int) -> None:
        """Find out how many lines the most that there is to tell takes.

        Args:
            worlds: whose state to tell.
            width: of the strip in pixels.
        """
        self.worlds = worlds
        self._width = width
        self._factor = min(max(width // USUAL_WIDTH, 1), 3)
        digits = sprites.text_picture("00000")  # that step, XP and monsters may grow by
        full = [[*self._pieces(0, p, "TIME LIMIT"), digits] for p in range(worlds.players.shape[1])]
        self._lines = max(len(self._rows(pieces)) for pieces in full)
        self.height = (self._lines * (LINE + GAP) + GAP) * self._factor // 2 * 2  # videos want even sides

    def strip(self, world: int, player: int) -> np.ndarray:
        """Return the strip for a player of a world, (height, width, 3) uint8."""
        strip = np.empty((self.height, self._width, 3), np.uint8)
        strip[...] = sprites.rgb(sprites.PLATE)
        ended = self.worlds.worlds["ending"][world] != rules.RUNNING
        ending = self.worlds.ending(world).replace("-", " ") if ended else ""
        for line, row in enumerate(self._rows(self._pieces(world, player, ending))):
            left, top = GAP, GAP + line * (LINE + GAP)
            for picture in row:
                down = top + (LINE - picture.shape[0]) // 2
                large = sprites.enlarge(picture, self._factor)
                sprites.blend(strip, large, left * self._factor, down * self._factor)
                left += picture.shape[1] + GAP
        return strip

    def _pieces(self, world: int, player: int, ending: str) -> list[np.ndarray]:
        """Return the pictures of all that is told, one after the other."""
        worlds = self.worlds
        row, stats, state = worlds.players[world, player], worlds.player_stats[player], worlds.worlds[world]
        ticks = int(worlds.settings["ticks"][0])  # fewer while a step is shown in several frames
        filled = filled_part(row["hp"], stats["hp"], BAR_WIDTH)
        texts = [  # rounded up, so that only the dead have 0 HP
            f"HP {ceil(row['hp'])}/{ceil(stats['hp'])}",
            f"XP {ceil(row['xp'])}",
            f"STEP {int(state['steps']) * ticks // TICKS_PER_STEP}",
            f"MONSTERS {state['monsters_left']}/{worlds.monsters.shape[1]}",
        ]
        texts = [f"P{player + 1}"] * (worlds.players.shape[1] > 1) + texts + [ending] * bool(ending)
        bar = sprites.bar_picture(filled, BAR_WIDTH, sprites.GOLD, height=BAR_HEIGHT)
        return [bar, *(sprites.text_picture(text) for text in texts)]

    def _rows(self, pieces: list[np.ndarray]) -> list[list[np.ndarray]]:
        """Break what is told into lines that fit the width."""
        room = self._width // self._factor - GAP
        rows: list[list[np.ndarray]] = [[]]
        left = 0
        for piece in pieces:
            left += piece.shape[1] + GAP
            if left > room and rows[-1]:
                rows.append([])
                left = piece.shape[1] + GAP
            rows[-1].append(piece)
        return rows


def filled_part(hp: float, full: float, width: int) -> int:
    """Return how much of a bar is filled; somebody alive always has something."""
    return min(max(round(width * float(hp) / float(full)), int(hp > 0)), width)
