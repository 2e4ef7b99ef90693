"""What a player of the oracle's world sees, and which actions would do anything next.

Layouts, orders and scales are told in `pneuma/env/layouts.py`; the numbers are Python floats, which
the kernel stores as float32.
"""

from __future__ import annotations

import math

from pneuma.env.rules import DOWN, LEFT, RIGHT, UP

from .oracle import Oracle
from .oracle_parts import Monster, Player
from .oracle_rays import look_around

ROW = {"thesis": 4, "pygame": 5, "godot": 5}
"""Numbers a monster, by layout."""


def observe(world: Oracle, player: Player) -> list[float]:
    """Return what a player sees, and note how far off the nearest living monster is."""
    settings, config = world.book.settings, world.book.config
    about = _about_player(world, player)
    if config.observe_facing:
        about += [float(player.facing == way) for way in (DOWN, LEFT, UP, RIGHT)]
    size = len(about) + settings.perceived * ROW[config.observation]
    living = [_distance(monster, player) for monster in world.monsters if monster.hp > 0.0]
    player.events.distance = min(living, default=math.inf)
    if settings.rays:
        return about + look_around(world, player)
    for monster in _perceived(world, player):
        about += _about_monster(world, player, monster)
    return about + [0.0] * (size - len(about))


def mask(world: Oracle, player: Player) -> list[int]:
    """Return 1 for every action that would do anything in the next step, and for attack in any case.

    None does while an attack or spell lasts through the step. Walking against a wall that one faces
    already does nothing, nor does a spell that cannot be paid at any tick of it. A body in the way may
    be gone before the step is over.
    """
    ticks, stats = world.book.settings.ticks, player.stats
    gets_on = world.walked(player, player.facing, []) != (player.x, player.y)
    energy = _energy_at_last(player, ticks)
    of_use = {
        "flame": energy >= stats.flame_cost,
        "heal": energy >= stats.heal_cost,
        world.book.actions[player.facing]: gets_on,
    }
    free = player.busy < ticks
    return [int(name == "attack" or (free and of_use.get(name, True))) for name in world.book.actions]


def _energy_at_last(player: Player, ticks: int) -> float:
    """Return a player's energy when it acts in the last tick of the next step, unless it is spent."""
    energy = player.energy
    for _ in range(ticks - 1):
        energy = min(energy + player.stats.energy_gain, player.stats.energy)
    return energy


# --- Which monsters ----------------------------------------------------------------------------------


def _perceived(world: Oracle, player: Player) -> list[Monster]:
    """Return the monsters in a player's view, in order.

    At most so many, the nearest; ties by index. Nearest first, the dead left out; or in fixed order, the dead
    among them, as the furthest of all.
    """
    settings = world.book.settings
    monsters = world.monsters
    living = sorted(
        (monster for monster in monsters if monster.hp > 0.0),
        key=lambda monster: _distance(monster, player),
    )
    if world.book.config.order == "nearest":
        return living[: settings.perceived]
    dead = [monster for monster in monsters if monster.hp <= 0.0]
    chosen = {id(monster) for monster in (living + dead)[: settings.perceived]}
    return [monster for monster in monsters if id(monster) in chosen]


def _distance(monster: Monster, player: Player) -> float:
    x, y = monster.x - player.x, monster.y - player.y
    return math.sqrt(x * x + y * y)


# --- In which numbers --------------------------------------------------------------------------------


def _about_player(world: Oracle, player: Player) -> list[float]:
    settings, stats = world.book.settings, player.stats
    x = (player.x - settings.middle_x) * settings.scale_x
    y = (player.y - settings.middle_y) * settings.scale_y
    hp = player.hp * stats.hp_scale
    if world.book.config.observation == "pygame":
        facing_x = float((player.facing == RIGHT) - (player.facing == LEFT))
        facing_y = float((player.facing == DOWN) - (player.facing == UP))
        return [x, y, facing_x, facing_y, hp, player.energy * stats.energy_scale]
    return [x, y, hp, player.xp * settings.xp_scale]


def _about_monster(world: Oracle, player: Player, monster: Monster) -> list[float]:
    """Return a monster's row of an observation: no direction where the player is; zeros for a dead one.

    The published code's layout shows the dead where they died (AIController2D.gd:20-25).
    """
    settings, layout, kind = world.book.settings, world.book.config.observation, monster.kind
    alive = monster.hp > 0.0
    shown = alive or layout == "godot"
    length = _distance(monster, player)
    inverse = 1.0 / length if shown and length > 0.0 else 0.0
    hp = monster.hp * kind.hp_scale
    if layout == "godot":
        return [
            (monster.x - settings.middle_x) * settings.scale_x,
            (monster.y - settings.middle_y) * settings.scale_y,
            hp,
            (player.x - monster.x) * inverse,
            (player.y - monster.y) * inverse,
        ]
    row = [
        length * kind.distance_scale if alive else 0.0,
        (monster.x - player.x) * inverse,
        (monster.y - player.y) * inverse,
        hp,
    ]
    if layout == "pygame":
        row.append(kind.xp * kind.xp_scale if alive else 0.0)
    return row
