"""Writing what a player perceives, and which of its actions have an effect, compiled (`layouts.py`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pneuma.env import rules
from pneuma.env.compiling import inlined, inlined_early, kernel
from pneuma.env.layouts import LAYOUT_GODOT, LAYOUT_PYGAME, LAYOUT_THESIS
from pneuma.env.state import Array, State


@inlined_early
def observe_player(s: State, w: int, p: int, tell: bool) -> None:
    """Write a player's observation and action mask; `layouts.py` has the layouts.

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


@inlined
def _order_monsters(s: State, w: int, p: int, tell: bool) -> int:
    """List in `scratch` the monsters that a player perceives, with distances; return their number.

    The nearest come first, ties by index, without the dead. In fixed order the same monsters are listed by
    index, and the dead fill the remaining rows, infinitely far away.
    """
    player = s.players[w, p]
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
        if fixed or length < math.inf:
            _insert(s.scratch, count, m, length, False)
            count += 1
    if tell:
        s.events[w, p].distance = nearest
    count = min(count, s.settings[0].perceived)
    if fixed:
        for i in range(count):
            _insert(s.scratch, i, s.scratch[i].order, s.scratch[i].distance, True)
    return count


@inlined
def _insert(scratch: Array, count: int, order: int, distance: float, by_index: bool) -> None:
    """Insert into the first `count` of `scratch`, nearest first, behind equals; or by index.

    An insertion sort: for 14 items it is several times faster than numpy.argsort.
    """
    i = count
    while i > 0 and (scratch[i - 1].order > order if by_index else scratch[i - 1].distance > distance):
        scratch[i].order = scratch[i - 1].order
        scratch[i].distance = scratch[i - 1].distance
        i -= 1
    scratch[i].order = order
    scratch[i].distance = distance


@inlined
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


@inlined
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


@inlined
def _distance_to_body(s: State, w: int, body: int, x: float, y: float, dx: float, dy: float) -> float:
    """Return the distance at which a ray enters a body; a ray that only touches it passes by."""
    middle_x, middle_y, half_width, half_height = rules.box(s, w, body)
    enters_x, leaves_x = _between(middle_x - half_width - x, middle_x + half_width - x, dx)
    enters_y, leaves_y = _between(middle_y - half_height - y, middle_y + half_height - y, dy)
    enters = max(enters_x, enters_y, 0.0)
    return enters if enters < min(leaves_x, leaves_y) else math.inf


@inlined
def _between(low: float, high: float, way: float) -> tuple[float, float]:
    """Return when a point, from 0 with velocity `way`, enters and leaves the space between two lines."""
    if way > 0.0:
        return low / way, high / way
    if way < 0.0:
        return high / way, low / way
    return (-math.inf, math.inf) if low < 0.0 < high else (math.inf, -math.inf)


@inlined
def _distance_to_terrain(s: State, w: int, x: float, y: float, dx: float, dy: float) -> float:
    """Return the distance at which a ray meets a tile that stops players.

    It passes a corner only between two open tiles.
    """
    settings = s.settings[0]
    level = s.worlds[w].level
    stops = settings.player_stops
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


@inlined
def _mask_actions(s: State, w: int, p: int) -> None:
    """Write which actions would have an effect in the next step.

    While an attack lasts through the whole step no action does anything; then only attack counts as allowed.
    Also without effect are walking against a wall that the player already faces, and a spell without enough
    energy.
    """
    player = s.players[w, p]
    stats = s.player_stats[p]
    free = player.busy < s.settings[0].ticks
    for a in range(4):
        s.masks[w, p, a] = free
    s.masks[w, p, player.facing] = free and _may_walk(s, w, p)
    s.masks[w, p, rules.ATTACK] = 1
    if s.settings[0].magic:
        energy = player.energy
        for _ in range(s.settings[0].ticks - 1):  # a spell may begin up to the step's last tick
            energy = min(energy + stats.energy_gain, stats.energy)
        s.masks[w, p, rules.FLAME] = free and energy >= stats.flame_cost
        s.masks[w, p, rules.HEAL] = free and energy >= stats.heal_cost


@inlined
def _may_walk(s: State, w: int, p: int) -> bool:
    """Return whether terrain lets a player walk on for a tick; bodies are ignored, as they may move."""
    player = s.players[w, p]
    x, y = rules.ahead(s, w, p, False)
    return x != player.x or y != player.y
