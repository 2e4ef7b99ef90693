"""What a player perceives: layouts, bounds and scales of an observation.

Three layouts, each a few numbers about the player, then a row for each monster perceived:

    thesis  x, y, HP, XP                      distance, direction x, direction y, HP
    pygame  x, y, facing x, facing y, HP,     distance, direction x, direction y, HP, XP it is worth
            energy
    godot   x, y, HP, XP                      x, y, HP, direction x, direction y (monster to player)

With `observe_facing` four numbers follow on those about the player: 1 for the way faced, else 0.

With `perceive = "rays:N"` there is a row for each of N rays instead of one for each monster: how far off
the first thing is that it meets, then 1 for what that is, else 0: terrain, another player, or a monster
of one of the level's kinds, by name. Rays begin at the player's place, the first to the right, the others
clockwise. They end at living bodies, and at terrain that stops or drowns players.

`perceive` says which monsters, `order` how they are ordered (nearest first, the dead left out and the
rest zeros; or fixed, a dead one's row zeros but in layout godot), `scale` the units:

    unit    x and y from -1 to 1 over the land, HP, energy and XP as shares, distances in the
            monster's notice radii, along rays in the largest one: what matters is of order one
    map     x, y and distances over the map's size, the rest as shares
    raw     pixels and points

The map is the whole grid of tiles. So is the land of random levels: each sees the same place as the
same numbers, whichever are played together.

`pneuma/Pneuma-v0` has layout thesis, all monsters, nearest first, unit scale: the quantities of the
thesis's section 5.1. A layout's own choices are in `pneuma.env_fields.OBSERVATION_FIELDS`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from pneuma.env import rules
from pneuma.env.characters import FACINGS
from pneuma.env.level import RANDOM, Level
from pneuma.env.state import Array, State, kernel, merged, part
from pneuma.env_fields import EnvConfig
from pneuma.errors import UserError, unknown_name

LAYOUT_THESIS, LAYOUT_PYGAME, LAYOUT_GODOT = 0, 1, 2
LAYOUTS = {"thesis": LAYOUT_THESIS, "pygame": LAYOUT_PYGAME, "godot": LAYOUT_GODOT}
PLAYER_FEATURES = {
    "thesis": ("x", "y", "hp", "xp"),
    "pygame": ("x", "y", "facing_x", "facing_y", "hp", "energy"),
    "godot": ("x", "y", "hp", "xp"),
}
MONSTER_FEATURES = {
    "thesis": ("distance", "direction_x", "direction_y", "hp"),
    "pygame": ("distance", "direction_x", "direction_y", "hp", "xp"),
    "godot": ("x", "y", "hp", "direction_x", "direction_y"),
}
FACING_FEATURES = tuple(f"faces_{name}" for name in FACINGS)
MOST_XP = 1e9
"""Bound of XP, in points, that is kept through episodes."""


def player_features(config: EnvConfig) -> tuple[str, ...]:
    """Return the names of the numbers that a player observes of itself, in order."""
    return PLAYER_FEATURES[config.observation] + (FACING_FEATURES if config.observe_facing else ())


def perceived_kinds(config: EnvConfig, levels: list[Level]) -> tuple[list[bool], int]:
    """Return whether each monster is perceived, and the most rows in an observation.

    Raises:
        UserError: for a kind of monster that is not in the level.
    """
    kinds = [kind for kind, _, _ in levels[0].monsters]
    what, _, which = config.perceive.partition(":")
    if what == "rays":
        return [True] * len(kinds), 0
    if what == "kind":
        wanted = which.split(",")
        for name in wanted:
            if name not in kinds:
                raise unknown_name("kind of monster on this level", name, sorted(set(kinds)))
        if any([kind for kind, _, _ in level.monsters] != kinds for level in levels):
            raise UserError("perceive = kind:… needs levels with the same monsters")
        perceived = [kind in wanted for kind in kinds]
        return perceived, sum(perceived)
    most = int(which) if what == "nearest" else len(kinds)
    return [True] * len(kinds), min(most, len(kinds))


def fill_scales(
    settings: Any, players: np.ndarray, monsters: np.ndarray, config: EnvConfig, levels: list[Level]
) -> None:
    """Write layout and scales into rows of `state.SETTINGS`, `PLAYER_STATS` and `MONSTER_STATS`."""
    perceived, rows = perceived_kinds(config, levels)
    settings["layout"] = LAYOUTS[config.observation]
    settings["observe_facing"] = config.observe_facing
    settings["fixed_order"] = config.order == "fixed"
    settings["perceived"] = rows
    monsters["perceived"] = perceived
    raw = config.scale == "raw"
    if config.scale == "unit":
        left, top, right, bottom = _land(levels)
        settings["middle_x"], settings["middle_y"] = (left + right) / 2, (top + bottom) / 2
        settings["scale_x"], settings["scale_y"] = 2 / (right - left), 2 / (bottom - top)
        monsters["distance_scale"] = 1 / np.sqrt(np.maximum(monsters["notice_squared"], 1.0))
    elif config.scale == "map":
        left, top, right, bottom = levels[0].grid
        settings["middle_x"], settings["middle_y"] = left, top
        settings["scale_x"], settings["scale_y"] = 1 / (right - left), 1 / (bottom - top)
        monsters["distance_scale"] = 1 / max(right - left, bottom - top)
    else:
        settings["scale_x"] = settings["scale_y"] = monsters["distance_scale"] = 1.0
    _fill_rays(settings, monsters, config, levels)
    settings["xp_scale"] = 1.0 if raw else 1 / max(monsters["xp"].sum(axis=-1).max(initial=0.0), 1.0)
    players["hp_scale"] = 1.0 if raw else 1 / players["hp"]
    players["energy_scale"] = 1.0 if raw else 1 / np.maximum(players["energy"], 1.0)
    monsters["hp_scale"] = 1.0 if raw else 1 / monsters["hp"]
    monsters["xp_scale"] = 1.0 if raw else 1 / max(monsters["xp"].max(initial=0.0), 1.0)


def _fill_rays(settings: Any, monsters: np.ndarray, config: EnvConfig, levels: list[Level]) -> None:
    """Write the number and directions of rays, and the kinds of monsters they distinguish."""
    what, _, count = config.perceive.partition(":")
    settings["rays"] = rays = int(count) if what == "rays" else 0
    sights = sorted({kind for level in levels for kind, _, _ in level.monsters})
    settings["sights"] = len(sights)
    for monster, level in zip(monsters, levels, strict=True):
        monster["sight"] = [sights.index(kind) for kind, _, _ in level.monsters]
    left, top, right, bottom = levels[0].grid
    without_monsters = 1.0 if config.scale == "raw" else 1 / max(right - left, bottom - top)  # as `map`
    settings["ray_scale"] = monsters["distance_scale"].min() if monsters.size else without_monsters
    angles = 2 * np.pi * np.arange(rays) / max(rays, 1)
    settings["ray_x"][:rays] = np.round(np.cos(angles), 12)  # rounding makes them equal on all machines
    settings["ray_y"][:rays] = np.round(np.sin(angles), 12)


def observation_space(
    settings: Any, player: Any, monsters: np.ndarray, config: EnvConfig, levels: list[Level]
) -> spaces.Box:
    """Return the Box, with finite bounds, of a player's observations, float32."""
    edges = levels[0].grid
    beyond = config.coast == "deadly"  # players die a little way out
    left, top, right, bottom = edges if beyond else _land(levels)
    diagonal = float(np.hypot(edges[2] - edges[0], edges[3] - edges[1]))
    forever = config.xp_scope == "forever"
    worth = float(monsters["xp"].sum(axis=-1).max(initial=0.0)) + 1.0
    xp = (MOST_XP if forever else worth) * settings["xp_scale"]
    bounds = {
        "x": _scaled(settings, "x", left, right),
        "y": _scaled(settings, "y", top, bottom),
        "hp": (0.0, most_hp(player, monsters, config) * player["hp_scale"]),
        "energy": (0.0, player["energy"] * player["energy_scale"]),
        "xp": (-xp if forever else -config.ending_cost * settings["xp_scale"], xp),
        "facing_x": (-1.0, 1.0),
        "facing_y": (-1.0, 1.0),
        **dict.fromkeys(FACING_FEATURES, (0.0, 1.0)),
    }
    seen = bounds | {
        "distance": (0.0, diagonal * monsters["distance_scale"].max(initial=0.0)),
        "hp": (0.0, (monsters["hp"] * monsters["hp_scale"]).max(initial=0.0)),
        "xp": (0.0, (monsters["xp"] * monsters["xp_scale"]).max(initial=0.0)),
        "direction_x": (-1.0, 1.0),
        "direction_y": (-1.0, 1.0),
    }
    if config.terrain_stops == "players":  # monsters follow out over the sea
        seen["x"] = _scaled(settings, "x", edges[0], edges[2])
        seen["y"] = _scaled(settings, "y", edges[1], edges[3])
    row = [seen[name] for name in MONSTER_FEATURES[config.observation]]
    ray = [(0.0, diagonal * settings["ray_scale"])] + [(0.0, 1.0)] * (2 + int(settings["sights"]))
    limits = np.array(
        [bounds[name] for name in player_features(config)]
        + row * int(settings["perceived"])
        + ray * int(settings["rays"])
    )
    low, high = np.minimum(limits[:, 0], 0.0), np.maximum(limits[:, 1], 0.0)  # idle slots see zeros
    high = np.where(low == high, low + 1.0, high)  # such as nobody's energy: a space has some room
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _scaled(settings: Any, axis: str, *places: float) -> tuple[float, ...]:
    return tuple((place - settings[f"middle_{axis}"]) * settings[f"scale_{axis}"] for place in places)


def most_hp(player: Any, monsters: np.ndarray, config: EnvConfig) -> float:
    """Return the HP of a player who kills every monster and is never hurt."""
    healed = 0.0 if config.healing_cap else monsters["heal"].sum(axis=-1).max(initial=0.0)
    return float(player["hp"] + healed)


def _land(levels: list[Level]) -> tuple[float, float, float, float]:
    """Return the box of the land: left, top, right, bottom; for random levels, the whole grid."""
    level = levels[0]  # several are random
    return level.grid if level.name.startswith(RANDOM) else level.land


# --- Writing an observation (compiled) -------------------------------------------------------------


@merged
def observe_player(s: State, w: int, p: int, tell: bool) -> None:
    """Write a player's observation and action mask; the layouts are above.

    `tell` says whether to write the nearest monster's distance to the events, which an ended world does not
    do.
    """
    count = _order_monsters(s, w, p, tell)
    out = s.observations[w, p]
    at = _write_player(s, w, p, out)
    for i in range(count):
        at = _write_monster(s, w, p, i, out, at)
    if s.settings[0].rays > 0:
        at = _write_rays(s, w, p, out, at)
    for rest in range(at, len(out)):
        out[rest] = 0.0
    _mask_actions(s, w, p)


@part
def _order_monsters(s: State, w: int, p: int, tell: bool) -> int:
    """List in `scratch` the monsters that a player perceives, with distances; return their number.

    The nearest come first, ties by index, without the dead. In fixed order the same monsters are listed by
    index, and the dead fill the remaining rows, infinitely far away.
    """
    player = s.players[w, p]
    level = s.worlds[w].level
    fixed = s.settings[0].fixed_order
    nearest = math.inf
    count: Any = np.int64(0)
    for m in range(s.monsters.shape[1]):
        monster = s.monsters[w, m]
        length = math.inf
        if monster.hp > 0.0:
            x = monster.x - player.x
            y = monster.y - player.y
            length = math.sqrt(x * x + y * y)
            nearest = min(nearest, length)
        if s.monster_stats[level, m].perceived and (fixed or length < math.inf):
            _insert(s.scratch, count, m, length)
            count += 1
    if tell:
        s.events[w, p].distance = nearest
    count = min(count, s.settings[0].perceived)
    if fixed:
        _sort_by_index(s.scratch, count)
    return count


@part
def _insert(scratch: Array, count: int, order: int, distance: float) -> None:
    """Insert into the first `count` of `scratch`, nearest first, behind equals.

    An insertion sort: for 14 items it is several times faster than numpy.argsort.
    """
    i = count
    while i > 0 and scratch[i - 1].distance > distance:
        scratch[i].order = scratch[i - 1].order
        scratch[i].distance = scratch[i - 1].distance
        i -= 1
    scratch[i].order = order
    scratch[i].distance = distance


@part
def _sort_by_index(scratch: Array, count: int) -> None:
    """Sort the first `count` of `scratch` by index."""
    for last in range(1, count):
        order = scratch[last].order
        distance = scratch[last].distance
        i = last
        while i > 0 and scratch[i - 1].order > order:
            scratch[i].order = scratch[i - 1].order
            scratch[i].distance = scratch[i - 1].distance
            i -= 1
        scratch[i].order = order
        scratch[i].distance = distance


@part
def _write_player(s: State, w: int, p: int, out: Array) -> int:
    """Write what a player observes of itself; return how many numbers that is."""
    settings = s.settings[0]
    player = s.players[w, p]
    hp = player.hp * s.player_stats[p].hp_scale
    out[0] = (player.x - settings.middle_x) * settings.scale_x
    out[1] = (player.y - settings.middle_y) * settings.scale_y
    if settings.layout != LAYOUT_PYGAME:
        out[2] = hp
        out[3] = player.xp * settings.xp_scale
        at = 4
    else:
        out[2] = (player.facing == rules.RIGHT) - (player.facing == rules.LEFT)
        out[3] = (player.facing == rules.DOWN) - (player.facing == rules.UP)
        out[4] = hp
        out[5] = player.energy * s.player_stats[p].energy_scale
        at = 6
    if settings.observe_facing:
        for facing in range(4):
            out[at + facing] = player.facing == facing
        at += 4
    return at


@part
def _write_monster(s: State, w: int, p: int, i: int, out: Array, at: int) -> int:
    """Write the `i`-th monster of `scratch` from place `at` on; return where the next one begins.

    The row of a dead monster is zero: its HP are, and the rest is because it is infinitely far away. In the
    published code's layout it stays where it died.
    """
    settings = s.settings[0]
    player = s.players[w, p]
    monster = s.monsters[w, s.scratch[i].order]
    kind = s.monster_stats[s.worlds[w].level, s.scratch[i].order]
    hp = monster.hp * kind.hp_scale
    x = monster.x - player.x
    y = monster.y - player.y
    if settings.layout == LAYOUT_GODOT:
        length = math.sqrt(x * x + y * y)
        inverse = 1.0 / length if length > 0.0 else 0.0
        out[at] = (monster.x - settings.middle_x) * settings.scale_x
        out[at + 1] = (monster.y - settings.middle_y) * settings.scale_y
        out[at + 2] = hp
        out[at + 3] = (player.x - monster.x) * inverse
        out[at + 4] = (player.y - monster.y) * inverse
        return at + 5
    length = s.scratch[i].distance
    inverse = 1.0 / length if length > 0.0 else 0.0
    alive = length < math.inf
    out[at] = length * kind.distance_scale if alive else 0.0
    out[at + 1] = x * inverse
    out[at + 2] = y * inverse
    out[at + 3] = hp
    if settings.layout == LAYOUT_THESIS:
        return at + 4
    out[at + 4] = kind.xp * kind.xp_scale if alive else 0.0
    return at + 5


@kernel
def _write_rays(s: State, w: int, p: int, out: Array, at: int) -> int:
    """Write what each ray of a player meets first, from place `at` on; return where the last one ends.

    At equal distances the first thing counts: monsters by index, then players, then terrain.
    """
    settings = s.settings[0]
    player = s.players[w, p]
    monsters = s.monsters.shape[1]
    for ray in range(settings.rays):
        dx, dy = settings.ray_x[ray], settings.ray_y[ray]
        distance = math.inf
        met = 0
        for body in range(monsters + s.players.shape[1]):
            if body != monsters + p and rules.is_alive(s, w, body):
                near = _distance_to_body(s, w, body, player.x, player.y, dx, dy)
                if near < distance:
                    distance = near
                    met = 2 + s.monster_stats[s.worlds[w].level, body].sight if body < monsters else 1
        near = _distance_to_terrain(s, w, player.x, player.y, dx, dy)
        if near < distance:
            distance = near
            met = 0
        out[at] = distance * settings.ray_scale
        for thing in range(2 + settings.sights):
            out[at + 1 + thing] = thing == met
        at += 3 + settings.sights
    return at


@part
def _distance_to_body(s: State, w: int, body: int, x: float, y: float, dx: float, dy: float) -> float:
    """Return the distance at which a ray enters a body; a ray that only touches it passes by."""
    middle_x, middle_y, half_width, half_height = rules.box(s, w, body)
    enters_x, leaves_x = _between(middle_x - half_width - x, middle_x + half_width - x, dx)
    enters_y, leaves_y = _between(middle_y - half_height - y, middle_y + half_height - y, dy)
    enters = max(enters_x, enters_y, 0.0)
    return enters if enters < min(leaves_x, leaves_y) else math.inf


@part
def _between(low: float, high: float, way: float) -> tuple[float, float]:
    """Return when a point, from 0 with velocity `way`, enters and leaves the space between two lines."""
    if way > 0.0:
        return low / way, high / way
    if way < 0.0:
        return high / way, low / way
    return (-math.inf, math.inf) if low < 0.0 < high else (math.inf, -math.inf)


@part
def _distance_to_terrain(s: State, w: int, x: float, y: float, dx: float, dy: float) -> float:
    """Return the distance at which a ray meets a tile that stops or drowns players.

    It passes a corner only between two open tiles.
    """
    settings = s.settings[0]
    level = s.worlds[w].level
    stops = settings.player_stops | 1 << rules.COAST
    column = math.floor((x - settings.left) / settings.tile)
    row = math.floor((y - settings.top) / settings.tile)
    step_x = 1 if dx > 0.0 else -1
    step_y = 1 if dy > 0.0 else -1
    distance = 0.0
    while not rules.blocked(s.terrain, level, column, row, stops):
        line_x = settings.left + (column + (dx > 0.0)) * settings.tile
        line_y = settings.top + (row + (dy > 0.0)) * settings.tile
        to_x = (line_x - x) / dx if dx != 0.0 else math.inf
        to_y = (line_y - y) / dy if dy != 0.0 else math.inf
        distance = max(min(to_x, to_y), 0.0)
        if to_x == to_y and (
            rules.blocked(s.terrain, level, column + step_x, row, stops)
            or rules.blocked(s.terrain, level, column, row + step_y, stops)
        ):
            break
        column += step_x * (to_x <= to_y)
        row += step_y * (to_y <= to_x)
    return distance + 0.0  # never -0.0


@part
def _mask_actions(s: State, w: int, p: int) -> None:
    """Write which actions would have an effect in the next step.

    While an attack lasts through the whole step no action does anything; then only attack counts as allowed.
    Also without effect are walking or dashing against a wall that the player already faces, a spell without
    enough energy, and a dash too soon after the last one.
    """
    player = s.players[w, p]
    stats = s.player_stats[p]
    free = player.busy < s.settings[0].ticks
    for a in range(4):
        s.masks[w, p, a] = free
    ahead = free and _may_walk(s, w, p)
    s.masks[w, p, player.facing] = ahead
    s.masks[w, p, rules.ATTACK] = 1
    dash = s.settings[0].dash
    if dash >= 0:
        s.masks[w, p, dash] = ahead and player.rest < s.settings[0].ticks  # up to the step's last tick
    if s.masks.shape[2] > rules.HEAL:
        energy = player.energy
        for _ in range(s.settings[0].ticks - 1):  # a spell may begin up to the step's last tick
            energy = min(energy + stats.energy_gain, stats.energy)
        s.masks[w, p, rules.FLAME] = free and energy >= stats.flame_cost
        s.masks[w, p, rules.HEAL] = free and energy >= stats.heal_cost


@part
def _may_walk(s: State, w: int, p: int) -> bool:
    """Return whether terrain lets a player walk on for a tick; bodies are ignored, as they may move."""
    player = s.players[w, p]
    x, y = rules.ahead(s, w, p, s.player_stats[p].speed, s.settings[0].player_stops & ~(1 << rules.BODIES))
    return x != player.x or y != player.y
