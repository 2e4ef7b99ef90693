"""What the rules measure, drawn over a frame: bodies, circles, the box that a sword strikes, and rays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from pneuma.env.layouts import player_features
from pneuma.env.rules import BLADE
from pneuma.env.worlds import Worlds

BODY, NOTICE, ATTACK, SWORD = "#ffffff", "#ffd23f", "#ff5a4d", "#46e0ff"
TERRAIN_RAY, PLAYER_RAY, MONSTER_RAY = "#5d647090", "#46e0ff", "#ff5a4d"
LINE = 2

Place = Callable[[float, float], tuple[float, float]]
"""From pixels of the world to pixels of the frame."""


def draw_overlay(frame: np.ndarray, worlds: Worlds, world: int, player: int, place: Place) -> np.ndarray:
    """Return a frame, (height, width, 3) uint8, with what is measured in a world drawn over it.

    Every living monster has its body, the circle in which it notices (yellow) and the one in which it bites
    (red): a player is inside once its body reaches into a circle. The player has its body, its sword's box,
    filled while it strikes, and its rays in the colour of what they meet: terrain, players or monsters.
    """
    image = Image.fromarray(frame)
    draw = ImageDraw.Draw(image, "RGBA")
    state, stats = worlds.players[world, player], worlds.weapon_stats(world)[player]
    if state["hp"] > 0:
        _draw_rays(draw, worlds, world, player, place)
        facing = state["facing"]
        strikes = state["busy"] > 0 and state["armed"] == BLADE
        _draw_box(
            draw,
            place,
            (state["x"] + stats["sword_x"][facing], state["y"] + stats["sword_y"][facing]),
            (stats["sword_half_width"][facing], stats["sword_half_height"][facing]),
            SWORD,
            fill=SWORD + "48" if strikes else None,
        )
    kinds = worlds.monster_stats[int(worlds.worlds["level"][world])]
    for body, row in (
        *zip(worlds.monsters[world], kinds, strict=True),
        *zip(worlds.players[world], worlds.player_stats, strict=True),
    ):
        if body["hp"] <= 0:
            continue
        middle = body["x"] + row["body_x"], body["y"] + row["body_y"]
        _draw_box(draw, place, middle, (row["half_width"], row["half_height"]), BODY)
    for monster, kind in zip(worlds.monsters[world], kinds, strict=True):
        for name, colour in (("notice", NOTICE), ("attack", ATTACK)):
            if monster["hp"] > 0:
                x, y = monster["x"] + kind[f"{name}_x"], monster["y"] + kind[f"{name}_y"]
                radius = float(np.sqrt(kind[f"{name}_squared"]))
                corners = place(x - radius, y - radius), place(x + radius, y + radius)
                draw.ellipse(corners, outline=colour, width=LINE)
    return np.asarray(image)


def _draw_box(
    draw: Any,
    place: Place,
    middle: tuple[float, float],
    half: tuple[float, float],
    colour: str,
    fill: str | None = None,
) -> None:
    corners = (
        place(middle[0] - half[0], middle[1] - half[1]),
        place(middle[0] + half[0], middle[1] + half[1]),
    )
    draw.rectangle(corners, outline=colour, width=LINE, fill=fill)


def _draw_rays(draw: Any, worlds: Worlds, world: int, player: int, place: Place) -> None:
    """Draw a player's rays as it observes them, from its place to what they meet."""
    settings, state = worlds.settings[0], worlds.players[world, player]
    rays, seen = int(settings["rays"]), worlds.observations[world, player]
    own = len(player_features(worlds.config))
    each = 3 + int(settings["sights"])  # a distance, then what: terrain, a player, or a kind of monster
    for ray, row in enumerate(seen[own : own + rays * each].reshape(rays, each)):
        distance = float(row[0] / settings["ray_scale"])
        end = (
            state["x"] + distance * settings["ray_x"][ray],
            state["y"] + distance * settings["ray_y"][ray],
        )
        colour = TERRAIN_RAY if row[1] else PLAYER_RAY if row[2] else MONSTER_RAY
        draw.line((place(state["x"], state["y"]), place(*end)), fill=colour, width=LINE)
        if colour != TERRAIN_RAY:
            x, y = place(*end)
            draw.ellipse((x - 4, y - 4, x + 4, y + 4), fill=colour)
