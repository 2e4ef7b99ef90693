"""What a player of the oracle's world observes, and which actions would do anything next.

Layouts, orders and scales are described in `pneuma/env/layouts.py`; the numbers are Python floats, which the
kernel stores as float32. For rays every body and every closed tile is tried; the kernel goes along a ray from
tile to tile instead.
"""

from __future__ import annotations

import math
from collections.abc import Collection

from pneuma.env.rules import DOWN, LEFT, RIGHT, UP

from .oracle import Ground, Monster, Oracle, Pair, Player

ROW = {"thesis": 4, "pygame": 5, "godot": 5}
"""Numbers a monster, by layout."""
TERRAIN, PLAYER, MONSTERS = 0, 1, 2
"""What rays meet: from the last on, monsters by the number of their stats."""


def observe(world: Oracle, player: Player) -> list[float]:
    """Return what a player observes, and note how far off the nearest living monster is."""
    settings, config = world.rulebook.settings, world.rulebook.config
    numbers = _about_player(world, player)
    if config.observe_facing:
        numbers += [float(player.facing == direction) for direction in (DOWN, LEFT, UP, RIGHT)]
    size = len(numbers) + settings.perceived * ROW[config.observation]
    living = [_distance(monster, player) for monster in world.monsters if monster.hp > 0.0]
    player.events.distance = min(living, default=math.inf)
    if settings.rays:
        return numbers + _look_around(world, player)
    for monster in _perceived(world, player):
        numbers += _about_monster(world, player, monster)
    return numbers + [0.0] * (size - len(numbers))


def mask(world: Oracle, player: Player) -> list[int]:
    """Return 1 for every action that would do anything in the next step, and for attack in any case.

    None does while an attack or spell lasts through the step. Walking against a wall that one faces already
    does nothing, nor does a spell that cannot be paid at any tick of it. Bodies in the way may go.
    """
    ticks, stats = world.rulebook.settings.ticks, player.stats
    energy = player.energy
    for _ in range(ticks - 1):
        energy = min(energy + stats.energy_gain, stats.energy)
    is_useful = {
        "flame": energy >= stats.flame_cost,
        "heal": energy >= stats.heal_cost,
        world.rulebook.actions[player.facing]: world.walked(player, []) != (player.x, player.y),
    }
    is_free = player.busy < ticks
    return [
        int(name == "attack" or (is_free and is_useful.get(name, True))) for name in world.rulebook.actions
    ]


def _perceived(world: Oracle, player: Player) -> list[Monster]:
    """Return the monsters in a player's view: the nearest ones, ties by index.

    Nearest first, without the dead; or in fixed order, where the dead are the furthest of all.
    """
    monsters, limit = world.monsters, world.rulebook.settings.perceived
    living = [monster for monster in monsters if monster.hp > 0.0]
    living.sort(key=lambda monster: _distance(monster, player))
    if world.rulebook.config.order == "nearest":
        return living[:limit]
    dead = [monster for monster in monsters if monster.hp <= 0.0]
    nearest = {id(monster) for monster in (living + dead)[:limit]}
    return [monster for monster in monsters if id(monster) in nearest]


def _distance(monster: Monster, player: Player) -> float:
    x, y = monster.x - player.x, monster.y - player.y
    return math.sqrt(x * x + y * y)


def _about_player(world: Oracle, player: Player) -> list[float]:
    settings, stats = world.rulebook.settings, player.stats
    x = (player.x - settings.middle_x) * settings.scale_x
    y = (player.y - settings.middle_y) * settings.scale_y
    hp = player.hp * stats.hp_scale
    if world.rulebook.config.observation == "pygame":
        facing_x = float((player.facing == RIGHT) - (player.facing == LEFT))
        facing_y = float((player.facing == DOWN) - (player.facing == UP))
        return [x, y, facing_x, facing_y, hp, player.energy * stats.energy_scale]
    return [x, y, hp, player.xp * settings.xp_scale]


def _about_monster(world: Oracle, player: Player, monster: Monster) -> list[float]:
    """Return a monster's row of an observation: no direction where the player is; zeros for a dead one.

    The published code's layout shows the dead where they died (AIController2D.gd:20-25).
    """
    settings, layout, stats = world.rulebook.settings, world.rulebook.config.observation, monster.stats
    alive = monster.hp > 0.0
    distance, inverse = _distance(monster, player), 0.0
    if (alive or layout == "godot") and distance > 0.0:
        inverse = 1.0 / distance
    hp = monster.hp * stats.hp_scale
    if layout == "godot":
        x = (monster.x - settings.middle_x) * settings.scale_x
        y = (monster.y - settings.middle_y) * settings.scale_y
        return [x, y, hp, (player.x - monster.x) * inverse, (player.y - monster.y) * inverse]
    scaled_distance, xp = distance * stats.distance_scale, stats.xp * stats.xp_scale
    if not alive:
        scaled_distance = xp = 0.0
    row = [scaled_distance, (monster.x - player.x) * inverse, (monster.y - player.y) * inverse, hp]
    if layout == "pygame":
        row.append(xp)
    return row


# --- Rays ------------------------------------------------------------------------------------------


def _look_around(world: Oracle, player: Player) -> list[float]:
    """Return a row for each ray: how far it goes, then 1 for what it meets, else 0."""
    settings, numbers = world.rulebook.settings, []
    for index in range(settings.rays):
        ray = settings.ray_x[index], settings.ray_y[index]
        ends = _ends_at_bodies(world, player, ray)
        ends.append(
            (_terrain(world.ground, (player.x, player.y), ray, world.rulebook.closed_to_players), TERRAIN)
        )
        distance, category = min(ends, key=lambda end: end[0])  # of equals the first
        numbers.append(distance * settings.ray_scale)
        numbers += [float(number == category) for number in range(MONSTERS + settings.species_count)]
    return numbers


def _ends_at_bodies(world: Oracle, player: Player, ray: Pair) -> list[tuple[float, int]]:
    """Return how far off each living body is entered, and what it is; one that is only touched is not."""
    boxes = [
        (monster.box, MONSTERS + monster.stats.species) for monster in world.monsters if monster.hp > 0.0
    ]
    boxes += [(mate.box, PLAYER) for mate in world.players if mate is not player and mate.hp > 0.0]
    ends = []
    for (centre, half), category in boxes:
        low = centre[0] - half[0], centre[1] - half[1]
        high = centre[0] + half[0], centre[1] + half[1]
        start, end, passes_by = _inside(low, high, (player.x, player.y), ray)
        if start < end and end > 0.0 and not passes_by:
            ends.append((max(start, 0.0), category))
    return ends


def _terrain(ground: Ground, origin: Pair, ray: Pair, closed: Collection[int]) -> float:
    """Return how far off the first closed tile is met, if only at a corner, or the edge of the grid."""
    columns, rows = len(ground.tiles[0]), len(ground.tiles)
    _, nearest, _ = _inside(ground.corner, _tile_corner(ground, columns, rows), origin, ray)
    for row, codes in enumerate(ground.tiles):
        for column, code in enumerate(codes):
            if code not in closed:
                continue
            low, high = _tile_corner(ground, column, row), _tile_corner(ground, column + 1, row + 1)
            covers = [low[axis] <= origin[axis] < high[axis] for axis in (0, 1)]
            if all(covers):
                return 0.0
            start, end, _ = _inside(low, high, origin, ray)
            level = all(covers[axis] for axis in (0, 1) if ray[axis] == 0.0)
            if start <= end and end > 0.0 and level:
                nearest = min(nearest, max(start, 0.0))
    return nearest


def _tile_corner(ground: Ground, column: int, row: int) -> Pair:
    """Return the upper left corner of a tile."""
    return ground.corner[0] + column * ground.tile, ground.corner[1] + row * ground.tile


def _inside(low: Pair, high: Pair, origin: Pair, ray: Pair) -> tuple[float, float, bool]:
    """Return from when to when a ray is in a box, and whether it passes by, parallel to a side."""
    start, end, passes_by = -math.inf, math.inf, False
    for axis in (0, 1):
        if ray[axis] == 0.0:
            passes_by |= not low[axis] < origin[axis] < high[axis]
            continue
        crossings = sorted([(low[axis] - origin[axis]) / ray[axis], (high[axis] - origin[axis]) / ray[axis]])
        start, end = max(start, crossings[0]), min(end, crossings[1])
    return start, end, passes_by
