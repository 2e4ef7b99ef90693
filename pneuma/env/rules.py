"""The rules of the world, compiled.

They advance N worlds with P players and M monsters each by agent steps of several ticks of 1/60 s, and write
the observations. The state lies in plain arrays (`state.py`) that `worlds.py` owns. Nothing here allocates
memory. Sources: thesis sections 5.1 to 5.3 and the constants of the published code.

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
from numba import carray, njit, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from pneuma.env.compiled import cached
from pneuma.env.state import (
    EVENTS,
    MONSTER,
    MONSTER_STATS,
    PLAYER,
    PLAYER_STATS,
    SCRATCH,
    SETTINGS,
    TICK,
    WORLD,
    Array,
    State,
)

DOWN, LEFT, UP, RIGHT, ATTACK, FLAME, HEAL = 0, 1, 2, 3, 4, 5, 6
BLADE, DASHING = 1, 2
"""What a busy player does: attack with its sword, or dash."""
OPEN, SOLID, COAST, SLOW = 0, 1, 2, 3
RUNNING, KILLED, CLEARED, TIME_LIMIT = 0, 1, 2, 3
REWARD_THESIS, REWARD_PYGAME, REWARD_GODOT, REWARD_KILLS, REWARD_SIGMOID, REWARD_CUSTOM = 0, 1, 2, 3, 4, 5
LAYOUT_THESIS, LAYOUT_PYGAME, LAYOUT_GODOT = 0, 1, 2

HAIR = 2.0**-10
"""Pixels by which bodies may overlap and still count as touching, as sums of floats are not exact."""
SIGMOID_MIDDLE, SIGMOID_WIDTH = 150.0, 50.0  # pixels

# Only the calls from outside can be called from outside: the code that takes Python's arguments
# apart would take longer to compile than the rules. Nothing allocates, so the others do without
# numba's reference counts, which took half the time of a step.
_INNER: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_UNCOUNTED: Any = {**_INNER, "_nrt": False}
entry: Any = cached(error_model="numpy")
opening: Any = njit(**_INNER, forceinline=True)
kernel: Any = njit(**_UNCOUNTED)
part: Any = njit(**_UNCOUNTED, forceinline=True)
merged: Any = njit(**_UNCOUNTED, inline="always")  # inlined by numba before compiling: for the few large ones
typed_intrinsic: Any = intrinsic


# --- The calls from outside -----------------------------------------------------------------------


@entry
def reset_worlds(handle: Array, chosen: Array, mask: Array) -> None:
    """Start an episode in every world whose `mask` is set.

    Takes the handle of a `State`, `chosen` (N,) and `mask` (N,). Player p of a world takes start place
    `chosen + p`, wrapping around; `chosen` below zero asks for one at random. Where there are several
    levels, one is drawn first.
    """
    s = open_state(handle)
    for w in range(s.worlds.shape[0]):
        if not mask[w]:
            continue
        world = s.worlds[w]
        world.steps = 0
        world.ending = RUNNING
        world.monsters_left = s.monsters.shape[1]
        world.players_left = s.players.shape[1]
        world.level = _draw_below(world, s.starts.shape[0]) if s.starts.shape[0] > 1 else 0
        world.start = chosen[w] if chosen[w] >= 0 else _draw_below(world, s.starts.shape[1])
        for p in range(s.players.shape[1]):
            place = (world.start + p) % s.starts.shape[1]
            _place_player(s.players[w, p], s.player_stats[p], s.settings[0])
            s.players[w, p].x = s.starts[world.level, place, 0]
            s.players[w, p].y = s.starts[world.level, place, 1]
        for m in range(s.monsters.shape[1]):
            _place_monster(s.monsters[w, m], s.monster_stats[world.level, m], s.players.shape[1])


@entry
def step_worlds(handle: Array, actions: Array) -> int:
    """Advance every running world by one agent step, observe it, and return how many ended.

    Takes the handle of a `State` and actions (N, P), whole numbers. A world whose episode has ended stays as
    it is, with empty events, until it is reset.
    """
    s = open_state(handle)
    ended = 0
    for w in range(s.worlds.shape[0]):
        for p in range(s.players.shape[1]):
            _clear(s.events[w, p])
        if s.worlds[w].ending != RUNNING:
            continue
        ended += _step_world(s, w, actions)
        for p in range(s.players.shape[1]):
            _observe(s, w, p, True)
        for p in range(s.players.shape[1]):
            if s.events[w, p].present or s.events[w, p].died:
                _reward(s.players[w, p], s.player_stats[p], s.events[w, p])
    return ended


@entry
def observe_worlds(handle: Array) -> None:
    """Write the observations of every world as it stands."""
    s = open_state(handle)
    for w in range(s.worlds.shape[0]):
        for p in range(s.players.shape[1]):
            _observe(s, w, p, s.worlds[w].ending == RUNNING)


@opening
def open_state(h: Array) -> State:
    """Turn addresses and shapes back into arrays; see `state.make_handle`."""
    return State(
        carray(_pointer(h[0].address), (h[0].shape[0],), WORLD),
        carray(_pointer(h[1].address), (h[1].shape[0], h[1].shape[1]), PLAYER),
        carray(_pointer(h[2].address), (h[2].shape[0], h[2].shape[1]), MONSTER),
        carray(_pointer(h[3].address), (h[3].shape[0],), PLAYER_STATS),
        carray(_pointer(h[4].address), (h[4].shape[0], h[4].shape[1]), MONSTER_STATS),
        carray(_pointer(h[5].address), (h[5].shape[0],), SETTINGS),
        carray(_pointer(h[6].address), (h[6].shape[0], h[6].shape[1], h[6].shape[2]), np.uint8),
        carray(_pointer(h[7].address), (h[7].shape[0], h[7].shape[1], h[7].shape[2]), np.float64),
        carray(_pointer(h[8].address), (h[8].shape[0], h[8].shape[1]), EVENTS),
        carray(_pointer(h[9].address), (h[9].shape[0], h[9].shape[1], h[9].shape[2]), np.float32),
        carray(_pointer(h[10].address), (h[10].shape[0], h[10].shape[1], h[10].shape[2]), np.int8),
        carray(_pointer(h[11].address), (h[11].shape[0],), TICK),
        carray(_pointer(h[12].address), (h[12].shape[0],), SCRATCH),
    )


@typed_intrinsic
def _pointer(context: Any, address: Any) -> Any:
    """Return an integer as an address."""

    def generate(codegen: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], codegen.get_value_type(types.voidptr))

    return types.voidptr(types.int64), generate


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
    event.died = 0
    event.present = 0
    event.distance = math.inf


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
    """Return a random integer in [0, bound), for bounds far below 2**32."""
    high = _draw(world) >> np.uint64(32)
    return np.int64((high * np.uint64(bound)) >> np.uint64(32))


# --- Reset ---------------------------------------------------------------------------------------


@part
def _place_player(player: Array, stats: Array, settings: Array) -> None:
    player.hp = stats.hp
    player.energy = stats.energy
    if not settings.keep_xp:
        player.xp = 0.0
    player.facing = DOWN
    player.busy = 0
    player.armed = 0
    player.attack = 0
    player.safe = 0
    player.kills = 0
    player.rest = 0


@part
def _place_monster(monster: Array, kind: Array, players: int) -> None:
    monster.x = kind.home_x
    monster.y = kind.home_y
    monster.hp = kind.hp
    monster.knocked = 0
    monster.safe = 0
    monster.noticed = 0
    for p in range(players):
        monster.bite[p] = 0
        monster.struck_by[p] = 0


# --- One step ------------------------------------------------------------------------------------


@merged
def _step_world(s: State, w: int, actions: Array) -> bool:
    """Advance one running world by one agent step; return whether its episode ended."""
    world = s.worlds[w]
    settings = s.settings[0]
    count = _gather_active(s, w)
    for _ in range(settings.ticks):
        for p in range(s.players.shape[1]):
            _begin_tick(s, w, p, actions[w, p])
        for i in range(count):
            if s.monsters[w, s.scratch[i].order].hp > 0.0:
                _live(s, w, s.scratch[i].order)
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
    elif world.steps >= settings.step_limit:
        world.ending = TIME_LIMIT
    if world.ending == CLEARED or world.ending == TIME_LIMIT:
        for p in range(s.players.shape[1]):
            if s.players[w, p].hp > 0.0:
                _charge(s.players[w, p], s.events[w, p], settings.ending_cost)
    return world.ending != RUNNING


@part
def _charge(player: Array, event: Array, cost: float) -> None:
    """Subtract the XP that an ending costs; in the published code the reward is then set to the XP."""
    if cost != 0.0:
        player.xp -= cost
        event.xp_gained -= cost
        event.reward = player.xp


@part
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


@part
def _may_stir(s: State, w: int, m: int) -> bool:
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    if monster.knocked > 0 or monster.safe > 0 or monster.noticed:
        return True
    for p in range(s.players.shape[1]):
        if monster.bite[p] > 0:
            return True
        player = s.players[w, p]
        if player.hp > 0.0 and _gap(monster.x, monster.y, player, s.player_stats[p]) <= kind.reach_squared:
            return True
    return False


@part
def _gap(x: float, y: float, player: Array, stats: Array) -> float:
    """Return the squared distance from a point to a player's body."""
    across = max(abs(player.x + stats.body_x - x) - stats.half_width, 0.0)
    down = max(abs(player.y + stats.body_y - y) - stats.half_height, 0.0)
    return across * across + down * down


# --- A tick: players act -------------------------------------------------------------------------


@part
def _begin_tick(s: State, w: int, p: int, action: int) -> None:
    """Let a living player act, and record what it strikes."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    settings = s.settings[0]
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
        if player.armed == BLADE:
            _raise_sword(player, stats, tick)
        elif player.armed == DASHING:
            _dash(s, w, p)
    if player.rest > 0:
        player.rest -= 1
    player.energy = min(player.energy + stats.energy_gain, stats.energy)
    if settings.deadly_coast and _tile_at(s, s.worlds[w].level, player.x, player.y) == COAST:
        tick.there = 0
        tick.strikes = 0
        s.events[w, p].hp_lost += player.hp
        _die(player, s.events[w, p])
    else:
        s.events[w, p].present += 1


@part
def _act(s: State, w: int, p: int, player: Array, stats: Array, action: int) -> None:
    """Let an idle player walk for a tick, or start an attack, a dash, or a spell that it can pay for."""
    if action == s.settings[0].dash:
        if player.rest == 0:
            player.busy = s.settings[0].dash_ticks
            player.rest = s.settings[0].dash_ticks + s.settings[0].dash_rest
            player.armed = DASHING
    elif action == ATTACK:
        player.busy = stats.swing
        player.armed = BLADE
        player.attack += 1
    elif action == FLAME:
        if player.energy >= stats.flame_cost:
            player.energy -= stats.flame_cost
            player.busy = stats.flame_ticks
            player.armed = 0
            _burn(player, stats, s.tick[p])
    elif action == HEAL:
        if player.energy >= stats.heal_cost:
            player.energy -= stats.heal_cost
            player.busy = stats.heal_ticks
            player.armed = 0
            hp = max(player.hp, min(player.hp + stats.heal, stats.hp))
            s.events[w, p].hp_gained += hp - player.hp
            player.hp = hp
    else:
        player.facing = action
        me, stops = s.monsters.shape[1] + p, s.settings[0].player_stops
        dx, dy = _walk(stats.speed, action)
        player.x, player.y = _moved(s, w, me, player.x, player.y, stats, dx, dy, stops)


@kernel
def _dash(s: State, w: int, p: int) -> None:
    """Move a player through one tick of a dash, in the direction it faces."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    dx, dy = _walk(stats.dash_speed, player.facing)
    me, stops = s.monsters.shape[1] + p, s.settings[0].player_stops
    player.x, player.y = _moved(s, w, me, player.x, player.y, stats, dx, dy, stops)


@part
def _walk(speed: float, action: int) -> tuple[float, float]:
    dx = speed if action == RIGHT else -speed if action == LEFT else 0.0
    dy = speed if action == DOWN else -speed if action == UP else 0.0
    return dx, dy


@part
def _raise_sword(player: Array, stats: Array, tick: Array) -> None:
    """Record the box that the sword strikes in this tick."""
    facing = player.facing
    tick.strikes = 1
    tick.box_x = player.x + stats.sword_x[facing]
    tick.box_y = player.y + stats.sword_y[facing]
    tick.half_width = stats.sword_half_width[facing]
    tick.half_height = stats.sword_half_height[facing]
    tick.damage = stats.damage
    tick.hilt_x = player.x + stats.hilt_x[facing]
    tick.hilt_y = player.y + stats.hilt_y[facing]
    tick.knock_speed = stats.knock_speed
    tick.knock_ticks = stats.knock_ticks


@part
def _burn(player: Array, stats: Array, tick: Array) -> None:
    """Record the box that a flame burns, in this tick only; it knocks nobody back."""
    facing = player.facing
    player.attack += 1
    tick.strikes = 1
    tick.box_x = player.x + stats.flame_x[facing]
    tick.box_y = player.y + stats.flame_y[facing]
    tick.half_width = stats.flame_half_width[facing]
    tick.half_height = stats.flame_half_height[facing]
    tick.damage = stats.flame_damage
    tick.knock_ticks = -1


@part
def _die(player: Array, event: Array) -> None:
    player.hp = 0.0
    player.busy = 0
    player.armed = 0
    event.died = 1


# --- A tick: monsters are struck, sense, bite and move -------------------------------------------


@part
def _live(s: State, w: int, m: int) -> None:
    """Run one living monster's tick."""
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    if monster.safe > 0:
        monster.safe -= 1
    for p in range(s.players.shape[1]):
        if not s.tick[p].there:
            monster.noticed &= ~np.uint8(1 << p)
            monster.bite[p] = 0
        elif s.tick[p].strikes and _is_struck(s.tick[p], monster, kind):
            _suffer(s, w, m, p)
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
        stops = s.settings[0].monster_stops
        monster.x, monster.y = _moved(s, w, m, monster.x, monster.y, kind, dx, dy, stops)


@part
def _is_struck(tick: Array, monster: Array, kind: Array) -> bool:
    """Return whether what strikes in this tick overlaps a monster's body."""
    across = abs(monster.x + kind.body_x - tick.box_x) < tick.half_width + kind.half_width
    return across and abs(monster.y + kind.body_y - tick.box_y) < tick.half_height + kind.half_height


@part
def _suffer(s: State, w: int, m: int, p: int) -> None:
    """Apply a player's blow, unless this attack has hit the monster already or the monster is safe."""
    monster = s.monsters[w, m]
    if monster.struck_by[p] == s.players[w, p].attack or monster.safe > 0 or monster.hp <= 0.0:
        return
    kind = s.monster_stats[s.worlds[w].level, m]
    tick = s.tick[p]
    monster.struck_by[p] = s.players[w, p].attack
    monster.safe = kind.safe
    monster.hp = max(monster.hp - tick.damage, 0.0)
    s.events[w, p].hits += 1
    if monster.hp <= 0.0:
        _pay(s, w, m, p)
    elif tick.knock_ticks >= 0 and monster.knocked == 0:
        _knock_back(monster, kind, tick)


@part
def _knock_back(monster: Array, kind: Array, tick: Array) -> None:
    """Start a flight away from the hilt; a flight in progress is neither turned nor extended."""
    away_x = monster.x - tick.hilt_x
    away_y = monster.y - tick.hilt_y
    length = math.sqrt(away_x * away_x + away_y * away_y)
    has_knock = kind.knock_ticks >= 0
    speed = kind.knock_speed if has_knock else tick.knock_speed
    monster.knock_x = away_x / length * speed if length > 0.0 else 0.0
    monster.knock_y = away_y / length * speed if length > 0.0 else 0.0
    monster.knocked = kind.knock_ticks if has_knock else tick.knock_ticks


@part
def _pay(s: State, w: int, m: int, striker: int) -> None:
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


@part
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
        if monster.knocked > 0 and not s.settings[0].bite_while_knocked:
            monster.bite[p] = 1  # due as soon as it has landed
        else:
            monster.bite[p] = kind.bite_ticks
            if stats.safe == 0 or tick.bitten == 0.0:  # one bite a tick for who is safe after it
                tick.bitten += kind.damage
    return gap


@part
def _approach(offset: float, stand_off: float, speed: float) -> float:
    """Return a monster's move on one axis towards a player that is `offset` away."""
    if offset > stand_off:
        return speed
    if offset < -stand_off:
        return -speed
    return 0.0


# --- A tick: players get what it brought ---------------------------------------------------------


@part
def _end_tick(s: State, w: int, p: int) -> None:
    """Apply the tick's results to a player: first healing, then bites."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    event = s.events[w, p]
    tick = s.tick[p]
    player.safe = max(player.safe - 1, 0)
    hp = player.hp + tick.healed
    if s.settings[0].healing_cap:
        hp = max(player.hp, min(hp, stats.hp))
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
        _die(player, event)
        _charge(player, event, s.settings[0].ending_cost)


@part
def _reward(player: Array, stats: Array, event: Array) -> None:
    """Write a player's reward; `reward.py` describes the formulas."""
    if stats.reward == REWARD_THESIS:
        event.reward = player.xp - player.hp / stats.hp
    elif stats.reward == REWARD_PYGAME:
        event.reward = player.xp + player.hp / stats.hp
    elif stats.reward == REWARD_KILLS:
        event.reward = event.xp_gained - event.hp_lost / stats.hp
    elif stats.reward == REWARD_SIGMOID:
        event.reward = event.xp_gained + _closeness(event.distance)
    # REWARD_GODOT has been kept event by event; REWARD_CUSTOM is computed outside.


@part
def _closeness(distance: float) -> float:
    """Return an algebraic sigmoid of the distance: 1 at a monster, 1/2 in the middle, 0 far away."""
    if distance == math.inf:
        return 0.0
    z = (SIGMOID_MIDDLE - distance) / SIGMOID_WIDTH
    return 0.5 + 0.5 * z / math.sqrt(1.0 + z * z)


# --- Moving --------------------------------------------------------------------------------------


@part
def _moved(
    s: State, w: int, me: int, x: float, y: float, shape: Array, dx: float, dy: float, stops: int
) -> tuple[float, float]:
    """Return where a body moves, x first, among terrain and other bodies; slower on slow ground.

    `me` is its index, players after monsters, or -1 if no other body stops it; `shape` its stats; `stops`
    the tiles that stop it.
    """
    slow = s.settings[0].slow_factor
    if slow < 1.0 and _tile_at(s, s.worlds[w].level, x + shape.body_x, y + shape.body_y) == SLOW:
        dx *= slow
        dy *= slow
    if dx != 0.0:
        x = _moved_along(s, w, me, True, x, y, shape, dx, stops)
    if dy != 0.0:
        y = _moved_along(s, w, me, False, x, y, shape, dy, stops)
    return x, y


@part
def _tile_at(s: State, level: int, x: float, y: float) -> int:
    """Return the terrain at a point."""
    settings = s.settings[0]
    return s.terrain[level, int((y - settings.top) / settings.tile), int((x - settings.left) / settings.tile)]


@kernel
def _moved_along(
    s: State, w: int, me: int, on_x: bool, x: float, y: float, shape: Array, distance: float, stops: int
) -> float:
    """Return x, or y, after a move along it, stopped flush at the first obstacle."""
    start, _ = _turned(on_x, x, y)
    offset, _ = _turned(on_x, shape.body_x, shape.body_y)
    middle, aside = _turned(on_x, x + shape.body_x, y + shape.body_y)
    half, breadth = _turned(on_x, shape.half_width, shape.half_height)
    way = 1.0 if distance > 0.0 else -1.0
    stop = _stop_at_tiles(s, w, on_x, way, middle + distance, half, aside, breadth, stops)
    if s.settings[0].bodies_block and me >= 0:
        stop = min(stop, _stop_at_bodies(s, w, me, on_x, way, middle, half, aside, breadth))
    if way * (middle + distance) <= stop:
        return start + distance
    return max(start, stop - offset) if distance > 0.0 else min(start, -stop - offset)


@part
def _turned(on_x: bool, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the coordinate along the axis of a move, then the one across it, or the reverse."""
    return (x, y) if on_x else (y, x)


@part
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
        if _blocked(s.terrain, s.worlds[w].level, column, row, stops):
            return way * flush
    return math.inf


@part
def _stop_at_bodies(
    s: State, w: int, me: int, on_x: bool, way: float, middle: float, half: float, aside: float,
    breadth: float,
) -> float:  # fmt: skip
    """Return where a box's centre, times `way`, touches the first body ahead; it may overlap others."""
    stop = math.inf
    for other in range(s.monsters.shape[1] + s.players.shape[1]):
        if other != me and _is_alive(s, w, other):
            there_x, there_y, half_width, half_height = _box(s, w, other)
            there, there_aside = _turned(on_x, there_x, there_y)
            other_half, other_breadth = _turned(on_x, half_width, half_height)
            reach = half + other_half
            beside = abs(aside - there_aside) >= breadth + other_breadth - HAIR
            if not beside and way * (there - middle) >= reach - HAIR:
                stop = min(stop, way * there - reach)
    return stop


@part
def _is_alive(s: State, w: int, body: int) -> bool:
    if body < s.monsters.shape[1]:
        return s.monsters[w, body].hp > 0.0
    return s.players[w, body - s.monsters.shape[1]].hp > 0.0


@part
def _box(s: State, w: int, body: int) -> tuple[float, float, float, float]:
    """Return the centre and half sides of a body, monsters first, then players."""
    if body < s.monsters.shape[1]:
        monster = s.monsters[w, body]
        kind = s.monster_stats[s.worlds[w].level, body]
        return monster.x + kind.body_x, monster.y + kind.body_y, kind.half_width, kind.half_height
    player = s.players[w, body - s.monsters.shape[1]]
    stats = s.player_stats[body - s.monsters.shape[1]]
    return player.x + stats.body_x, player.y + stats.body_y, stats.half_width, stats.half_height


@part
def _blocked(terrain: Array, level: int, column: int, row: int, stops: int) -> bool:
    """Return whether a tile stops a body; tiles off the grid do."""
    if column < 0 or row < 0 or row >= terrain.shape[1] or column >= terrain.shape[2]:
        return True
    return (stops >> terrain[level, row, column]) & 1 != 0


# --- Observation ---------------------------------------------------------------------------------


@merged
def _observe(s: State, w: int, p: int, tell: bool) -> None:
    """Write a player's observation and action mask; layouts in `observation.py`.

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
        out[2] = (player.facing == RIGHT) - (player.facing == LEFT)
        out[3] = (player.facing == DOWN) - (player.facing == UP)
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
            if body != monsters + p and _is_alive(s, w, body):
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
    middle_x, middle_y, half_width, half_height = _box(s, w, body)
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
    stops = settings.player_stops | 1 << COAST
    column = math.floor((x - settings.left) / settings.tile)
    row = math.floor((y - settings.top) / settings.tile)
    step_x = 1 if dx > 0.0 else -1
    step_y = 1 if dy > 0.0 else -1
    distance = 0.0
    while not _blocked(s.terrain, level, column, row, stops):
        line_x = settings.left + (column + (dx > 0.0)) * settings.tile
        line_y = settings.top + (row + (dy > 0.0)) * settings.tile
        to_x = (line_x - x) / dx if dx != 0.0 else math.inf
        to_y = (line_y - y) / dy if dy != 0.0 else math.inf
        distance = max(min(to_x, to_y), 0.0)
        if to_x == to_y and (
            _blocked(s.terrain, level, column + step_x, row, stops)
            or _blocked(s.terrain, level, column, row + step_y, stops)
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
    ahead = free and _may_walk(s, w, p, player.facing)
    s.masks[w, p, player.facing] = ahead
    s.masks[w, p, ATTACK] = 1
    dash = s.settings[0].dash
    if dash >= 0:
        s.masks[w, p, dash] = ahead and player.rest < s.settings[0].ticks  # up to the step's last tick
    if s.masks.shape[2] > HEAL:
        energy = player.energy
        for _ in range(s.settings[0].ticks - 1):  # a spell may begin up to the step's last tick
            energy = min(energy + stats.energy_gain, stats.energy)
        s.masks[w, p, FLAME] = free and energy >= stats.flame_cost
        s.masks[w, p, HEAL] = free and energy >= stats.heal_cost


@part
def _may_walk(s: State, w: int, p: int, action: int) -> bool:
    """Return whether terrain lets a player walk for a tick; bodies are ignored, as they may move."""
    player = s.players[w, p]
    stats = s.player_stats[p]
    dx, dy = _walk(stats.speed, action)
    x, y = _moved(s, w, -1, player.x, player.y, stats, dx, dy, s.settings[0].player_stops)
    return x != player.x or y != player.y
