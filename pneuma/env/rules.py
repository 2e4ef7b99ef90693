"""The rules of the world, compiled.

They advance a world with P players and M monsters by agent steps of several ticks of 1/60 s; `kernel.py`
calls them for N worlds. The state lies in plain arrays (`state.py`) that `worlds.py` owns. Nothing here
allocates memory. Sources: thesis sections 5.1 to 5.3 and the constants of the published code.

In a tick every player acts; then every monster is struck, senses, bites and moves; then every player gets the
XP, healing and bites of the tick. Living bodies and terrain stop a moving body, first along x, then along y.
Nothing is pushed.

The dynamics use only + - * / and square root, without fast-math, so that every processor gives
the same bits.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pneuma.env.compiling import inlined, inlined_early, kernel
from pneuma.env.state import Array, State

DOWN, LEFT, UP, RIGHT, ATTACK, FLAME, HEAL = 0, 1, 2, 3, 4, 5, 6
BLADE, BURNING, HEALING = 1, 2, 3
"""What a busy player does: attack with its sword, or cast a spell."""
OPEN, SOLID, COAST = 0, 1, 2
RUNNING, KILLED, CLEARED, TIME_LIMIT = 0, 1, 2, 3

CONTACT_EPS = 2.0**-10
"""Pixels by which bodies may overlap and still count as touching, as sums of floats are not exact."""


# --- Random numbers ------------------------------------------------------------------------------


@inlined
def _draw(world: Array) -> Any:
    """Return the next 64 random bits of a world: splitmix64 at (key, counter).

    Steele, Lea and Flood (2014), "Fast splittable pseudorandom number generators".
    """
    world.draws += np.uint64(1)
    z = world.key + world.draws * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@inlined
def _draw_below(world: Array, bound: int) -> Any:
    """Return a random integer in [0, bound), for bounds far below 2**32."""
    high = _draw(world) >> np.uint64(32)
    return np.int64((high * np.uint64(bound)) >> np.uint64(32))


# --- Reset ---------------------------------------------------------------------------------------


@inlined
def begin_episode(s: State, w: int, chosen: int) -> None:
    """Start an episode in one world, at start place `chosen`; below zero asks for one at random."""
    world = s.worlds[w]
    world.steps = 0
    world.ending = RUNNING
    world.monsters_left = s.monsters.shape[1]
    world.players_left = s.players.shape[1]
    world.level = _draw_below(world, s.starts.shape[0]) if s.starts.shape[0] > 1 else 0
    world.start = chosen if chosen >= 0 else _draw_below(world, s.starts.shape[1])
    for p in range(s.players.shape[1]):
        place = (world.start + p) % s.starts.shape[1]
        kept = s.players[w, p].xp if s.settings[0].keep_xp else 0.0
        s.players[w, p] = s.first_players[p]
        s.players[w, p].xp = kept
        s.players[w, p].x = s.starts[world.level, place, 0]
        s.players[w, p].y = s.starts[world.level, place, 1]
        s.slots[w, p].returns = 0.0
        s.slots[w, p].lengths = 0
        s.slots[w, p].idle = False
    for m in range(s.monsters.shape[1]):
        s.monsters[w, m] = s.first_monsters[world.level, m]
    s.tallies[w].returns = 0.0
    s.tallies[w].hp_lost = 0.0
    s.tallies[w].cleared = 0
    for action in range(s.taken.shape[1]):
        s.taken[w, action] = 0


# --- One step ------------------------------------------------------------------------------------


@inlined_early
def step_world(s: State, w: int, actions: Array) -> bool:
    """Advance one running world by one agent step; return whether its episode ended."""
    world = s.worlds[w]
    settings = s.settings[0]
    count = _gather_active(s, w)
    _gather_near(s, w, count)
    for _ in range(settings.ticks):
        for p in range(s.players.shape[1]):
            _begin_tick(s, w, p, actions[w, p])
        for i in range(count):
            m = np.int64(s.scratch[i].order)
            if s.monsters[w, m].hp > 0.0:
                _tick_monster(s, w, m)
        for p in range(s.players.shape[1]):
            if s.tick[p].there:
                _end_tick(s, w, p)
    world.players_left = 0
    for p in range(s.players.shape[1]):
        world.players_left += s.players[w, p].hp > 0.0
    world.steps += 1
    if world.players_left == 0:
        world.ending = KILLED
    elif world.monsters_left == 0 and settings.end_on_clear:
        world.ending = CLEARED
    elif world.steps >= settings.episode_steps:
        world.ending = TIME_LIMIT
    if world.ending == CLEARED or world.ending == TIME_LIMIT:
        for p in range(s.players.shape[1]):
            if s.players[w, p].hp > 0.0:
                _charge(s.players[w, p], s.events[w, p], settings.ending_cost)
    return world.ending != RUNNING


@inlined
def _charge(player: Array, event: Array, cost: float) -> None:
    """Subtract the XP that an ending costs; in the published code the reward is then set to the XP."""
    if cost != 0.0:
        player.xp -= cost
        event.xp_gained -= cost
        event.reward = player.xp


@inlined
def _gather_active(s: State, w: int) -> int:
    """List in `scratch` the monsters to which anything can happen in the next step; return their number.

    The others stand still and only block those that move. Leaving them out changes no bit and saves most of
    the time.
    """
    count = 0
    for m in range(s.monsters.shape[1]):
        monster = s.monsters[w, m]
        if monster.hp > 0.0 and _may_stir(s, w, m):
            s.scratch[count].order = m
            count += 1
    return count


@inlined
def _gather_near(s: State, w: int, count: int) -> None:
    """List in `near` which bodies each player and the first `count` of `scratch` may meet in this step."""
    monsters = s.monsters.shape[1]
    bodies = monsters + s.players.shape[1]
    for each in range(bodies):
        _pack(s, w, each)
    for mover in range(count + s.players.shape[1]):
        me = np.int64(s.scratch[mover].order) if mover < count else monsters + mover - count
        x, y, _ = body(s, w, me)
        near = s.near[me]
        near[0] = 0
        for other in range(bodies):
            if other != me and _is_near(s, w, other, x, y):
                near[0] += 1
                near[near[0]] = other


@inlined
def _pack(s: State, w: int, me: int) -> None:
    """Write a body's box to `boxes`, where moving bodies look for obstacles; what is dead stops nobody."""
    row = s.boxes[me]
    row[0], row[1], row[2], row[3] = box(s, w, me)
    if not is_alive(s, w, me):
        row[2] = row[3] = -math.inf


@inlined
def _may_stir(s: State, w: int, m: int) -> bool:
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    if monster.knocked > 0 or monster.safe > 0 or monster.noticed or monster.inside:
        return True
    for p in range(s.players.shape[1]):
        if monster.bite[p] > 0:
            return True
        player = s.players[w, p]
        if player.hp > 0.0 and _gap(monster.x, monster.y, player, s.player_stats[p]) <= kind.reach_squared:
            return True
    return False


@inlined
def _gap(x: float, y: float, player: Array, stats: Array) -> float:
    """Return the squared distance from a point to a player's body."""
    across = max(abs(player.x + stats.body_x - x) - stats.half_width, 0.0)
    down = max(abs(player.y + stats.body_y - y) - stats.half_height, 0.0)
    return across * across + down * down


# --- A tick: players act -------------------------------------------------------------------------


@inlined
def _begin_tick(s: State, w: int, p: int, action: int) -> None:
    """Let a living player act, and record what it strikes."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    tick = s.tick[p]
    tick.there = player.hp > 0.0
    tick.strikes = 0
    if not tick.there:
        return
    tick.xp = tick.healed = tick.bitten = 0.0
    tick.notices = tick.contacts = tick.paid = 0
    if player.busy == 0:
        _act(s, w, p, player, stats, action)
    if player.busy > 0:
        player.busy -= 1
        if player.action_kind == BLADE:
            tick.strikes = BLADE
    player.energy = min(player.energy + stats.energy_gain, stats.energy)
    s.events[w, p].present += 1


@inlined
def _act(s: State, w: int, p: int, player: Array, stats: Array, action: int) -> None:
    """Let an idle player walk for a tick, or start an attack, or a spell that it can pay for."""
    if action == ATTACK:
        player.busy = stats.swing
        player.action_kind = BLADE
        player.attack += 1
    elif action == FLAME:
        if player.energy >= stats.flame_cost:
            player.energy -= stats.flame_cost
            player.busy = stats.flame_ticks
            player.action_kind = BURNING
            player.attack += 1
            s.tick[p].strikes = BURNING  # in this tick only
    elif action == HEAL:
        if player.energy >= stats.heal_cost:
            player.energy -= stats.heal_cost
            player.busy = stats.heal_ticks
            player.action_kind = HEALING
            for other in range(s.players.shape[1]):
                if other == p or _within_heal(s.players[w, other], player, stats.heal_reach):
                    _heal(s.players[w, other], s.player_stats[other], s.events[w, other], stats.heal)
    else:
        player.facing = action
        _walk(s, w, p)


@inlined
def _within_heal(other: Array, player: Array, reach: float) -> bool:
    x = other.x - player.x
    y = other.y - player.y
    return reach > 0.0 and other.hp > 0.0 and x * x + y * y <= reach * reach


@inlined
def _heal(player: Array, stats: Array, event: Array, most: float) -> None:
    hp = max(player.hp, min(player.hp + most, stats.hp))
    event.hp_gained += hp - player.hp
    player.hp = hp


@kernel
def _walk(s: State, w: int, p: int) -> None:
    player = s.players[w, p]
    player.x, player.y = ahead(s, w, p, True)
    _pack(s, w, s.monsters.shape[1] + p)


@inlined
def ahead(s: State, w: int, p: int, among_bodies: bool) -> tuple[float, float]:
    """Return where a player is after walking for one tick in the direction it faces."""
    facing = s.players[w, p].facing
    speed = s.player_stats[p].speed
    dx = speed if facing == RIGHT else -speed if facing == LEFT else 0.0
    dy = speed if facing == DOWN else -speed if facing == UP else 0.0
    return moved(s, w, s.monsters.shape[1] + p, dx, dy, s.settings[0].player_stops, among_bodies)


# --- A tick: monsters are struck, sense, bite and move -------------------------------------------


@inlined
def _tick_monster(s: State, w: int, m: int) -> None:
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    if monster.safe > 0:
        monster.safe -= 1
    for p in range(s.players.shape[1]):
        bit = np.uint8(1 << p)
        struck = s.tick[p].there and s.tick[p].strikes and _is_struck(s, w, p, monster, kind)
        entry = s.settings[0].blow_on_entry and s.players[w, p].action_kind == BLADE
        if not s.tick[p].there:
            monster.noticed &= ~bit
            monster.bite[p] = 0
        elif struck and not entry:
            _apply_hit(s, w, m, p)
        elif struck and not monster.inside & bit:
            monster.struck_by[p] = 0  # one that comes back is hit again by the same attack
            _apply_hit(s, w, m, p)
        if s.settings[0].blow_on_entry:
            monster.inside = monster.inside | bit if struck and entry else monster.inside & ~bit
    if monster.hp <= 0.0:
        return
    target = -1
    nearest = math.inf
    for p in range(s.players.shape[1]):
        gap = _sense(s, w, m, p) if s.tick[p].there else math.inf
        if gap <= kind.notice_squared and gap < nearest:
            nearest = gap
            target = p
    dx = 0.0
    dy = 0.0
    if monster.knocked > 0:
        monster.knocked -= 1
        dx = monster.knock_x
        dy = monster.knock_y
    elif target >= 0:
        dx = _approach(s.players[w, target].x - monster.x, kind.stand_off, kind.speed)
        dy = _approach(s.players[w, target].y - monster.y, kind.stand_off, kind.speed)
    if dx != 0.0 or dy != 0.0:
        monster.x, monster.y = moved(s, w, m, dx, dy, s.settings[0].monster_stops, True)
        _pack(s, w, m)


@inlined
def _strike(s: State, p: int) -> Array:
    """Return what a player strikes with."""
    stats = s.player_stats[p]
    return stats.flame if s.tick[p].strikes == BURNING else stats.sword


@inlined
def _is_struck(s: State, w: int, p: int, monster: Array, kind: Array) -> bool:
    player, strike = s.players[w, p], _strike(s, p)
    x, y = player.x + strike.x[player.facing], player.y + strike.y[player.facing]
    across = abs(monster.x + kind.body_x - x) < strike.half_width[player.facing] + kind.half_width
    return across and abs(monster.y + kind.body_y - y) < strike.half_height[player.facing] + kind.half_height


@inlined
def _apply_hit(s: State, w: int, m: int, p: int) -> None:
    """Apply a player's blow, unless this attack has hit the monster already or the monster is safe."""
    monster, player = s.monsters[w, m], s.players[w, p]
    if monster.struck_by[p] == player.attack or monster.safe > 0 or monster.hp <= 0.0:
        return
    kind = s.monster_stats[s.worlds[w].level, m]
    strike = _strike(s, p)
    monster.struck_by[p] = player.attack
    monster.safe = kind.safe
    monster.hp = max(monster.hp - strike.damage, 0.0)
    s.events[w, p].hits += 1
    if monster.hp <= 0.0:
        _pack(s, w, m)
        _credit_kill(s, w, m, p)
    elif strike.knock_ticks >= 0 and monster.knocked == 0:
        _knock_back(monster, kind, player, strike)


@inlined
def _knock_back(monster: Array, kind: Array, player: Array, strike: Array) -> None:
    """Start a flight away from the hilt; a flight in progress is neither turned nor extended."""
    away_x = monster.x - (player.x + strike.hilt_x[player.facing])
    away_y = monster.y - (player.y + strike.hilt_y[player.facing])
    length = math.sqrt(away_x * away_x + away_y * away_y)
    has_knock = kind.knock_ticks >= 0
    speed = kind.knock_speed if has_knock else strike.knock_speed
    monster.knock_x = away_x / length * speed if length > 0.0 else 0.0
    monster.knock_y = away_y / length * speed if length > 0.0 else 0.0
    monster.knocked = kind.knock_ticks if has_knock else strike.knock_ticks


@inlined
def _credit_kill(s: State, w: int, m: int, striker: int) -> None:
    """Credit a kill to the player who struck, or to all players within the attack circle."""
    kind = s.monster_stats[s.worlds[w].level, m]
    s.worlds[w].monsters_left -= 1
    s.players[w, striker].kills += 1
    s.events[w, striker].kills += 1
    for p in range(s.players.shape[1]):
        tick = s.tick[p]
        earns = s.monsters[w, m].bite[p] > 0 if s.settings[0].credit_near else p == striker
        if tick.there and earns:
            tick.paid = 1
            tick.xp += kind.xp
            tick.healed += kind.heal


@inlined
def _sense(s: State, w: int, m: int, p: int) -> float:
    """Notice a player, and bite it if it is near enough; return the squared distance to it."""
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    player = s.players[w, p]
    stats = s.player_stats[p]
    tick = s.tick[p]
    gap = _gap(monster.x + kind.notice_x, monster.y + kind.notice_y, player, stats)
    if gap > kind.notice_squared:
        monster.noticed &= ~np.uint8(1 << p)
    elif not monster.noticed & np.uint8(1 << p):
        monster.noticed |= np.uint8(1 << p)
        tick.notices += 1
    if _gap(monster.x + kind.attack_x, monster.y + kind.attack_y, player, stats) > kind.attack_squared:
        monster.bite[p] = 0
    elif monster.bite[p] > 1:
        monster.bite[p] -= 1
    else:
        tick.contacts += monster.bite[p] == 0
        if monster.knocked > 0:
            monster.bite[p] = 1  # due as soon as it has landed
        else:
            monster.bite[p] = kind.bite_ticks
            if stats.safe == 0 or tick.bitten == 0.0:  # one bite a tick for who is safe after it
                tick.bitten += kind.damage
    return gap


@inlined
def _approach(offset: float, stand_off: float, speed: float) -> float:
    """Return a monster's move on one axis towards a player that is `offset` away."""
    if offset > stand_off:
        return speed
    if offset < -stand_off:
        return -speed
    return 0.0


# --- A tick: players get what it brought ---------------------------------------------------------


@inlined
def _end_tick(s: State, w: int, p: int) -> None:
    """Apply the tick's results to a player: first healing, then bites."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    event = s.events[w, p]
    tick = s.tick[p]
    player.safe = max(player.safe - 1, 0)
    hp = player.hp + tick.healed
    event.hp_gained += hp - player.hp
    player.hp = hp
    if tick.bitten > 0.0 and player.safe == 0:
        player.hp = max(hp - tick.bitten, 0.0)
        player.safe = stats.safe
        event.hp_lost += hp - player.hp
    player.xp += tick.xp
    event.xp_gained += tick.xp
    event.notices += tick.notices
    event.contacts += tick.contacts
    if tick.paid:
        event.reward = player.xp
    event.reward += tick.notices + tick.contacts
    if player.hp <= 0.0:
        player.hp = 0.0
        player.busy = 0
        player.action_kind = 0
        event.died = 1
        _pack(s, w, s.monsters.shape[1] + p)
        _charge(player, event, s.settings[0].ending_cost)


# --- The book of episodes ------------------------------------------------------------------------


@inlined
def record_step(s: State, w: int, actions: Array) -> None:
    """Add a step, with its rewards, to a world's `slots`, `tallies` and `taken`.

    A player's episode ends with its death, or with its world. From the next step until the world ends its
    slot is idle.
    """
    world = s.worlds[w]
    rewards = hp_lost = 0.0
    for p in range(s.players.shape[1]):
        slot, event, has_died = s.slots[w, p], s.events[w, p], s.players[w, p].hp <= 0.0
        present = event.present > 0
        if present:
            slot.returns += event.reward
            slot.lengths += 1
            slot.ending = KILLED if has_died else world.ending
            slot.episodes += slot.ending != RUNNING
            s.taken[w, actions[w, p]] += 1
        slot.begins = slot.ending != RUNNING
        slot.idle = has_died and not present
        rewards += event.reward
        hp_lost += event.hp_lost
    tally = s.tallies[w]
    tally.returns += rewards / s.players.shape[1]
    tally.hp_lost += hp_lost / s.players.shape[1]
    if world.monsters_left == 0 and tally.cleared == 0:
        tally.cleared = world.steps


# --- Moving --------------------------------------------------------------------------------------


@kernel
def moved(
    s: State, w: int, me: int, dx: float, dy: float, stops: int, among_bodies: bool
) -> tuple[float, float]:
    """Return where a body moves, x first, in terrain, and among other bodies if asked for.

    `me` is its index, players after monsters; `stops` has a bit for each code of terrain that stops it.
    """
    x, y, shape = body(s, w, me)
    for axis in range(2):
        distance = dy if axis else dx
        if distance != 0.0:
            there = _moved_along(s, w, me, axis == 0, x, y, shape, distance, stops, among_bodies)
            x, y = (x, there) if axis else (there, y)
    return x, y


@inlined
def _moved_along(
    s: State, w: int, me: int, on_x: bool, x: float, y: float, shape: tuple[float, float, float, float],
    distance: float, stops: int, among_bodies: bool,
) -> float:  # fmt: skip
    """Return x, or y, after a move along it, stopped flush at the first obstacle."""
    start, _ = _turned(on_x, x, y)
    offset, _ = _turned(on_x, shape[0], shape[1])
    middle, aside = _turned(on_x, x + shape[0], y + shape[1])
    half, breadth = _turned(on_x, shape[2], shape[3])
    way = 1.0 if distance > 0.0 else -1.0
    stop = _stop_at_tiles(s, w, on_x, way, middle + distance, half, aside, breadth, stops)
    if among_bodies:
        stop = min(stop, _stop_at_bodies(s, w, me, on_x, way, middle, half, aside, breadth))
    if way * (middle + distance) <= stop:
        return start + distance
    return max(start, stop - offset) if distance > 0.0 else min(start, -stop - offset)


@inlined
def _turned(on_x: bool, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the coordinate along the axis of a move, then the one across it, or the reverse."""
    return (x, y) if on_x else (y, x)


@inlined
def _stop_at_tiles(
    s: State, w: int, on_x: bool, way: float, end: float, half: float, aside: float, breadth: float,
    stops: int,
) -> float:  # fmt: skip
    """Return where a box's centre, times `way`, is flush with the tiles that its leading edge would enter."""
    settings = s.settings[0]
    tile = settings.tile
    corner, corner_aside = _turned(on_x, settings.left, settings.top)
    first = math.floor((aside - breadth - corner_aside) / tile)
    last = math.ceil((aside + breadth - corner_aside) / tile) - 1
    if way > 0.0:
        line = math.ceil((end + half - corner) / tile) - 1
        flush = corner + line * tile - half
    else:
        line = math.floor((end - half - corner) / tile)
        flush = corner + (line + 1) * tile + half
    for other in range(first, last + 1):
        column, row = _turned(on_x, line, other)
        if blocked(s.terrain, s.worlds[w].level, column, row, stops):
            return way * flush
    return math.inf


@inlined
def _stop_at_bodies(
    s: State, w: int, me: int, on_x: bool, way: float, middle: float, half: float, aside: float,
    breadth: float,
) -> float:  # fmt: skip
    """Return where a box's centre, times `way`, touches the first body ahead; it may overlap others."""
    stop = math.inf
    near = s.near[me]
    for i in range(near[0]):
        other = s.boxes[near[i + 1]]
        there, there_aside = _turned(on_x, other[0], other[1])
        other_half, other_breadth = _turned(on_x, other[2], other[3])
        reach = half + other_half
        beside = abs(aside - there_aside) >= breadth + other_breadth - CONTACT_EPS
        if not beside and way * (there - middle) >= reach - CONTACT_EPS:
            stop = min(stop, way * there - reach)
    return stop


@inlined
def _is_near(s: State, w: int, other: int, x: float, y: float) -> bool:
    """Return whether a living body may stop one that is at a point, in this step."""
    reach = s.settings[0].body_reach
    there_x, there_y, _ = body(s, w, other)
    return abs(there_x - x) < reach and abs(there_y - y) < reach and is_alive(s, w, other)


@inlined
def is_alive(s: State, w: int, body: int) -> bool:
    if body < s.monsters.shape[1]:
        return s.monsters[w, body].hp > 0.0
    return s.players[w, body - s.monsters.shape[1]].hp > 0.0


@inlined
def body(s: State, w: int, me: int) -> tuple[float, float, tuple[float, float, float, float]]:
    """Return a body's position, and its shape: the centre from there, and half sides; monsters come first."""
    if me < s.monsters.shape[1]:
        monster = s.monsters[w, me]
        kind = s.monster_stats[s.worlds[w].level, me]
        return monster.x, monster.y, (kind.body_x, kind.body_y, kind.half_width, kind.half_height)
    player = s.players[w, me - s.monsters.shape[1]]
    stats = s.player_stats[me - s.monsters.shape[1]]
    return player.x, player.y, (stats.body_x, stats.body_y, stats.half_width, stats.half_height)


@inlined
def box(s: State, w: int, me: int) -> tuple[float, float, float, float]:
    """Return the centre and half sides of a body."""
    x, y, shape = body(s, w, me)
    return x + shape[0], y + shape[1], shape[2], shape[3]


@inlined
def blocked(terrain: Array, level: int, column: int, row: int, stops: int) -> bool:
    """Return whether a tile stops a body; tiles off the grid do."""
    if column < 0 or row < 0 or row >= terrain.shape[1] or column >= terrain.shape[2]:
        return True
    return (stops >> terrain[level, row, column]) & 1 != 0
