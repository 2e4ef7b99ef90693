"""The rules of the world: every compiled kernel, in one module.

N worlds x P players x M monsters advance here by agent steps of several ticks of 1/60 s, and are
observed. State lies in plain arrays (`state.py`), which `worlds.py` owns and hands in; nothing here
allocates. Sources: thesis sections 5.1 to 5.3 and the constants of the published code.

A tick goes, by the book: every player acts; swords and flames strike; every monster senses, bites,
then moves. Bodies pass through each other, so monsters meet nobody but players, and players only
lose or gain HP by them. A step can therefore be told in three parts, each simpler and faster than
tick by tick, with the same bits:

1. Players walk their path through all ticks (`_walk_path`).
2. Each monster lives through the ticks along those paths (`_live_step`), and what it does to players
   is noted in a ledger by tick.
3. The ledger is settled in the order of time (`_settle`). If it turns out that a player died, the
   monsters go back and live the step again without him from the next tick on.

All kernels stay in this file because the compile cache watches only the file that a kernel is in.
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
    CHASE,
    EVENTS,
    LANES,
    LEDGER,
    MONSTER,
    MONSTER_STATS,
    PATH,
    PLAYER,
    PLAYER_STATS,
    SCRATCH,
    SETTINGS,
    WORLD,
    Array,
    State,
)

DOWN, LEFT, UP, RIGHT, ATTACK, FLAME, HEAL = 0, 1, 2, 3, 4, 5, 6
OPEN, SOLID, COAST = 0, 1, 2
RUNNING, KILLED, CLEARED, TIME_LIMIT = 0, 1, 2, 3
REWARD_THESIS, REWARD_PYGAME, REWARD_GODOT, REWARD_KILLS, REWARD_SIGMOID, REWARD_CUSTOM = 0, 1, 2, 3, 4, 5
LAYOUT_THESIS, LAYOUT_PYGAME, LAYOUT_GODOT = 0, 1, 2

COAST_BLOCKS = np.int64(1)  # typed: for the compiler, a plain 1 would be another function
SIGMOID_MIDDLE, SIGMOID_WIDTH = 150.0, 50.0  # pixels

# Only the two calls from outside can be called from outside: the code that takes Python's arguments
# apart would take longer to compile than the rules. Nothing allocates, so the others do without
# numba's reference counts, which took half the time of a step.
_INNER: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_UNCOUNTED: Any = {**_INNER, "_nrt": False}
entry: Any = cached(error_model="numpy")
opening: Any = njit(**_INNER, forceinline=True)
kernel: Any = njit(**_UNCOUNTED)
part: Any = njit(**_UNCOUNTED, forceinline=True)
merged: Any = njit(**_UNCOUNTED, inline="always")  # by numba, before compiling: for the few large ones
typed_intrinsic: Any = intrinsic


# --- The three calls ------------------------------------------------------------------------------


@entry
def reset_worlds(handle: Array, chosen: Array, mask: Array) -> None:
    """Begin an episode in every world whose `mask` is set.

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
def step_worlds(handle: Array, actions: Array, only_observe: bool) -> int:
    """Advance every running world by one agent step, observe it, and count those that ended.

    Takes the handle of a `State` and actions (N, P), whole numbers. A world whose episode has ended
    stays as it is, with empty events, until it is reset. With `only_observe` no time passes.
    """
    s = open_state(handle)
    ended = 0
    for w in range(s.worlds.shape[0]):
        running = s.worlds[w].ending == RUNNING and not only_observe
        for p in range(s.players.shape[1]):
            if not only_observe:
                _clear(s.events[w, p])
        if running:
            ended += _step_world(s, w, actions)
        for p in range(s.players.shape[1]):
            if running or only_observe:
                _observe(s, w, p, s.worlds[w].ending == RUNNING or running)
        for p in range(s.players.shape[1]):
            if running and (s.events[w, p].present or s.events[w, p].died):
                _reward(s.players[w, p], s.player_stats[p], s.events[w, p])
    return ended


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
        carray(_pointer(h[7].address), (h[7].shape[0], h[7].shape[1], h[7].shape[2]), np.uint8),
        carray(_pointer(h[8].address), (h[8].shape[0], h[8].shape[1], h[8].shape[2]), np.float64),
        carray(_pointer(h[9].address), (h[9].shape[0], h[9].shape[1]), EVENTS),
        carray(_pointer(h[10].address), (h[10].shape[0], h[10].shape[1], h[10].shape[2]), np.float32),
        carray(_pointer(h[11].address), (h[11].shape[0], h[11].shape[1], h[11].shape[2]), np.int8),
        carray(_pointer(h[12].address), (h[12].shape[0], h[12].shape[1]), PATH),
        carray(_pointer(h[13].address), (h[13].shape[0], h[13].shape[1]), LEDGER),
        carray(_pointer(h[14].address), (h[14].shape[0],), MONSTER),
        carray(_pointer(h[15].address), (h[15].shape[0],), SCRATCH),
        carray(_pointer(h[16].address), (h[16].shape[0],), CHASE),
    )


@typed_intrinsic
def _pointer(context: Any, address: Any) -> Any:
    """Read a whole number as an address."""

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
    """Return a random whole number in [0, bound), for bounds far below 2**32."""
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
    """Advance one running world by one agent step; tell whether its episode ended."""
    world = s.worlds[w]
    settings = s.settings[0]
    count = _gather_active(s, w)
    for p in range(s.players.shape[1]):
        if s.players[w, p].hp > 0.0:
            _walk_path(s, w, p, actions[w, p], count > 0)
    if count > 0:
        _live_through(s, w, count)
    world.players_left = 0
    for p in range(s.players.shape[1]):
        if s.events[w, p].present > 0 or s.events[w, p].died:
            _settle(s, w, p, count > 0 and s.ledger[0, p].written != 0)
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
    """Take the XP that an ending costs; the published code then sets the reward to the XP."""
    if cost != 0.0:
        player.xp -= cost
        event.xp_gained -= cost
        event.reward = player.xp


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
    kind = s.monster_stats[s.worlds[w].level, m]
    if monster.knocked > 0 or monster.safe > 0 or monster.noticed:
        return True
    for p in range(s.players.shape[1]):
        if monster.bite[p] > 0:
            return True
        player = s.players[w, p]
        gap = _gap(monster.x, monster.y, player.x, player.y, s.player_stats[p])
        if gap <= kind.reach_squared and player.hp > 0.0:
            return True
    return False


@part
def _gap(x: float, y: float, player_x: float, player_y: float, stats: Array) -> float:
    """Return the squared distance from a monster's centre to a player's body box."""
    across = max(abs(player_x - x) - stats.half_width, 0.0)
    down = max(abs(player_y - y) - stats.half_height, 0.0)
    return across * across + down * down


# --- Part 1: players walk ------------------------------------------------------------------------


@part
def _walk_path(s: State, w: int, p: int, action: int, noted: bool) -> None:
    """Take a living player through all ticks of a step, and note where it is and what it strikes.

    Where no monster may stir, nobody reads the notes, and none but spells are taken.
    """
    player = s.players[w, p]
    stats = s.player_stats[p]
    settings = s.settings[0]
    event = s.events[w, p]
    event.present = settings.ticks
    x, y, facing, attack = player.x, player.y, player.facing, player.attack
    for tick in range(settings.ticks):
        spot = s.path[tick, p]
        spot.armed = 0
        spot.attack = player.attack
        spot.healed = 0.0
        if player.busy == 0:
            _act(s, w, player, stats, spot, action)
        if player.busy > 0:
            player.busy -= 1
            if player.armed and noted:
                _raise_sword(player, stats, spot)
        if settings.magic:  # else nobody ever spends any
            player.energy = min(player.energy + stats.energy_gain, stats.energy)
        at_sea = settings.deadly_coast and _at_sea(s, s.worlds[w].level, player)
        if noted or at_sea:
            spot.x = player.x
            spot.y = player.y
            spot.facing = player.facing
            spot.energy = player.energy
        if at_sea:
            event.died = 1
            event.present = tick
            break
    stood = player.x == x and player.y == y and player.facing == facing
    at_once = s.path[0, p].armed and s.path[0, p].attack == player.attack  # no other began later
    one_attack = player.attack == attack or (at_once and player.attack == attack + 1)
    s.path[0, p].still = stood and one_attack and event.present == settings.ticks


@part
def _act(s: State, w: int, player: Array, stats: Array, spot: Array, action: int) -> None:
    """Let an idle player walk one tick, or begin an attack or a spell that it can pay."""
    if action == ATTACK:
        player.busy = stats.swing
        player.armed = 1
        player.attack += 1
        spot.attack = player.attack
    elif action == FLAME:
        if player.energy >= stats.flame_cost:
            player.energy -= stats.flame_cost
            player.busy = stats.flame_ticks
            player.armed = 0
            _burn(player, stats, spot)
    elif action == HEAL:
        if player.energy >= stats.heal_cost:
            player.energy -= stats.heal_cost
            player.busy = stats.heal_ticks
            player.armed = 0
            spot.healed = stats.heal
    else:
        player.facing = action
        dx = stats.speed if action == RIGHT else -stats.speed if action == LEFT else 0.0
        dy = stats.speed if action == DOWN else -stats.speed if action == UP else 0.0
        coast = 1 - s.settings[0].deadly_coast
        player.x, player.y = _moved(
            s, s.worlds[w].level, player.x, player.y, stats.half_width, stats.half_height, dx, dy, coast
        )


@part
def _raise_sword(player: Array, stats: Array, spot: Array) -> None:
    """Note the box that the sword strikes at this tick."""
    facing = player.facing
    spot.armed = 1
    spot.attack = player.attack
    spot.box_x = player.x + stats.sword_x[facing]
    spot.box_y = player.y + stats.sword_y[facing]
    spot.half_width = stats.sword_half_width[facing]
    spot.half_height = stats.sword_half_height[facing]
    spot.damage = stats.damage
    spot.knock_speed = stats.knock_speed
    spot.knock_ticks = stats.knock_ticks


@part
def _burn(player: Array, stats: Array, spot: Array) -> None:
    """Note the box that a flame burns, at this tick alone; it knocks nobody back."""
    facing = player.facing
    player.attack += 1
    spot.attack = player.attack
    spot.armed = 1
    spot.box_x = player.x + stats.flame_x[facing]
    spot.box_y = player.y + stats.flame_y[facing]
    spot.half_width = stats.flame_half_width[facing]
    spot.half_height = stats.flame_half_height[facing]
    spot.damage = stats.flame_damage
    spot.knock_speed = 0.0
    spot.knock_ticks = -1


@part
def _at_sea(s: State, level: int, player: Array) -> bool:
    """Tell whether a player's centre is beyond the coast."""
    settings = s.settings[0]
    column = int((player.x - settings.left) / settings.tile)
    row = int((player.y - settings.top) / settings.tile)
    return s.terrain[level, row, column] == COAST


# --- Part 2: monsters live through the step ------------------------------------------------------


@merged
def _live_through(s: State, w: int, count: int) -> None:
    """Let the first `count` monsters of `scratch` live the step, as often as a death is found out."""
    lone = s.players.shape[1] == 1
    for i in range(count):
        s.backup[i] = s.monsters[w, s.scratch[i].order]
    while True:
        _empty_ledger(s)
        if count >= LANES // 4 and lone and s.events[w, 0].present == s.settings[0].ticks:
            for first in range(0, count, LANES):
                _live_in_lanes(s, w, first, min(count - first, LANES))
        else:
            for i in range(count):
                _live_step(s, w, s.scratch[i].order)
        if not _note_first_death(s, w):
            break
        for i in range(count):
            s.monsters[w, s.scratch[i].order] = s.backup[i]
    for i in range(count):
        s.worlds[w].monsters_left -= s.monsters[w, s.scratch[i].order].hp <= 0.0


@part
def _empty_ledger(s: State) -> None:
    for p in range(s.ledger.shape[1]):
        for tick in range(s.ledger.shape[0] if s.ledger[0, p].written else 0):
            line = s.ledger[tick, p]
            line.xp = 0.0
            line.healed = 0.0
            line.bitten = 0.0
            line.hits = 0
            line.kills = 0
            line.notices = 0
            line.contacts = 0
            line.pays = 0
        s.ledger[0, p].written = 0


@part
def _note_first_death(s: State, w: int) -> bool:
    """Find the earliest bite that kills a player, and end his presence there; tell whether it is news.

    Later deaths may hang on the earlier one, so they wait until the monsters have lived the step again.
    """
    first: Any = np.int64(s.settings[0].ticks)
    who = -1
    for p in range(s.players.shape[1]):
        player = s.players[w, p]
        hp = player.hp
        safe: Any = np.int64(player.safe)
        for tick in range(min(s.events[w, p].present, first) if s.ledger[0, p].written else 0):
            hp, safe = _hp_after(s, tick, p, hp, safe)
            if hp <= 0.0:
                if tick + 1 < s.events[w, p].present:
                    first = tick
                    who = p
                break
    if who < 0:
        return False
    s.events[w, who].present = first + 1
    s.events[w, who].died = 0  # nor did he reach the sea
    return True


@part
def _hp_after(s: State, tick: int, p: int, hp: float, safe: int) -> tuple[float, int]:
    """Return a player's HP, and ticks of safety, after a tick: first what heals, then the bites."""
    stats = s.player_stats[p]
    line = s.ledger[tick, p]
    hp = min(hp + (s.path[tick, p].healed + line.healed), stats.hp)
    safe = max(safe - 1, 0)
    if line.bitten > 0.0 and safe == 0:
        hp = max(hp - line.bitten, 0.0)
        safe = stats.safe
    return hp, safe


@part
def _live_step(s: State, w: int, m: int) -> None:
    """Let one living monster live through the ticks of a step along the players' paths.

    At each tick it is struck; if it lives, it senses every player and bites; then it flies back from
    a blow or chases the nearest player that it has noticed. Its place is kept in local variables, which
    the compiler keeps in registers.
    """
    monster = s.monsters[w, m]
    level = s.worlds[w].level
    kind = s.monster_stats[level, m]
    half_width, half_height = kind.half_width, kind.half_height
    notice, attack = kind.notice_squared, kind.attack_squared
    stand_off, speed = kind.stand_off, kind.speed
    x, y = monster.x, monster.y
    if s.path[0, 0].still and s.players.shape[1] == 1 and _only_waits(s, w, m, x, y):
        monster.bite[0] -= s.settings[0].ticks
        return
    for tick in range(s.settings[0].ticks):
        if monster.safe > 0:
            monster.safe -= 1
        target = -1
        nearest = math.inf
        for p in range(s.players.shape[1]):
            spot = s.path[tick, p]
            if tick >= s.events[w, p].present:
                monster.noticed &= ~np.uint8(1 << p)
                monster.bite[p] = 0
            elif spot.armed and _overlap(spot, x, y, half_width, half_height):
                _suffer(s, w, m, tick, p, x, y)
        if monster.hp <= 0.0:
            break
        for p in range(s.players.shape[1]):
            if tick >= s.events[w, p].present:
                continue
            spot = s.path[tick, p]
            stats = s.player_stats[p]
            gap = _gap(x, y, spot.x, spot.y, stats)
            if gap > notice:
                monster.noticed &= ~np.uint8(1 << p)
            elif not monster.noticed & np.uint8(1 << p):
                monster.noticed |= np.uint8(1 << p)
                s.ledger[tick, p].notices += 1
                s.ledger[0, p].written = 1
            if gap <= notice and gap < nearest:
                nearest = gap
                target = p
            if gap > attack:
                monster.bite[p] = 0
            elif monster.bite[p] > 1:
                monster.bite[p] -= 1
            else:
                _bite(kind, s.ledger[tick, p], stats, monster.bite[p] == 0)
                monster.bite[p] = kind.bite_ticks
                s.ledger[0, p].written = 1
        dx = 0.0
        dy = 0.0
        if monster.knocked > 0:
            monster.knocked -= 1
            dx = monster.knock_x
            dy = monster.knock_y
        elif target >= 0:
            dx = _approach(s.path[tick, target].x - x, stand_off, speed)
            dy = _approach(s.path[tick, target].y - y, stand_off, speed)
        if dx != 0.0 or dy != 0.0:
            x, y = _moved(s, level, x, y, half_width, half_height, dx, dy, COAST_BLOCKS)
    monster.x = x
    monster.y = y


@merged
def _live_in_lanes(s: State, w: int, first: int, count: int) -> None:
    """Let up to `LANES` monsters of `scratch` live through a whole step of a lone player.

    All are moved at once as if they did nothing but chase. For those of which that is not true, the
    result is thrown away. What they do to the player is noted in their usual order, as sums demand.
    """
    for lane in range(count):
        _enter_lane(s, w, s.scratch[first + lane].order, lane)
    _chase(s.chase[0], s.path, s.settings[0].ticks, s.player_stats[0])
    for lane in range(count):
        m = s.scratch[first + lane].order
        if _only_chased(s, w, m, lane):
            _leave_lane(s, w, m, lane)
        else:
            _live_step(s, w, m)


@part
def _enter_lane(s: State, w: int, m: int, lane: int) -> None:
    chase = s.chase[0]
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    chase.x[lane] = chase.left[lane] = chase.right[lane] = monster.x
    chase.y[lane] = chase.top[lane] = chase.bottom[lane] = monster.y
    chase.farthest[lane] = 0.0
    chase.bite[lane] = monster.bite[0]
    chase.struck[lane] = chase.bites[lane] = chase.contacts[lane] = 0.0
    chase.half_width[lane] = kind.half_width
    chase.half_height[lane] = kind.half_height
    chase.attack_squared[lane] = kind.attack_squared
    chase.stand_off[lane] = kind.stand_off
    chase.speed[lane] = kind.speed
    chase.bite_ticks[lane] = kind.bite_ticks


@kernel
def _chase(chase: Array, path: Array, ticks: int, stats: Array) -> None:
    """Move all lanes through the ticks of a step as `_live_step` would, without a branch.

    What lies in unused lanes is never looked at.
    """
    half_width, half_height = stats.half_width, stats.half_height
    bit = 1.0
    for tick in range(ticks):
        spot = path[tick, 0]
        player_x, player_y = spot.x, spot.y
        if spot.armed:
            _strike_lanes(chase, spot.box_x, spot.box_y, spot.half_width, spot.half_height)
        for lane in range(LANES):
            x, y, bite = chase.x[lane], chase.y[lane], chase.bite[lane]
            chase.left[lane], chase.right[lane] = min(chase.left[lane], x), max(chase.right[lane], x)
            chase.top[lane], chase.bottom[lane] = min(chase.top[lane], y), max(chase.bottom[lane], y)
            across = max(abs(player_x - x) - half_width, 0.0)
            down = max(abs(player_y - y) - half_height, 0.0)
            gap = across * across + down * down
            chase.farthest[lane] = max(chase.farthest[lane], gap)
            within = gap <= chase.attack_squared[lane]
            waits = bite > 1.0
            chase.bites[lane] += bit if within and not waits else 0.0
            chase.contacts[lane] += bit if within and bite == 0.0 else 0.0
            chase.bite[lane] = (bite - 1.0 if waits else chase.bite_ticks[lane]) if within else 0.0
            chase.x[lane] = x + _approach(player_x - x, chase.stand_off[lane], chase.speed[lane])
            chase.y[lane] = y + _approach(player_y - y, chase.stand_off[lane], chase.speed[lane])
        bit *= 2.0


@part
def _strike_lanes(chase: Array, x: float, y: float, half_width: float, half_height: float) -> None:
    """Note which lanes a box overlaps; see `_overlap`."""
    for lane in range(LANES):
        across = abs(chase.x[lane] - x) < half_width + chase.half_width[lane]
        down = abs(chase.y[lane] - y) < half_height + chase.half_height[lane]
        chase.struck[lane] = 1.0 if across & down else chase.struck[lane]


@part
def _only_chased(s: State, w: int, m: int, lane: int) -> bool:
    """Tell whether a monster of a lane was free to chase the player from the first tick to the last."""
    chase = s.chase[0]
    monster = s.monsters[w, m]
    if chase.struck[lane] or monster.knocked > 0 or monster.safe > 0 or not monster.noticed & 1:
        return False
    if chase.farthest[lane] > s.monster_stats[s.worlds[w].level, m].notice_squared:
        return False
    settings = s.settings[0]
    first_column = int((chase.left[lane] - settings.left) * settings.cells_per_pixel)
    last_column = int((chase.right[lane] - settings.left) * settings.cells_per_pixel)
    first_row = int((chase.top[lane] - settings.top) * settings.cells_per_pixel)
    last_row = int((chase.bottom[lane] - settings.top) * settings.cells_per_pixel)
    if last_row >= s.room.shape[1] or last_column >= s.room.shape[2] or first_row < 0 or first_column < 0:
        return False
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            if s.room[s.worlds[w].level, row, column] == 0:
                return False
    return True


@part
def _leave_lane(s: State, w: int, m: int, lane: int) -> None:
    """Take over where a monster got in its lane, and note its bites."""
    chase = s.chase[0]
    monster = s.monsters[w, m]
    monster.x = chase.x[lane]
    monster.y = chase.y[lane]
    monster.bite[0] = int(chase.bite[lane])
    bites = int(chase.bites[lane])
    contacts = int(chase.contacts[lane])
    for tick in range(s.settings[0].ticks if bites > 0 else 0):
        if bites >> tick & 1:
            kind = s.monster_stats[s.worlds[w].level, m]
            _bite(kind, s.ledger[tick, 0], s.player_stats[0], contacts >> tick & 1)
            s.ledger[0, 0].written = 1


@part
def _only_waits(s: State, w: int, m: int, x: float, y: float) -> bool:
    """Tell whether all that a monster does in a step is to wait for its next bite.

    So it is for one that stands as near as it gets to a lone player who stands as well, when no bite
    and no new blow is due: in a fight, most are.
    """
    monster = s.monsters[w, m]
    kind = s.monster_stats[s.worlds[w].level, m]
    spot = s.path[0, 0]
    if monster.knocked > 0 or monster.safe > 0 or not monster.noticed & 1:
        return False
    if s.events[w, 0].present < s.settings[0].ticks:
        return False
    if monster.bite[0] <= s.settings[0].ticks:
        return False
    if abs(spot.x - x) > kind.stand_off or abs(spot.y - y) > kind.stand_off:
        return False
    gap = _gap(x, y, spot.x, spot.y, s.player_stats[0])
    if gap > kind.attack_squared or gap > kind.notice_squared:
        return False
    if not spot.armed or spot.attack == monster.struck_by[0]:
        return True
    return not _overlap(spot, x, y, kind.half_width, kind.half_height)


@part
def _overlap(spot: Array, x: float, y: float, half_width: float, half_height: float) -> bool:
    """Tell whether what strikes at a tick overlaps a body."""
    return (
        abs(x - spot.box_x) < spot.half_width + half_width
        and abs(y - spot.box_y) < spot.half_height + half_height
    )


@kernel
def _take_blow(monster: Array, kind: Array, spot: Array, x: float, y: float) -> None:
    """Lose HP and fly back from the centre of the sword box; if it is there, the way faced."""
    monster.safe = kind.safe
    monster.hp = max(monster.hp - spot.damage, 0.0)
    if monster.hp <= 0.0 or spot.knock_ticks < 0:
        return
    away_x = x - spot.box_x
    away_y = y - spot.box_y
    length = math.sqrt(away_x * away_x + away_y * away_y)
    if length == 0.0:
        away_x = float((spot.facing == RIGHT) - (spot.facing == LEFT))
        away_y = float((spot.facing == DOWN) - (spot.facing == UP))
        length = 1.0
    speed = spot.knock_speed if kind.knock_ticks < 0 else kind.knock_speed
    monster.knock_x = away_x / length * speed
    monster.knock_y = away_y / length * speed
    monster.knocked = spot.knock_ticks if kind.knock_ticks < 0 else kind.knock_ticks


@part
def _suffer(s: State, w: int, m: int, tick: int, p: int, x: float, y: float) -> None:
    """Take a player's blow, unless this attack has hit already or the monster is safe."""
    monster = s.monsters[w, m]
    new = s.path[tick, p].attack != monster.struck_by[p]
    if not new or monster.safe > 0 or monster.hp <= 0.0:
        return
    monster.struck_by[p] = s.path[tick, p].attack
    kind = s.monster_stats[s.worlds[w].level, m]
    _take_blow(monster, kind, s.path[tick, p], x, y)
    s.ledger[tick, p].hits += 1
    s.ledger[0, p].written = 1
    if monster.hp <= 0.0:
        _pay(s, w, monster, kind, tick, p)


@part
def _pay(s: State, w: int, monster: Array, kind: Array, tick: int, striker: int) -> None:
    """Credit a kill: to the one who landed the last blow, or to all within the attack circle."""
    s.ledger[tick, striker].kills += 1
    s.ledger[0, striker].written = 1
    for p in range(s.players.shape[1]):
        if tick >= s.events[w, p].present:
            continue
        line = s.ledger[tick, p]
        line.pays += 1
        s.ledger[0, p].written = 1
        if (monster.bite[p] > 0) if s.settings[0].credit_near else (p == striker):
            line.xp += kind.xp
            line.healed += kind.heal


@part
def _bite(kind: Array, line: Array, stats: Array, contact: bool) -> None:
    """Bite a player: at once on `contact`, when it comes within reach, then at every interval."""
    line.contacts += contact
    if stats.safe == 0 or line.bitten == 0.0:  # one bite a tick for who is safe after it
        line.bitten += kind.damage


@part
def _approach(offset: float, stand_off: float, speed: float) -> float:
    """Return a monster's step on one axis towards a player that is `offset` away."""
    if offset > stand_off:
        return speed
    if offset < -stand_off:
        return -speed
    return 0.0


# --- Part 3: the ledger is settled ---------------------------------------------------------------


@part
def _settle(s: State, w: int, p: int, met: bool) -> None:
    """Give a player, tick by tick, what the step brought; `met` says whether the ledger was written."""
    player = s.players[w, p]
    event = s.events[w, p]
    if met:
        for tick in range(np.int64(event.present)):
            _settle_tick(s, player, event, tick, p)
    else:
        player.safe = max(player.safe - event.present, 0)
        for tick in range(event.present if s.settings[0].magic else 0):
            hp = min(player.hp + s.path[tick, p].healed, s.player_stats[p].hp)
            event.hp_gained += hp - player.hp
            player.hp = hp
    at_sea = event.died and player.hp > 0.0  # else the bites were first
    if at_sea:
        event.hp_lost += player.hp
        player.hp = 0.0
    if player.hp <= 0.0:
        _die(player, event, s.path[event.present if at_sea else event.present - 1, p])
        if not at_sea:
            _charge(player, event, s.settings[0].ending_cost)


@part
def _die(player: Array, event: Array, spot: Array) -> None:
    """Leave a player as he was at the tick of his death."""
    event.died = 1
    player.x = spot.x
    player.y = spot.y
    player.facing = spot.facing
    player.energy = spot.energy
    player.attack = spot.attack
    player.busy = 0
    player.armed = 0


@part
def _settle_tick(s: State, player: Array, event: Array, tick: int, p: int) -> None:
    line = s.ledger[tick, p]
    hp, safe = _hp_after(s, tick, p, player.hp, np.int64(player.safe))
    top = min(player.hp + (s.path[tick, p].healed + line.healed), s.player_stats[p].hp)
    event.hp_gained += top - player.hp
    event.hp_lost += top - hp
    player.hp = hp
    player.safe = safe
    player.xp += line.xp
    player.kills += line.kills
    event.xp_gained += line.xp
    event.hits += line.hits
    event.kills += line.kills
    event.notices += line.notices
    event.contacts += line.contacts
    if line.pays > 0:
        event.reward = player.xp
    event.reward += line.notices + line.contacts


@part
def _reward(player: Array, stats: Array, event: Array) -> None:
    """Write a player's reward by its formula; `reward.py` says them in words."""
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
    """Return an algebraic sigmoid of the distance: 1 at a monster, 1/2 at the middle, 0 far off."""
    if distance == math.inf:
        return 0.0
    z = (SIGMOID_MIDDLE - distance) / SIGMOID_WIDTH
    return 0.5 + 0.5 * z / math.sqrt(1.0 + z * z)


# --- Moving among tiles --------------------------------------------------------------------------


@part
def _moved(
    s: State, level: int, x: float, y: float, half_width: float, half_height: float,
    dx: float, dy: float, coast_blocks: int,
) -> tuple[float, float]:  # fmt: skip
    """Return where a body gets by moving, x first, among the tiles that block."""
    if _has_room(s, level, x, y):
        return x + dx, y + dy
    settings = s.settings[0]
    if dx != 0.0:
        x = _slide_x(s.terrain, level, settings, x, y, half_width, half_height, dx, coast_blocks)
    if dy != 0.0:
        y = _slide_y(s.terrain, level, settings, x, y, half_width, half_height, dy, coast_blocks)
    return x, y


@part
def _has_room(s: State, level: int, x: float, y: float) -> bool:
    """Tell whether a body whose centre is here is too far from all tiles to meet one within a tick."""
    settings = s.settings[0]
    column = int((x - settings.left) * settings.cells_per_pixel)
    row = int((y - settings.top) * settings.cells_per_pixel)
    return s.room[level, row, column] != 0


@kernel
def _slide_x(
    terrain: Array, level: int, settings: Array, x: float, y: float,
    half_width: float, half_height: float, dx: float, coast_blocks: int,
) -> float:  # fmt: skip
    """Return x after moving by dx, stopped flush at the first tile that blocks."""
    tile = settings.tile
    first = math.floor((y - half_height - settings.top) / tile)
    last = math.ceil((y + half_height - settings.top) / tile) - 1
    if dx > 0:
        column = math.ceil((x + dx + half_width - settings.left) / tile) - 1
        for row in range(first, last + 1):
            if _blocked(terrain, level, column, row, coast_blocks):
                return max(x, settings.left + column * tile - half_width)
    else:
        column = math.floor((x + dx - half_width - settings.left) / tile)
        for row in range(first, last + 1):
            if _blocked(terrain, level, column, row, coast_blocks):
                return min(x, settings.left + (column + 1) * tile + half_width)
    return x + dx


@kernel
def _slide_y(
    terrain: Array, level: int, settings: Array, x: float, y: float,
    half_width: float, half_height: float, dy: float, coast_blocks: int,
) -> float:  # fmt: skip
    """Return y after moving by dy, stopped flush at the first tile that blocks."""
    tile = settings.tile
    first = math.floor((x - half_width - settings.left) / tile)
    last = math.ceil((x + half_width - settings.left) / tile) - 1
    if dy > 0:
        row = math.ceil((y + dy + half_height - settings.top) / tile) - 1
        for column in range(first, last + 1):
            if _blocked(terrain, level, column, row, coast_blocks):
                return max(y, settings.top + row * tile - half_height)
    else:
        row = math.floor((y + dy - half_height - settings.top) / tile)
        for column in range(first, last + 1):
            if _blocked(terrain, level, column, row, coast_blocks):
                return min(y, settings.top + (row + 1) * tile + half_height)
    return y + dy


@part
def _blocked(terrain: Array, level: int, column: int, row: int, coast_blocks: int) -> bool:
    """Tell whether a tile stops a body; what lies off the grid does."""
    if column < 0 or row < 0 or row >= terrain.shape[1] or column >= terrain.shape[2]:
        return True
    code = terrain[level, row, column]
    return code == SOLID or (code == COAST and coast_blocks != 0)


# --- Observation ---------------------------------------------------------------------------------


@merged
def _observe(s: State, w: int, p: int, tell: bool) -> None:
    """Write a player's observation and action mask; layouts in `observation.py`.

    `tell` says whether the events are to tell of the nearest monster: not those of an ended world.
    """
    count = _order_monsters(s, w, p, tell)
    out = s.observations[w, p]
    at = _write_player(s, w, p, out)
    for i in range(count):
        at = _write_monster(s, w, p, i, out, at)
    for rest in range(at, len(out)):
        out[rest] = 0.0
    _mask_actions(s, w, p)


@part
def _order_monsters(s: State, w: int, p: int, tell: bool) -> int:
    """List in `scratch` the monsters that a player perceives, with distances; count them.

    The nearest come first, ties by index, and the dead are left out. In fixed order the same are
    listed by index; the dead fill up what is left, infinitely far off.
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
        return 4
    out[2] = (player.facing == RIGHT) - (player.facing == LEFT)
    out[3] = (player.facing == DOWN) - (player.facing == UP)
    out[4] = hp
    out[5] = player.energy * s.player_stats[p].energy_scale
    return 6


@part
def _write_monster(s: State, w: int, p: int, i: int, out: Array, at: int) -> int:
    """Write the `i`-th monster of `scratch` from place `at` on; return where the next one begins.

    All of a dead one is zero: its HP as they are, the rest because it is infinitely far off.
    """
    settings = s.settings[0]
    player = s.players[w, p]
    monster = s.monsters[w, s.scratch[i].order]
    kind = s.monster_stats[s.worlds[w].level, s.scratch[i].order]
    length = s.scratch[i].distance
    inverse = 1.0 / length if length > 0.0 else 0.0
    alive = length < math.inf
    hp = monster.hp * kind.hp_scale
    if settings.layout == LAYOUT_GODOT:
        out[at] = (monster.x - settings.middle_x) * settings.scale_x if alive else 0.0
        out[at + 1] = (monster.y - settings.middle_y) * settings.scale_y if alive else 0.0
        out[at + 2] = hp
        out[at + 3] = (player.x - monster.x) * inverse
        out[at + 4] = (player.y - monster.y) * inverse
        return at + 5
    out[at] = length * kind.distance_scale if alive else 0.0
    out[at + 1] = (monster.x - player.x) * inverse
    out[at + 2] = (monster.y - player.y) * inverse
    out[at + 3] = hp
    if settings.layout == LAYOUT_THESIS:
        return at + 4
    out[at + 4] = kind.xp * kind.xp_scale if alive else 0.0
    return at + 5


@part
def _mask_actions(s: State, w: int, p: int) -> None:
    """Write which actions would do anything in the next step.

    Nothing does while an attack lasts through it; only attack then counts as allowed. Walking against
    a wall that one faces already does nothing, nor does a spell that cannot be paid.
    """
    player = s.players[w, p]
    stats = s.player_stats[p]
    free = player.busy < s.settings[0].ticks
    for a in range(4):
        s.masks[w, p, a] = free
    hemmed_in = stats.speed == 0.0 or not _has_room(s, s.worlds[w].level, player.x, player.y)
    if free and hemmed_in:
        s.masks[w, p, player.facing] = _may_walk(s, w, player, stats, player.facing)
    s.masks[w, p, ATTACK] = 1
    if s.masks.shape[2] > HEAL:
        energy = player.energy
        for _ in range(s.settings[0].ticks - 1):  # a spell may begin as late as the step's last tick
            energy = min(energy + stats.energy_gain, stats.energy)
        s.masks[w, p, FLAME] = free and energy >= stats.flame_cost
        s.masks[w, p, HEAL] = free and energy >= stats.heal_cost


@part
def _may_walk(s: State, w: int, player: Array, stats: Array, action: int) -> bool:
    """Tell whether one tick of walking gets a player anywhere."""
    dx = stats.speed if action == RIGHT else -stats.speed if action == LEFT else 0.0
    dy = stats.speed if action == DOWN else -stats.speed if action == UP else 0.0
    coast = 1 - s.settings[0].deadly_coast
    x, y = _moved(
        s, s.worlds[w].level, player.x, player.y, stats.half_width, stats.half_height, dx, dy, coast
    )
    return x != player.x or y != player.y
