"""The rules of the world: every compiled kernel, in one module.

N worlds x P players x M monsters advance here, tick by tick, and are observed. State lies in plain
arrays (`state.py`), which `worlds.py` owns and hands in; nothing here allocates. Sources: thesis
sections 5.1 to 5.3 and the constants of the published code.

One tick goes: players act, swords strike, every monster senses and bites, then moves.

All kernels stay in this file because the compile cache watches only the file that a kernel is in.
The dynamics use only + - * / and square root, without fast-math, so that every processor gives
the same bits.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from pneuma.env.state import Array, State

DOWN, LEFT, UP, RIGHT, ATTACK = 0, 1, 2, 3, 4
OPEN, SOLID, COAST = 0, 1, 2
RUNNING, KILLED, CLEARED, TIME_LIMIT = 0, 1, 2, 3

# Nothing allocates, so the kernels do without numba's reference counts; with them, counting took
# half the time of a step.
_OPTIONS: Any = {"cache": True, "error_model": "numpy", "_nrt": False}
kernel = njit(**_OPTIONS)
part = njit(**_OPTIONS, forceinline=True)


# --- The three calls ------------------------------------------------------------------------------


@kernel
def reset_worlds(
    worlds: Array,
    players: Array,
    monsters: Array,
    player_stats: Array,
    monster_stats: Array,
    starts: Array,
    chosen: Array,
    mask: Array,
) -> None:
    """Begin an episode in every world whose `mask` is set.

    Player p of a world takes start place `chosen + p`, wrapping around; `chosen` below zero asks
    for one at random. Shapes: starts (S, 2), chosen (N,), mask (N,); the others as in `State`.
    """
    for w in range(worlds.shape[0]):
        if not mask[w]:
            continue
        world = worlds[w]
        world.steps = 0
        world.ending = RUNNING
        world.monsters_left = monsters.shape[1]
        world.players_left = players.shape[1]
        world.start = chosen[w] if chosen[w] >= 0 else _draw_below(world, starts.shape[0])
        for p in range(players.shape[1]):
            place = (world.start + p) % starts.shape[0]
            _place_player(players[w, p], player_stats[p], starts[place, 0], starts[place, 1])
        for m in range(monsters.shape[1]):
            _place_monster(monsters[w, m], monster_stats[m], players.shape[1])


@kernel
def step_worlds(
    worlds: Array,
    players: Array,
    monsters: Array,
    player_stats: Array,
    monster_stats: Array,
    settings: Array,
    terrain: Array,
    room: Array,
    events: Array,
    observations: Array,
    scratch: Array,
    actions: Array,
) -> int:
    """Advance every running world by one agent step, observe it, and count those that ended.

    Takes the arrays of `State` and actions (N, P), whole numbers. A world whose episode has ended
    stays as it is, with empty events, until it is reset.
    """
    state = State(
        worlds, players, monsters, player_stats, monster_stats, settings, terrain, room,
        events, observations, scratch,
    )  # fmt: skip
    ended = 0
    for w in range(worlds.shape[0]):
        for p in range(players.shape[1]):
            _clear(events[w, p])
        if worlds[w].ending == RUNNING:
            ended += _step_world(state, w, actions)
    _observe(worlds, players, monsters, player_stats, monster_stats, settings, observations, scratch)
    return ended


@kernel
def observe_worlds(
    worlds: Array,
    players: Array,
    monsters: Array,
    player_stats: Array,
    monster_stats: Array,
    settings: Array,
    terrain: Array,
    room: Array,
    events: Array,
    observations: Array,
    scratch: Array,
) -> None:
    """Write every player's observation; takes the arrays of `State`, layout in `observation.py`."""
    _observe(worlds, players, monsters, player_stats, monster_stats, settings, observations, scratch)


# --- Random numbers ------------------------------------------------------------------------------


@part
def _draw(world: Array) -> Any:
    """Return the next 64 random bits of a world: splitmix64 at (key, counter).

    Steele, Lea and Flood (2014), "Fast splittable pseudorandom number generators".
    """
    world.draws += np.uint64(1)
    z = world.key + world.draws * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@part
def _draw_below(world: Array, bound: int) -> Any:
    """Return a random whole number in [0, bound), for bounds far below 2**32."""
    high = _draw(world) >> np.uint64(32)
    return np.int64((high * np.uint64(bound)) >> np.uint64(32))


# --- Reset ---------------------------------------------------------------------------------------


@part
def _place_player(player: Array, stats: Array, x: float, y: float) -> None:
    player.x = x
    player.y = y
    player.hp = stats.hp
    player.xp = 0.0
    player.facing = DOWN
    player.swing = 0
    player.kills = 0


@part
def _place_monster(monster: Array, kind: Array, players: int) -> None:
    monster.x = kind.home_x
    monster.y = kind.home_y
    monster.hp = kind.hp
    monster.knocked = 0
    monster.noticed = 0
    monster.struck = 0
    for p in range(players):
        monster.bite[p] = 0


# --- One step ------------------------------------------------------------------------------------


@part
def _step_world(s: State, w: int, actions: Array) -> bool:
    """Advance one running world by one agent step; tell whether its episode ended."""
    world = s.worlds[w]
    settings = s.settings[0]
    count = _gather_active(s, w)
    for _ in range(settings.ticks):
        _tick(s, w, count, actions)
        _note_deaths(s, w)
        world.ending = _ending(world, settings)
        if world.ending != RUNNING:
            break
    world.steps += 1
    if world.ending == RUNNING and world.steps >= settings.step_limit:
        world.ending = TIME_LIMIT
    for p in range(s.players.shape[1]):
        player = s.players[w, p]
        s.events[w, p].reward = player.xp - player.hp / s.player_stats[p].hp  # thesis section 5.3
    return world.ending != RUNNING


@part
def _clear(event: Array) -> None:
    """Empty a player's events before a step."""
    event.reward = 0.0
    event.xp_gained = 0.0
    event.hp_lost = 0.0
    event.hp_gained = 0.0
    event.hits = 0
    event.kills = 0
    event.notices = 0
    event.contacts = 0


@part
def _gather_active(s: State, w: int) -> int:
    """List in `scratch` the monsters to which anything can happen in the next step; count them.

    One that flies, or that a player may come near, needs its ticks; the others would only stand
    still. Leaving them out changes no bit and saves most of the time.
    """
    count = 0
    for m in range(s.monsters.shape[1]):
        if s.monsters[w, m].hp > 0.0 and _may_stir(s, w, m):
            s.scratch[count].order = m
            count += 1
    return count


@part
def _may_stir(s: State, w: int, m: int) -> bool:
    monster = s.monsters[w, m]
    kind = s.monster_stats[m]
    if monster.knocked > 0 or monster.noticed:
        return True
    for p in range(s.players.shape[1]):
        player = s.players[w, p]
        if _gap(monster, player, s.player_stats[p]) <= kind.reach * kind.reach and player.hp > 0.0:
            return True
    return False


@part
def _note_deaths(s: State, w: int) -> None:
    """Count the players that live and let the monsters forget those that died."""
    left = 0
    for p in range(s.players.shape[1]):
        left += s.players[w, p].hp > 0.0
    if left == s.worlds[w].players_left:
        return
    s.worlds[w].players_left = left
    for m in range(s.monsters.shape[1]):
        for p in range(s.players.shape[1]):
            if s.players[w, p].hp <= 0.0:
                s.monsters[w, m].noticed &= ~np.uint8(1 << p)
                s.monsters[w, m].bite[p] = 0


@part
def _ending(world: Array, settings: Array) -> int:
    """Return how the episode has ended, if it has."""
    if world.players_left == 0:
        return KILLED
    if world.monsters_left == 0 and settings.end_on_clear:
        return CLEARED
    return RUNNING


# --- One tick ------------------------------------------------------------------------------------


@part
def _tick(s: State, w: int, count: int, actions: Array) -> None:
    """Advance one world by 1/60 s; the first `count` of `scratch` are the monsters that may stir."""
    for p in range(s.players.shape[1]):
        if s.players[w, p].hp > 0.0:
            _tick_player(s, w, p, count, actions[w, p])
    for i in range(count):
        m = s.scratch[i].order
        if s.monsters[w, m].hp > 0.0:
            _tick_monster(s, w, m)


@part
def _tick_player(s: State, w: int, p: int, count: int, action: int) -> None:
    """Let a player walk or begin a swing, unless one is under way; then let the sword strike."""
    player = s.players[w, p]
    bit = np.uint8(1 << p)
    if player.swing == 0 and action == ATTACK:
        player.swing = s.player_stats[p].swing
        for m in range(s.monsters.shape[1]):
            s.monsters[w, m].struck &= ~bit
    elif player.swing == 0:
        _walk(s, player, s.player_stats[p], action)
    if player.swing == 0:
        return
    player.swing -= 1
    for i in range(count):
        m = s.scratch[i].order
        if s.monsters[w, m].hp > 0.0:
            _strike(s, w, p, m, bit)


@part
def _walk(s: State, player: Array, stats: Array, action: int) -> None:
    """Turn and move one tick."""
    player.facing = action
    if action == LEFT:
        _move(s, player, stats, -stats.speed, 0.0)
    elif action == RIGHT:
        _move(s, player, stats, stats.speed, 0.0)
    elif action == UP:
        _move(s, player, stats, 0.0, -stats.speed)
    else:
        _move(s, player, stats, 0.0, stats.speed)


@part
def _strike(s: State, w: int, p: int, m: int, bit: int) -> None:
    """Hit a monster if the sword box overlaps its body and this swing has not hit it yet."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    monster = s.monsters[w, m]
    kind = s.monster_stats[m]
    facing = player.facing
    x = abs(monster.x - (player.x + stats.sword_x[facing]))
    y = abs(monster.y - (player.y + stats.sword_y[facing]))
    meets = (
        x < stats.sword_half_width[facing] + kind.half_width
        and y < stats.sword_half_height[facing] + kind.half_height
    )
    if meets and not monster.struck & bit:
        monster.struck |= bit
        _land_blow(s.worlds[w], player, stats, monster, kind, s.events[w, p])


@kernel
def _land_blow(world: Array, player: Array, stats: Array, monster: Array, kind: Array, events: Array) -> None:
    """Hurt a monster with a player's sword and knock it back, away from the sword.

    The one who lands the last blow earns the monster's XP and HP (thesis sections 5.1 and 5.3).
    """
    monster.hp -= stats.damage
    events.hits += 1
    if monster.hp > 0.0:
        _knock_back(player, stats, monster)
        return
    monster.hp = 0.0
    world.monsters_left -= 1
    healed = min(player.hp + kind.heal, stats.hp) - player.hp
    player.hp += healed
    player.xp += kind.xp
    player.kills += 1
    events.hp_gained += healed
    events.xp_gained += kind.xp
    events.kills += 1


@part
def _knock_back(player: Array, stats: Array, monster: Array) -> None:
    """Send a monster flying from the centre of the sword box; if it is there, the way faced."""
    x = monster.x - (player.x + stats.sword_x[player.facing])
    y = monster.y - (player.y + stats.sword_y[player.facing])
    if x == 0.0 and y == 0.0:
        x = stats.sword_x[player.facing]
        y = stats.sword_y[player.facing]
    length = math.sqrt(x * x + y * y)
    monster.knock_x = x / length * stats.knock_speed
    monster.knock_y = y / length * stats.knock_speed
    monster.knocked = stats.knock_ticks


@part
def _tick_monster(s: State, w: int, m: int) -> None:
    """Let a living monster sense every player, then fly back from a blow or chase the nearest."""
    monster = s.monsters[w, m]
    kind = s.monster_stats[m]
    target = -1
    nearest = math.inf
    for p in range(s.players.shape[1]):
        player = s.players[w, p]
        if player.hp <= 0.0:
            continue
        gap = _gap(monster, player, s.player_stats[p])
        noticed = _sense(monster, kind, player, p, gap, s.events[w, p])
        if noticed and gap < nearest:
            nearest = gap
            target = p
    if monster.knocked > 0:
        monster.knocked -= 1
        _move(s, monster, kind, monster.knock_x, monster.knock_y)
    elif target >= 0:
        dx = _approach(s.players[w, target].x - monster.x, kind.stand_off, kind.speed)
        dy = _approach(s.players[w, target].y - monster.y, kind.stand_off, kind.speed)
        if dx != 0.0 or dy != 0.0:
            _move(s, monster, kind, dx, dy)


@part
def _gap(monster: Array, player: Array, stats: Array) -> float:
    """Return the squared distance from a monster's centre to a player's body box."""
    x = max(abs(player.x - monster.x) - stats.half_width, 0.0)
    y = max(abs(player.y - monster.y) - stats.half_height, 0.0)
    return x * x + y * y


@part
def _sense(monster: Array, kind: Array, player: Array, p: int, gap: float, events: Array) -> bool:
    """Notice a player, and bite one within reach: at once, then at every interval.

    Returns whether the player is inside the notice circle. `gap` is squared.
    """
    bit = np.uint8(1 << p)
    noticed = gap <= kind.notice * kind.notice
    if not noticed:
        monster.noticed &= ~bit
    elif not monster.noticed & bit:
        monster.noticed |= bit
        events.notices += 1
    if gap > kind.attack * kind.attack:
        monster.bite[p] = 0
        return noticed
    if monster.bite[p] == 0:
        events.contacts += 1
        monster.bite[p] = 1
    monster.bite[p] -= 1
    if monster.bite[p] == 0:
        monster.bite[p] = kind.bite_ticks
        lost = min(kind.damage, player.hp)
        player.hp -= lost
        events.hp_lost += lost
    return noticed


@part
def _approach(offset: float, stand_off: float, speed: float) -> float:
    """Return a monster's step on one axis towards a player that is `offset` away."""
    if offset > stand_off:
        return speed
    if offset < -stand_off:
        return -speed
    return 0.0


# --- Moving among tiles --------------------------------------------------------------------------


@part
def _move(s: State, body: Array, stats: Array, dx: float, dy: float) -> None:
    """Move a player or monster, x first, among the tiles that block."""
    settings = s.settings[0]
    column = int((body.x - settings.left) * settings.cells_per_pixel)
    row = int((body.y - settings.top) * settings.cells_per_pixel)
    if s.room[row, column]:  # nothing near enough to meet
        body.x += dx
        body.y += dy
        return
    if dx != 0.0:
        body.x = _slide_x(s.terrain, settings, body.x, body.y, stats.half_width, stats.half_height, dx)
    if dy != 0.0:
        body.y = _slide_y(s.terrain, settings, body.x, body.y, stats.half_width, stats.half_height, dy)


@kernel
def _slide_x(
    terrain: Array, settings: Array, x: float, y: float, half_width: float, half_height: float, dx: float
) -> float:
    """Return x after moving by dx, stopped flush at the first tile that blocks."""
    tile = settings.tile
    first = math.floor((y - half_height - settings.top) / tile)
    last = math.ceil((y + half_height - settings.top) / tile) - 1
    if dx > 0:
        column = math.ceil((x + dx + half_width - settings.left) / tile) - 1
        for row in range(first, last + 1):
            if _blocked(terrain, column, row):
                return max(x, settings.left + column * tile - half_width)
    else:
        column = math.floor((x + dx - half_width - settings.left) / tile)
        for row in range(first, last + 1):
            if _blocked(terrain, column, row):
                return min(x, settings.left + (column + 1) * tile + half_width)
    return x + dx


@kernel
def _slide_y(
    terrain: Array, settings: Array, x: float, y: float, half_width: float, half_height: float, dy: float
) -> float:
    """Return y after moving by dy, stopped flush at the first tile that blocks."""
    tile = settings.tile
    first = math.floor((x - half_width - settings.left) / tile)
    last = math.ceil((x + half_width - settings.left) / tile) - 1
    if dy > 0:
        row = math.ceil((y + dy + half_height - settings.top) / tile) - 1
        for column in range(first, last + 1):
            if _blocked(terrain, column, row):
                return max(y, settings.top + row * tile - half_height)
    else:
        row = math.floor((y + dy - half_height - settings.top) / tile)
        for column in range(first, last + 1):
            if _blocked(terrain, column, row):
                return min(y, settings.top + (row + 1) * tile + half_height)
    return y + dy


@part
def _blocked(terrain: Array, column: int, row: int) -> bool:
    """Tell whether a tile stops a body; what lies off the grid does."""
    if column < 0 or row < 0 or row >= terrain.shape[0] or column >= terrain.shape[1]:
        return True
    return terrain[row, column] != OPEN


# --- Observation ---------------------------------------------------------------------------------


@kernel
def _observe(
    worlds: Array,
    players: Array,
    monsters: Array,
    player_stats: Array,
    monster_stats: Array,
    settings_row: Array,
    observations: Array,
    scratch: Array,
) -> None:
    settings = settings_row[0]
    for w in range(worlds.shape[0]):
        for p in range(players.shape[1]):
            player = players[w, p]
            observations[w, p, 0] = (player.x - settings.middle_x) * settings.scale_x
            observations[w, p, 1] = (player.y - settings.middle_y) * settings.scale_y
            observations[w, p, 2] = player.hp / player_stats[p].hp
            observations[w, p, 3] = player.xp * settings.xp_scale
            living = _nearest_first(w, monsters, player, scratch)
            for i in range(living):
                monster = monsters[w, scratch[i].order]
                kind = monster_stats[scratch[i].order]
                length = scratch[i].distance
                inverse = 1.0 / length if length > 0.0 else 0.0
                observations[w, p, 4 + 4 * i] = length * kind.distance_scale
                observations[w, p, 5 + 4 * i] = (monster.x - player.x) * inverse
                observations[w, p, 6 + 4 * i] = (monster.y - player.y) * inverse
                observations[w, p, 7 + 4 * i] = monster.hp * kind.hp_scale
            for i in range(4 + 4 * living, 4 + 4 * monsters.shape[1]):
                observations[w, p, i] = 0.0  # the dead come last, as zeros


@part
def _nearest_first(w: int, monsters: Array, player: Array, scratch: Array) -> int:
    """Sort the living monsters by distance, ties by index; return how many there are.

    An insertion sort: for 14 items it is several times faster than numpy.argsort.
    """
    living = 0
    for m in range(monsters.shape[1]):
        if monsters[w, m].hp <= 0.0:
            continue
        x = monsters[w, m].x - player.x
        y = monsters[w, m].y - player.y
        length = math.sqrt(x * x + y * y)
        i = living
        while i > 0 and scratch[i - 1].distance > length:
            scratch[i].distance = scratch[i - 1].distance
            scratch[i].order = scratch[i - 1].order
            i -= 1
        scratch[i].distance = length
        scratch[i].order = m
        living += 1
    return living
