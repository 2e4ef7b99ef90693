"""Writing what a player perceives, and which of its actions have an effect, compiled (`layouts.py`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pneuma.env import rules
from pneuma.env.compiling import inlined, inlined_early, kernel
from pneuma.env.fields import OBSERVATIONS
from pneuma.env.state import Array, World

LAYOUT_THESIS, LAYOUT_PYGAME, LAYOUT_GODOT = range(len(OBSERVATIONS))


@inlined_early
def observe_player(world: World, player_index: int, notes_distance: bool) -> None:
    """Write a player's observation and action mask; `layouts.py` has the layouts.

    `notes_distance` says whether to write the nearest monster's distance to the events, which an ended world
    does not do.
    """
    perceived = _order_monsters(world, player_index, notes_distance)
    observation = world.observations[player_index]
    column = _write_player(world, player_index, observation)
    for monster_rank in range(perceived):
        column = _write_monster(world, player_index, monster_rank, observation, column)
    if world.settings.rays > 0:
        column = _write_rays(world, player_index, observation, column)
    for empty_column in range(column, len(observation)):
        observation[empty_column] = 0.0
    _mask_actions(world, player_index)


@inlined
def _order_monsters(world: World, player_index: int, notes_distance: bool) -> int:
    """List in `scratch` the monsters that a player perceives, with distances; return their number.

    The nearest come first, ties by index, without the dead. In fixed order the same monsters are listed by
    index, and the dead fill the remaining rows, infinitely far away.
    """
    player = world.players[player_index]
    fixed_order = world.settings.fixed_order
    nearest = math.inf
    listed: Any = np.int64(0)
    for monster_index in range(len(world.monsters)):
        monster = world.monsters[monster_index]
        distance = math.inf
        if monster.hp > 0.0:
            x = monster.x - player.x
            y = monster.y - player.y
            distance = math.sqrt(x * x + y * y)
            nearest = min(nearest, distance)
        if fixed_order or distance < math.inf:
            _insert(world.scratch, listed, monster_index, distance, True)
            listed += 1
    if notes_distance:
        world.events[player_index].distance = nearest
    listed = min(listed, world.settings.perceived)
    if fixed_order:
        for monster_rank in range(listed):
            monster = world.scratch[monster_rank]
            _insert(world.scratch, monster_rank, monster.order, monster.distance, False)
    return listed


@inlined
def _insert(scratch: Array, listed: int, monster_index: int, distance: float, by_distance: bool) -> None:
    """Insert into the first `listed` of `scratch`: nearest first, behind equals, or by index.

    An insertion sort: for 14 items it is several times faster than numpy.argsort.
    """
    monster_rank = listed
    while monster_rank > 0:
        previous = scratch[monster_rank - 1]
        goes_before = previous.order > monster_index
        if by_distance:
            goes_before = previous.distance > distance
        if not goes_before:
            break
        scratch[monster_rank].order = previous.order
        scratch[monster_rank].distance = previous.distance
        monster_rank -= 1
    scratch[monster_rank].order = monster_index
    scratch[monster_rank].distance = distance


@inlined
def _write_player(world: World, player_index: int, observation: Array) -> int:
    """Write what a player observes of itself; return how many numbers that is."""
    settings = world.settings
    player = world.players[player_index]
    player_stats = world.player_stats[player_index]
    hp = player.hp * player_stats.hp_scale
    observation[0] = (player.x - settings.middle_x) * settings.scale_x
    observation[1] = (player.y - settings.middle_y) * settings.scale_y
    if settings.layout != LAYOUT_PYGAME:
        observation[2] = hp
        observation[3] = player.xp * settings.xp_scale
        column = 4
    else:
        observation[2] = (player.facing == rules.RIGHT) - (player.facing == rules.LEFT)
        observation[3] = (player.facing == rules.DOWN) - (player.facing == rules.UP)
        observation[4] = hp
        observation[5] = player.energy * player_stats.energy_scale
        column = 6
    if settings.observe_facing:
        for facing in range(4):
            observation[column + facing] = player.facing == facing
        column += 4
    return column


@inlined
def _write_monster(
    world: World, player_index: int, monster_rank: int, observation: Array, column: int
) -> int:
    """Write a monster, by its rank in `scratch`, from a column on; return where the next one begins.

    The row of a dead monster is zero: its HP are, and the rest is because it is infinitely far away. In the
    published code's layout it stays where it died.
    """
    settings = world.settings
    monster_index = world.scratch[monster_rank].order
    player = world.players[player_index]
    monster = world.monsters[monster_index]
    monster_stats = world.monster_stats[monster_index]
    hp = monster.hp * monster_stats.hp_scale
    x = monster.x - player.x
    y = monster.y - player.y
    if settings.layout == LAYOUT_GODOT:
        inverse = _inverse(math.sqrt(x * x + y * y))
        observation[column] = (monster.x - settings.middle_x) * settings.scale_x
        observation[column + 1] = (monster.y - settings.middle_y) * settings.scale_y
        observation[column + 2] = hp
        observation[column + 3] = (player.x - monster.x) * inverse
        observation[column + 4] = (player.y - monster.y) * inverse
        return column + 5
    distance = world.scratch[monster_rank].distance
    inverse = _inverse(distance)
    observation[column] = 0.0
    if distance < math.inf:
        observation[column] = distance * monster_stats.distance_scale
    observation[column + 1] = x * inverse
    observation[column + 2] = y * inverse
    observation[column + 3] = hp
    if settings.layout == LAYOUT_THESIS:
        return column + 4
    observation[column + 4] = 0.0
    if distance < math.inf:
        observation[column + 4] = monster_stats.xp * monster_stats.xp_scale
    return column + 5


@inlined
def _inverse(distance: float) -> float:
    """Return one over a distance; 0 if that is 0."""
    if distance > 0.0:
        return 1.0 / distance
    return 0.0


@kernel
def _write_rays(world: World, player_index: int, observation: Array, column: int) -> int:
    """Write what each ray of a player meets first, from a column on; return where the last one ends.

    At equal distances the first thing counts: monsters by index, then players, then terrain.
    """
    settings = world.settings
    player = world.players[player_index]
    monsters = len(world.monsters)
    rules.pack_bodies(world)
    for ray_index in range(settings.rays):
        ray_x = settings.ray_x[ray_index]
        ray_y = settings.ray_y[ray_index]
        nearest = math.inf
        category = 0  # terrain
        for body_index in range(len(world.boxes)):
            box = world.boxes[body_index]
            if body_index != monsters + player_index and box.alive:
                distance = _distance_to_body(box, player.x, player.y, ray_x, ray_y)
                if distance < nearest:
                    nearest = distance
                    category = 1  # another player
                    if body_index < monsters:
                        category = 2 + world.monster_stats[body_index].species
        distance = _distance_to_terrain(world, player.x, player.y, ray_x, ray_y)
        if distance < nearest:
            nearest = distance
            category = 0
        observation[column] = nearest * settings.ray_scale
        for possible_category in range(2 + settings.species_count):
            observation[column + 1 + possible_category] = possible_category == category
        column += 3 + settings.species_count
    return column


@inlined
def _distance_to_body(box: Array, from_x: float, from_y: float, ray_x: float, ray_y: float) -> float:
    """Return the distance at which a ray enters a body; a ray that only touches it passes by."""
    middle_x = box.place[0] + box.offset[0]
    middle_y = box.place[1] + box.offset[1]
    enters_x, leaves_x = _between(middle_x - box.half[0] - from_x, middle_x + box.half[0] - from_x, ray_x)
    enters_y, leaves_y = _between(middle_y - box.half[1] - from_y, middle_y + box.half[1] - from_y, ray_y)
    entry = max(enters_x, enters_y, 0.0)
    if entry < min(leaves_x, leaves_y):
        return entry
    return math.inf


@inlined
def _between(low: float, high: float, velocity: float) -> tuple[float, float]:
    """Return when a point, which starts from 0, enters and leaves the space between two lines."""
    if velocity > 0.0:
        return low / velocity, high / velocity
    if velocity < 0.0:
        return high / velocity, low / velocity
    if low < 0.0 < high:
        return -math.inf, math.inf
    return math.inf, -math.inf


@inlined
def _distance_to_terrain(world: World, from_x: float, from_y: float, ray_x: float, ray_y: float) -> float:
    """Return the distance at which a ray meets a tile that stops players.

    It passes a corner only between two open tiles.
    """
    settings = world.settings
    stops = settings.player_stops
    column = math.floor((from_x - settings.corner[0]) / settings.tile)
    row = math.floor((from_y - settings.corner[1]) / settings.tile)
    step_x = -1
    if ray_x > 0.0:
        step_x = 1
    step_y = -1
    if ray_y > 0.0:
        step_y = 1
    distance = 0.0
    while not rules.blocked(world.terrain, column, row, stops):
        to_x = math.inf
        if ray_x != 0.0:
            to_x = (settings.corner[0] + (column + (ray_x > 0.0)) * settings.tile - from_x) / ray_x
        to_y = math.inf
        if ray_y != 0.0:
            to_y = (settings.corner[1] + (row + (ray_y > 0.0)) * settings.tile - from_y) / ray_y
        distance = max(min(to_x, to_y), 0.0)
        if to_x == to_y and (
            rules.blocked(world.terrain, column + step_x, row, stops)
            or rules.blocked(world.terrain, column, row + step_y, stops)
        ):
            break
        column += step_x * (to_x <= to_y)
        row += step_y * (to_y <= to_x)
    return distance + 0.0  # never -0.0


@inlined
def _mask_actions(world: World, player_index: int) -> None:
    """Write which actions would have an effect in the next step.

    While an attack lasts through the whole step no action does anything; then only attack counts as allowed.
    Also without effect are walking against a wall that the player already faces, and a spell without enough
    energy.
    """
    player = world.players[player_index]
    player_stats = world.player_stats[player_index]
    ticks = world.settings.ticks
    mask = world.masks[player_index]
    is_free = player.busy < ticks
    for facing in range(4):
        mask[facing] = is_free
    mask[player.facing] = is_free and _may_walk(world, player_index)
    mask[rules.ATTACK] = 1
    if world.settings.magic:
        energy = player.energy
        for _ in range(ticks - 1):  # a spell may begin up to the step's last tick
            energy = min(energy + player_stats.energy_gain, player_stats.energy)
        mask[rules.FLAME] = is_free and energy >= player_stats.flame_cost
        mask[rules.HEAL] = is_free and energy >= player_stats.heal_cost


@inlined
def _may_walk(world: World, player_index: int) -> bool:
    """Return whether terrain lets a player walk on for a tick; bodies are ignored, as they may move."""
    player = world.players[player_index]
    rules.pack_player(world, player_index)
    x, y = rules.walk(world, player_index, np.bool_(False))
    return x != player.x or y != player.y
