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
    mixed = world.key + world.draws * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))


@inlined
def _draw_below(world: Array, bound: int) -> Any:
    """Return a random integer in [0, bound), for bounds far below 2**32."""
    high = _draw(world) >> np.uint64(32)
    return np.int64((high * np.uint64(bound)) >> np.uint64(32))


# --- Reset ---------------------------------------------------------------------------------------


@inlined
def begin_episode(state: State, world_index: int, start_index: int) -> None:
    """Start an episode in one world, at a start place; below zero asks for one at random."""
    world = state.worlds[world_index]
    world.steps = 0
    world.ending = RUNNING
    world.monsters_left = state.monsters.shape[1]
    world.players_left = state.players.shape[1]
    world.level = 0
    if state.starts.shape[0] > 1:
        world.level = _draw_below(world, state.starts.shape[0])
    world.start = start_index
    if start_index < 0:
        world.start = _draw_below(world, state.starts.shape[1])
    for player_index in range(state.players.shape[1]):
        player = state.players[world_index, player_index]
        kept_xp = player.xp
        state.players[world_index, player_index] = state.first_players[player_index]
        if state.settings[0].keep_xp:
            player.xp = kept_xp
        player_start = (world.start + player_index) % state.starts.shape[1]
        player.x = state.starts[world.level, player_start, 0]
        player.y = state.starts[world.level, player_start, 1]
        slot = state.slots[world_index, player_index]
        slot.returns = 0.0
        slot.lengths = 0
        slot.idle = False
    for monster_index in range(state.monsters.shape[1]):
        state.monsters[world_index, monster_index] = state.first_monsters[world.level, monster_index]
    tally = state.tallies[world_index]
    tally.returns = 0.0
    tally.hp_lost = 0.0
    tally.cleared = 0
    for action in range(state.taken.shape[1]):
        state.taken[world_index, action] = 0


# --- One step ------------------------------------------------------------------------------------


@inlined_early
def step_world(state: State, world_index: int, actions: Array) -> bool:
    """Advance one running world by one agent step; return whether its episode ended."""
    world = state.worlds[world_index]
    settings = state.settings[0]
    active = _gather_active(state, world_index)
    _gather_near(state, world_index, active)
    for _ in range(settings.ticks):
        for player_index in range(state.players.shape[1]):
            _begin_tick(state, world_index, player_index, actions[world_index, player_index])
        for active_index in range(active):
            monster_index = np.int64(state.scratch[active_index].order)
            if state.monsters[world_index, monster_index].hp > 0.0:
                _tick_monster(state, world_index, monster_index)
        for player_index in range(state.players.shape[1]):
            if state.tick[player_index].there:
                _end_tick(state, world_index, player_index)
    world.players_left = 0
    for player_index in range(state.players.shape[1]):
        world.players_left += state.players[world_index, player_index].hp > 0.0
    world.steps += 1
    if world.players_left == 0:
        world.ending = KILLED
    elif world.monsters_left == 0 and settings.end_on_clear:
        world.ending = CLEARED
    elif world.steps >= settings.episode_steps:
        world.ending = TIME_LIMIT
    if world.ending == CLEARED or world.ending == TIME_LIMIT:
        for player_index in range(state.players.shape[1]):
            player = state.players[world_index, player_index]
            if player.hp > 0.0:
                _charge(player, state.events[world_index, player_index], settings.ending_cost)
    return world.ending != RUNNING


@inlined
def _charge(player: Array, event: Array, cost: float) -> None:
    """Subtract the XP that an ending costs; in the published code the reward is then set to the XP."""
    if cost != 0.0:
        player.xp -= cost
        event.xp_gained -= cost
        event.reward = player.xp


@inlined
def _gather_active(state: State, world_index: int) -> int:
    """List in `scratch` the monsters to which anything can happen in the next step; return their number.

    The others stand still and only block those that move. Leaving them out changes no bit and saves most of
    the time.
    """
    active = 0
    for monster_index in range(state.monsters.shape[1]):
        monster = state.monsters[world_index, monster_index]
        if monster.hp > 0.0 and _may_stir(state, world_index, monster_index):
            state.scratch[active].order = monster_index
            active += 1
    return active


@inlined
def _gather_near(state: State, world_index: int, active: int) -> None:
    """List in `near` which bodies each player and the first `active` of `scratch` may meet in this step."""
    monsters = state.monsters.shape[1]
    bodies = monsters + state.players.shape[1]
    for body_index in range(bodies):
        _pack(state, world_index, body_index)
    for active_index in range(active):
        _list_neighbours(state, world_index, np.int64(state.scratch[active_index].order))
    for body_index in range(monsters, bodies):
        _list_neighbours(state, world_index, body_index)


@inlined
def _list_neighbours(state: State, world_index: int, body_index: int) -> None:
    x, y, _ = body(state, world_index, body_index)
    neighbours = state.near[body_index]
    neighbours[0] = 0
    for other_index in range(state.monsters.shape[1] + state.players.shape[1]):
        if other_index != body_index and _is_near(state, world_index, other_index, x, y):
            neighbours[0] += 1
            neighbours[neighbours[0]] = other_index


@inlined
def _pack(state: State, world_index: int, body_index: int) -> None:
    """Write a body's box to `boxes`, where moving bodies look for obstacles; what is dead stops nobody."""
    packed_box = state.boxes[body_index]
    packed_box[0], packed_box[1], packed_box[2], packed_box[3] = box(state, world_index, body_index)
    if not is_alive(state, world_index, body_index):
        packed_box[2] = packed_box[3] = -math.inf


@inlined
def _may_stir(state: State, world_index: int, monster_index: int) -> bool:
    monster = state.monsters[world_index, monster_index]
    monster_stats = state.monster_stats[state.worlds[world_index].level, monster_index]
    if monster.knocked > 0 or monster.safe > 0 or monster.noticed or monster.inside:
        return True
    for player_index in range(state.players.shape[1]):
        if monster.bite[player_index] > 0:
            return True
        player = state.players[world_index, player_index]
        squared_gap = _squared_gap(monster.x, monster.y, player, state.player_stats[player_index])
        if player.hp > 0.0 and squared_gap <= monster_stats.reach_squared:
            return True
    return False


@inlined
def _squared_gap(point_x: float, point_y: float, player: Array, player_stats: Array) -> float:
    """Return the squared distance from a point to a player's body."""
    across = max(abs(player.x + player_stats.body_x - point_x) - player_stats.half_width, 0.0)
    down = max(abs(player.y + player_stats.body_y - point_y) - player_stats.half_height, 0.0)
    return across * across + down * down


# --- A tick: players act -------------------------------------------------------------------------


@inlined
def _begin_tick(state: State, world_index: int, player_index: int, action: int) -> None:
    """Let a living player act, and record what it strikes."""
    player = state.players[world_index, player_index]
    player_stats = state.player_stats[player_index]
    tick = state.tick[player_index]
    tick.there = player.hp > 0.0
    tick.strikes = 0
    if not tick.there:
        return
    tick.xp = tick.healed = tick.bitten = 0.0
    tick.notices = tick.contacts = tick.paid = 0
    if player.busy == 0:
        _act(state, world_index, player_index, action)
    if player.busy > 0:
        player.busy -= 1
        if player.action_kind == BLADE:
            tick.strikes = BLADE
    player.energy = min(player.energy + player_stats.energy_gain, player_stats.energy)
    state.events[world_index, player_index].present += 1


@inlined
def _act(state: State, world_index: int, player_index: int, action: int) -> None:
    """Let an idle player walk for a tick, or start an attack, or a spell that it can pay for."""
    player = state.players[world_index, player_index]
    player_stats = state.player_stats[player_index]
    if action == ATTACK:
        player.busy = player_stats.swing
        player.action_kind = BLADE
        player.attack += 1
    elif action == FLAME:
        if player.energy >= player_stats.flame_cost:
            player.energy -= player_stats.flame_cost
            player.busy = player_stats.flame_ticks
            player.action_kind = BURNING
            player.attack += 1
            state.tick[player_index].strikes = BURNING  # in this tick only
    elif action == HEAL:
        if player.energy >= player_stats.heal_cost:
            player.energy -= player_stats.heal_cost
            player.busy = player_stats.heal_ticks
            player.action_kind = HEALING
            for patient_index in range(state.players.shape[1]):
                patient = state.players[world_index, patient_index]
                if patient_index == player_index or _within_heal(patient, player, player_stats.heal_reach):
                    event = state.events[world_index, patient_index]
                    _heal(patient, state.player_stats[patient_index], event, player_stats.heal)
    else:
        player.facing = action
        _walk(state, world_index, player_index)


@inlined
def _within_heal(patient: Array, player: Array, reach: float) -> bool:
    x = patient.x - player.x
    y = patient.y - player.y
    return reach > 0.0 and patient.hp > 0.0 and x * x + y * y <= reach * reach


@inlined
def _heal(player: Array, player_stats: Array, event: Array, healing: float) -> None:
    hp = max(player.hp, min(player.hp + healing, player_stats.hp))
    event.hp_gained += hp - player.hp
    player.hp = hp


@kernel
def _walk(state: State, world_index: int, player_index: int) -> None:
    player = state.players[world_index, player_index]
    player.x, player.y = ahead(state, world_index, player_index, True)
    _pack(state, world_index, state.monsters.shape[1] + player_index)


@inlined
def ahead(state: State, world_index: int, player_index: int, among_bodies: bool) -> tuple[float, float]:
    """Return where a player is after walking for one tick in the direction it faces."""
    facing = state.players[world_index, player_index].facing
    speed = state.player_stats[player_index].speed
    step_x = 0.0
    step_y = 0.0
    if facing == RIGHT:
        step_x = speed
    elif facing == LEFT:
        step_x = -speed
    elif facing == DOWN:
        step_y = speed
    else:
        step_y = -speed
    body_index = state.monsters.shape[1] + player_index
    return moved(state, world_index, body_index, step_x, step_y, state.settings[0].player_stops, among_bodies)


# --- A tick: monsters are struck, sense, bite and move -------------------------------------------


@inlined
def _tick_monster(state: State, world_index: int, monster_index: int) -> None:
    monster = state.monsters[world_index, monster_index]
    monster_stats = state.monster_stats[state.worlds[world_index].level, monster_index]
    if monster.safe > 0:
        monster.safe -= 1
    for player_index in range(state.players.shape[1]):
        _suffer(state, world_index, monster_index, player_index)
    if monster.hp <= 0.0:
        return
    target = -1
    nearest = math.inf
    for player_index in range(state.players.shape[1]):
        if state.tick[player_index].there:
            squared_gap = _sense(state, world_index, monster_index, player_index)
            if squared_gap <= monster_stats.notice_squared and squared_gap < nearest:
                nearest = squared_gap
                target = player_index
    step_x = 0.0
    step_y = 0.0
    if monster.knocked > 0:
        monster.knocked -= 1
        step_x = monster.knock_x
        step_y = monster.knock_y
    elif target >= 0:
        player = state.players[world_index, target]
        step_x = _approach(player.x - monster.x, monster_stats.stand_off, monster_stats.speed)
        step_y = _approach(player.y - monster.y, monster_stats.stand_off, monster_stats.speed)
    if step_x != 0.0 or step_y != 0.0:
        stops = state.settings[0].monster_stops
        monster.x, monster.y = moved(state, world_index, monster_index, step_x, step_y, stops, True)
        _pack(state, world_index, monster_index)


@inlined
def _suffer(state: State, world_index: int, monster_index: int, player_index: int) -> None:
    """Let a player's strike hit a monster: once an attack, or each time that it enters the sword's box."""
    monster = state.monsters[world_index, monster_index]
    tick = state.tick[player_index]
    bit = np.uint8(1 << player_index)
    struck = tick.there and tick.strikes and _is_struck(state, world_index, monster_index, player_index)
    on_entry = state.settings[0].blow_on_entry
    entered = on_entry and state.players[world_index, player_index].action_kind == BLADE
    if not tick.there:
        monster.noticed &= ~bit
        monster.bite[player_index] = 0
    elif struck and not entered:
        _apply_hit(state, world_index, monster_index, player_index)
    elif struck and not monster.inside & bit:
        monster.struck_by[player_index] = 0  # one that comes back is hit again by the same attack
        _apply_hit(state, world_index, monster_index, player_index)
    if on_entry:
        if struck and entered:
            monster.inside |= bit
        else:
            monster.inside &= ~bit


@inlined
def _strike(state: State, player_index: int) -> Array:
    """Return what a player strikes with."""
    player_stats = state.player_stats[player_index]
    if state.tick[player_index].strikes == BURNING:
        return player_stats.flame
    return player_stats.sword


@inlined
def _is_struck(state: State, world_index: int, monster_index: int, player_index: int) -> bool:
    """Return whether the box of a player's strike overlaps a monster's body."""
    monster = state.monsters[world_index, monster_index]
    monster_stats = state.monster_stats[state.worlds[world_index].level, monster_index]
    player = state.players[world_index, player_index]
    strike = _strike(state, player_index)
    x = player.x + strike.x[player.facing]
    y = player.y + strike.y[player.facing]
    width = strike.half_width[player.facing] + monster_stats.half_width
    height = strike.half_height[player.facing] + monster_stats.half_height
    across = abs(monster.x + monster_stats.body_x - x) < width
    return across and abs(monster.y + monster_stats.body_y - y) < height


@inlined
def _apply_hit(state: State, world_index: int, monster_index: int, player_index: int) -> None:
    """Apply a player's blow, unless this attack has hit the monster already or the monster is safe."""
    monster = state.monsters[world_index, monster_index]
    player = state.players[world_index, player_index]
    if monster.struck_by[player_index] == player.attack or monster.safe > 0 or monster.hp <= 0.0:
        return
    monster_stats = state.monster_stats[state.worlds[world_index].level, monster_index]
    strike = _strike(state, player_index)
    monster.struck_by[player_index] = player.attack
    monster.safe = monster_stats.safe
    monster.hp = max(monster.hp - strike.damage, 0.0)
    state.events[world_index, player_index].hits += 1
    if monster.hp <= 0.0:
        _pack(state, world_index, monster_index)
        _credit_kill(state, world_index, monster_index, player_index)
    elif strike.knock_ticks >= 0 and monster.knocked == 0:
        _knock_back(monster, monster_stats, player, strike)


@inlined
def _knock_back(monster: Array, monster_stats: Array, player: Array, strike: Array) -> None:
    """Start a flight away from the hilt; a flight in progress is neither turned nor extended."""
    speed = strike.knock_speed
    monster.knocked = strike.knock_ticks
    if monster_stats.knock_ticks >= 0:
        speed = monster_stats.knock_speed
        monster.knocked = monster_stats.knock_ticks
    away_x = monster.x - (player.x + strike.hilt_x[player.facing])
    away_y = monster.y - (player.y + strike.hilt_y[player.facing])
    length = math.sqrt(away_x * away_x + away_y * away_y)
    if length > 0.0:
        monster.knock_x = away_x / length * speed
        monster.knock_y = away_y / length * speed
    else:
        monster.knock_x = 0.0
        monster.knock_y = 0.0


@inlined
def _credit_kill(state: State, world_index: int, monster_index: int, striker: int) -> None:
    """Credit a kill to the player who struck, or to all players within the attack circle."""
    monster = state.monsters[world_index, monster_index]
    monster_stats = state.monster_stats[state.worlds[world_index].level, monster_index]
    state.worlds[world_index].monsters_left -= 1
    state.players[world_index, striker].kills += 1
    state.events[world_index, striker].kills += 1
    for player_index in range(state.players.shape[1]):
        earns = player_index == striker
        if state.settings[0].credit_near:
            earns = monster.bite[player_index] > 0
        tick = state.tick[player_index]
        if tick.there and earns:
            tick.paid = 1
            tick.xp += monster_stats.xp
            tick.healed += monster_stats.heal


@inlined
def _sense(state: State, world_index: int, monster_index: int, player_index: int) -> float:
    """Notice a player, and bite it if it is near enough; return the squared distance to it."""
    monster = state.monsters[world_index, monster_index]
    monster_stats = state.monster_stats[state.worlds[world_index].level, monster_index]
    player = state.players[world_index, player_index]
    player_stats = state.player_stats[player_index]
    tick = state.tick[player_index]
    bit = np.uint8(1 << player_index)
    notice_x = monster.x + monster_stats.notice_x
    notice_y = monster.y + monster_stats.notice_y
    squared_gap = _squared_gap(notice_x, notice_y, player, player_stats)
    if squared_gap > monster_stats.notice_squared:
        monster.noticed &= ~bit
    elif not monster.noticed & bit:
        monster.noticed |= bit
        tick.notices += 1
    attack_x = monster.x + monster_stats.attack_x
    attack_y = monster.y + monster_stats.attack_y
    if _squared_gap(attack_x, attack_y, player, player_stats) > monster_stats.attack_squared:
        monster.bite[player_index] = 0
    elif monster.bite[player_index] > 1:
        monster.bite[player_index] -= 1
    else:
        tick.contacts += monster.bite[player_index] == 0
        if monster.knocked > 0:
            monster.bite[player_index] = 1  # due as soon as it has landed
        else:
            monster.bite[player_index] = monster_stats.bite_ticks
            if player_stats.safe == 0 or tick.bitten == 0.0:  # one bite a tick for who is safe after it
                tick.bitten += monster_stats.damage
    return squared_gap


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
def _end_tick(state: State, world_index: int, player_index: int) -> None:
    """Apply the tick's results to a player: first healing, then bites."""
    player = state.players[world_index, player_index]
    player_stats = state.player_stats[player_index]
    event = state.events[world_index, player_index]
    tick = state.tick[player_index]
    player.safe = max(player.safe - 1, 0)
    hp = player.hp + tick.healed
    event.hp_gained += hp - player.hp
    player.hp = hp
    if tick.bitten > 0.0 and player.safe == 0:
        player.hp = max(hp - tick.bitten, 0.0)
        player.safe = player_stats.safe
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
        _pack(state, world_index, state.monsters.shape[1] + player_index)
        _charge(player, event, state.settings[0].ending_cost)


# --- The book of episodes ------------------------------------------------------------------------


@inlined
def record_step(state: State, world_index: int, actions: Array) -> None:
    """Add a step, with its rewards, to a world's `slots`, `tallies` and `taken`.

    A player's episode ends with its death, or with its world. From the next step until the world ends its
    slot is idle.
    """
    world = state.worlds[world_index]
    rewards = hp_lost = 0.0
    for player_index in range(state.players.shape[1]):
        slot = state.slots[world_index, player_index]
        event = state.events[world_index, player_index]
        has_died = state.players[world_index, player_index].hp <= 0.0
        present = event.present > 0
        if present:
            slot.returns += event.reward
            slot.lengths += 1
            slot.ending = world.ending
            if has_died:
                slot.ending = KILLED
            slot.episodes += slot.ending != RUNNING
            state.taken[world_index, actions[world_index, player_index]] += 1
        slot.begins = slot.ending != RUNNING
        slot.idle = has_died and not present
        rewards += event.reward
        hp_lost += event.hp_lost
    tally = state.tallies[world_index]
    tally.returns += rewards / state.players.shape[1]
    tally.hp_lost += hp_lost / state.players.shape[1]
    if world.monsters_left == 0 and tally.cleared == 0:
        tally.cleared = world.steps


# --- Moving --------------------------------------------------------------------------------------


@kernel
def moved(
    state: State,
    world_index: int,
    body_index: int,
    step_x: float,
    step_y: float,
    stops: int,
    among_bodies: bool,
) -> tuple[float, float]:
    """Return where a body moves, x first, in terrain, and among other bodies if asked for.

    Players come after monsters in `body_index`; `stops` has a bit for each code of terrain that stops it.
    """
    x, y, shape = body(state, world_index, body_index)
    if step_x != 0.0:
        x = _moved_along(state, world_index, body_index, True, x, y, shape, step_x, stops, among_bodies)
    if step_y != 0.0:
        y = _moved_along(state, world_index, body_index, False, x, y, shape, step_y, stops, among_bodies)
    return x, y


@inlined
def _moved_along(
    state: State, world_index: int, body_index: int, along_x: bool, x: float, y: float,
    shape: tuple[float, float, float, float], distance: float, stops: int, among_bodies: bool,
) -> float:  # fmt: skip
    """Return x, or y, after a move along it, stopped flush at the first obstacle."""
    start, _ = _turned(along_x, x, y)
    offset, _ = _turned(along_x, shape[0], shape[1])
    middle, middle_aside = _turned(along_x, x + shape[0], y + shape[1])
    half, half_aside = _turned(along_x, shape[2], shape[3])
    direction = -1.0
    if distance > 0.0:
        direction = 1.0
    end = middle + distance
    limit = _stop_at_tiles(state, world_index, along_x, direction, end, half, middle_aside, half_aside, stops)
    if among_bodies:
        contact = _stop_at_bodies(
            state, body_index, along_x, direction, middle, half, middle_aside, half_aside
        )
        limit = min(limit, contact)
    if direction * end <= limit:
        return start + distance
    if distance > 0.0:
        return max(start, limit - offset)
    return min(start, -limit - offset)


@inlined
def _turned(along_x: bool, x: Any, y: Any) -> tuple[Any, Any]:
    """Return the coordinate along the axis of a move, then the one across it, or the reverse."""
    if along_x:
        return x, y
    return y, x


@inlined
def _stop_at_tiles(
    state: State, world_index: int, along_x: bool, direction: float, end: float, half: float,
    middle_aside: float, half_aside: float, stops: int,
) -> float:  # fmt: skip
    """Return where a box's centre, times `direction`, is flush with tiles its leading edge would enter."""
    settings = state.settings[0]
    tile = settings.tile
    grid_start, grid_start_aside = _turned(along_x, settings.left, settings.top)
    first = math.floor((middle_aside - half_aside - grid_start_aside) / tile)
    last = math.ceil((middle_aside + half_aside - grid_start_aside) / tile) - 1
    if direction > 0.0:
        tile_line = math.ceil((end + half - grid_start) / tile) - 1
        flush = grid_start + tile_line * tile - half
    else:
        tile_line = math.floor((end - half - grid_start) / tile)
        flush = grid_start + (tile_line + 1) * tile + half
    for tile_line_aside in range(first, last + 1):
        column, row = _turned(along_x, tile_line, tile_line_aside)
        if blocked(state.terrain, state.worlds[world_index].level, column, row, stops):
            return direction * flush
    return math.inf


@inlined
def _stop_at_bodies(
    state: State, body_index: int, along_x: bool, direction: float, middle: float, half: float,
    middle_aside: float, half_aside: float,
) -> float:  # fmt: skip
    """Return where a box's centre, times `direction`, touches the first body ahead; it may overlap others."""
    limit = math.inf
    neighbours = state.near[body_index]
    for neighbour in range(neighbours[0]):
        obstacle = state.boxes[neighbours[neighbour + 1]]
        obstacle_middle, obstacle_aside = _turned(along_x, obstacle[0], obstacle[1])
        obstacle_half, obstacle_half_aside = _turned(along_x, obstacle[2], obstacle[3])
        reach = half + obstacle_half
        beside = abs(middle_aside - obstacle_aside) >= half_aside + obstacle_half_aside - CONTACT_EPS
        if not beside and direction * (obstacle_middle - middle) >= reach - CONTACT_EPS:
            limit = min(limit, direction * obstacle_middle - reach)
    return limit


@inlined
def _is_near(state: State, world_index: int, body_index: int, mover_x: float, mover_y: float) -> bool:
    """Return whether a living body may stop one that is at a point, in this step."""
    reach = state.settings[0].body_reach
    body_x, body_y, _ = body(state, world_index, body_index)
    within_reach = abs(body_x - mover_x) < reach and abs(body_y - mover_y) < reach
    return within_reach and is_alive(state, world_index, body_index)


@inlined
def is_alive(state: State, world_index: int, body_index: int) -> bool:
    if body_index < state.monsters.shape[1]:
        return state.monsters[world_index, body_index].hp > 0.0
    return state.players[world_index, body_index - state.monsters.shape[1]].hp > 0.0


@inlined
def body(
    state: State, world_index: int, body_index: int
) -> tuple[float, float, tuple[float, float, float, float]]:
    """Return a body's position, and its shape: the centre from there, and half sides; monsters come first."""
    if body_index < state.monsters.shape[1]:
        monster = state.monsters[world_index, body_index]
        stats = state.monster_stats[state.worlds[world_index].level, body_index]
        return monster.x, monster.y, (stats.body_x, stats.body_y, stats.half_width, stats.half_height)
    player = state.players[world_index, body_index - state.monsters.shape[1]]
    stats = state.player_stats[body_index - state.monsters.shape[1]]
    return player.x, player.y, (stats.body_x, stats.body_y, stats.half_width, stats.half_height)


@inlined
def box(state: State, world_index: int, body_index: int) -> tuple[float, float, float, float]:
    """Return the centre and half sides of a body."""
    x, y, shape = body(state, world_index, body_index)
    return x + shape[0], y + shape[1], shape[2], shape[3]


@inlined
def blocked(terrain: Array, level: int, column: int, row: int, stops: int) -> bool:
    """Return whether a tile stops a body; tiles off the grid do."""
    if column < 0 or row < 0 or row >= terrain.shape[1] or column >= terrain.shape[2]:
        return True
    return (stops >> terrain[level, row, column]) & 1 != 0
