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
from pneuma.env.state import Array, State, World

DOWN, LEFT, UP, RIGHT, ATTACK, FLAME, HEAL = 0, 1, 2, 3, 4, 5, 6
BLADE, BURNING, HEALING = 1, 2, 3
"""What a busy player does: attack with its sword, or cast a spell."""
OPEN, SOLID, COAST = 0, 1, 2
RUNNING, KILLED, CLEARED, TIME_LIMIT = 0, 1, 2, 3

CONTACT_EPS = 2.0**-10
"""Pixels by which bodies may overlap and still count as touching, as sums of floats are not exact."""


# --- Random numbers ------------------------------------------------------------------------------


@inlined
def _random_below(episode: Array, bound: int) -> Any:
    """Return a random integer in [0, bound), for bounds far below 2**32: splitmix64 at (key, counter).

    Steele, Lea and Flood (2014), "Fast splittable pseudorandom number generators".
    """
    episode.draws += np.uint64(1)
    mixed = episode.key + episode.draws * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    high_bits = (mixed ^ (mixed >> np.uint64(31))) >> np.uint64(32)
    return np.int64((high_bits * np.uint64(bound)) >> np.uint64(32))


# --- Reset ---------------------------------------------------------------------------------------


@inlined
def begin_episode(state: State, world_index: int, start_index: int) -> None:
    """Start an episode in one world, at a start place; below zero asks for one at random."""
    levels, starts, _ = state.starts.shape
    episode = state.worlds[world_index]
    episode.steps = 0
    episode.ending = RUNNING
    episode.monsters_left = state.monsters.shape[1]
    episode.players_left = state.players.shape[1]
    episode.level = 0
    if levels > 1:
        episode.level = _random_below(episode, levels)
    episode.start = start_index
    if start_index < 0:
        episode.start = _random_below(episode, starts)
    for player_index in range(state.players.shape[1]):
        player = state.players[world_index, player_index]
        kept_xp = player.xp
        state.players[world_index, player_index] = state.first_players[player_index]
        if state.settings[0].keep_xp:
            player.xp = kept_xp
        start = state.starts[episode.level, (episode.start + player_index) % starts]
        player.x = start[0]
        player.y = start[1]
        slot = state.slots[world_index, player_index]
        slot.returns = 0.0
        slot.lengths = 0
        slot.idle = False
    for monster_index in range(state.monsters.shape[1]):
        state.monsters[world_index, monster_index] = state.first_monsters[episode.level, monster_index]
    state.tallies[world_index] = state.no_tally[0]
    for action in range(state.action_counts.shape[1]):
        state.action_counts[world_index, action] = 0


# --- One step ------------------------------------------------------------------------------------


@inlined_early
def step_world(world: World, actions: Array) -> bool:
    """Advance a running world by one agent step; return whether its episode ended."""
    episode = world.episode
    settings = world.settings
    active = _gather_active(world)
    pack_bodies(world)
    for active_index in range(active):
        _list_neighbours(world, np.int64(world.scratch[active_index].order))
    for body_index in range(len(world.monsters), len(world.boxes)):
        _list_neighbours(world, body_index)
    for _ in range(settings.ticks):
        for player_index in range(len(world.players)):
            _begin_tick(world, player_index, actions[player_index])
        for active_index in range(active):
            monster_index = np.int64(world.scratch[active_index].order)
            if world.monsters[monster_index].hp > 0.0:
                _tick_monster(world, monster_index)
        for player_index in range(len(world.players)):
            if world.tick[player_index].is_present:
                _end_tick(world, player_index)
    episode.players_left = 0
    for player_index in range(len(world.players)):
        episode.players_left += world.players[player_index].hp > 0.0
    episode.steps += 1
    if episode.players_left == 0:
        episode.ending = KILLED
    elif episode.monsters_left == 0 and settings.end_on_clear:
        episode.ending = CLEARED
    elif episode.steps >= settings.episode_steps:
        episode.ending = TIME_LIMIT
    if episode.ending == CLEARED or episode.ending == TIME_LIMIT:
        for player_index in range(len(world.players)):
            if world.players[player_index].hp > 0.0:
                _charge(world, player_index)
    return episode.ending != RUNNING


@inlined
def _charge(world: World, player_index: int) -> None:
    """Subtract the XP that an ending costs; in the published code the reward is then set to the XP."""
    player = world.players[player_index]
    event = world.events[player_index]
    cost = world.settings.ending_cost
    if cost != 0.0:
        player.xp -= cost
        event.xp_gained -= cost
        event.reward = player.xp


@inlined
def _gather_active(world: World) -> int:
    """List in `scratch` the monsters to which anything can happen in the next step; return their number.

    The others stand still and only block those that move. Leaving them out changes no bit and saves most of
    the time.
    """
    active_count = 0
    for monster_index in range(len(world.monsters)):
        monster = world.monsters[monster_index]
        if monster.hp > 0.0 and _may_act(world, monster_index):
            world.scratch[active_count].order = monster_index
            active_count += 1
    return active_count


@inlined
def _list_neighbours(world: World, body_index: int) -> None:
    """List in `neighbours` the living bodies that are near enough to stop another one in this step."""
    reach = world.settings.body_reach
    mover = world.boxes[body_index]
    neighbours = world.neighbours[body_index]
    neighbours[0] = 0
    for other_index in range(len(world.boxes)):
        other_box = world.boxes[other_index]
        near_x = abs(other_box.place[0] - mover.place[0]) < reach
        near_y = abs(other_box.place[1] - mover.place[1]) < reach
        if other_index != body_index and near_x and near_y and other_box.alive:
            neighbours[0] += 1
            neighbours[neighbours[0]] = other_index


@inlined
def pack_bodies(world: World) -> None:
    """Write all bodies to `boxes`, where moving bodies and rays look for them; monsters come first."""
    monsters = len(world.monsters)
    for monster_index in range(monsters):
        _pack(world.boxes[monster_index], world.monsters[monster_index], world.monster_stats[monster_index])
    for player_index in range(len(world.players)):
        pack_player(world, player_index)


@inlined
def pack_player(world: World, player_index: int) -> None:
    box = world.boxes[len(world.monsters) + player_index]
    _pack(box, world.players[player_index], world.player_stats[player_index])


@inlined
def _pack(box: Array, body: Array, stats: Array) -> None:
    box.alive = body.hp > 0.0
    box.place[0] = body.x
    box.place[1] = body.y
    box.offset[0] = stats.body_x
    box.offset[1] = stats.body_y
    box.half[0] = stats.half_width
    box.half[1] = stats.half_height


@inlined
def _may_act(world: World, monster_index: int) -> bool:
    monster = world.monsters[monster_index]
    monster_stats = world.monster_stats[monster_index]
    if monster.knocked > 0 or monster.safe > 0 or monster.noticed or monster.inside:
        return True
    for player_index in range(len(world.players)):
        if monster.bite[player_index] > 0:
            return True
        player = world.players[player_index]
        squared_gap = _squared_gap(monster.x, monster.y, player, world.player_stats[player_index])
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
def _begin_tick(world: World, player_index: int, action: int) -> None:
    """Let a living player act, and record what it strikes."""
    player = world.players[player_index]
    player_stats = world.player_stats[player_index]
    tick = world.tick[player_index]
    tick.is_present = player.hp > 0.0
    tick.strikes = 0
    if not tick.is_present:
        return
    tick.xp = tick.healed = tick.bitten = 0.0
    tick.notices = tick.contacts = tick.paid = 0
    if player.busy == 0:
        _act(world, player_index, action)
    if player.busy > 0:
        player.busy -= 1
        if player.action_kind == BLADE:
            tick.strikes = BLADE
    player.energy = min(player.energy + player_stats.energy_gain, player_stats.energy)
    world.events[player_index].present += 1


@inlined
def _act(world: World, player_index: int, action: int) -> None:
    """Let an idle player walk for a tick, or start an attack, or a spell that it can pay for."""
    player = world.players[player_index]
    player_stats = world.player_stats[player_index]
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
            world.tick[player_index].strikes = BURNING  # in this tick only
    elif action == HEAL:
        if player.energy >= player_stats.heal_cost:
            player.energy -= player_stats.heal_cost
            player.busy = player_stats.heal_ticks
            player.action_kind = HEALING
            for patient_index in range(len(world.players)):
                patient = world.players[patient_index]
                if patient_index == player_index or _within_heal(patient, player, player_stats.heal_reach):
                    event = world.events[patient_index]
                    _heal(patient, world.player_stats[patient_index], event, player_stats.heal)
    else:
        player.facing = action
        player.x, player.y = walk(world, player_index, np.bool_(True))


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


@inlined
def walk(world: World, player_index: int, among_bodies: bool) -> tuple[float, float]:
    """Return where a player is after walking for one tick in the direction it faces."""
    facing = world.players[player_index].facing
    speed = world.player_stats[player_index].speed
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
    body_index = len(world.monsters) + player_index
    return move(world, body_index, step_x, step_y, world.settings.player_stops, among_bodies)


# --- A tick: monsters are struck, sense, bite and move -------------------------------------------


@inlined
def _tick_monster(world: World, monster_index: int) -> None:
    monster = world.monsters[monster_index]
    monster_stats = world.monster_stats[monster_index]
    if monster.safe > 0:
        monster.safe -= 1
    for player_index in range(len(world.players)):
        _take_strike(world, monster_index, player_index)
    if monster.hp <= 0.0:
        return
    target = -1
    nearest = math.inf
    for player_index in range(len(world.players)):
        if world.tick[player_index].is_present:
            squared_gap = _sense(world, monster_index, player_index)
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
        player = world.players[target]
        step_x = _approach(player.x - monster.x, monster_stats.stand_off, monster_stats.speed)
        step_y = _approach(player.y - monster.y, monster_stats.stand_off, monster_stats.speed)
    if step_x != 0.0 or step_y != 0.0:
        stops = world.settings.monster_stops
        monster.x, monster.y = move(world, monster_index, step_x, step_y, stops, np.bool_(True))


@inlined
def _take_strike(world: World, monster_index: int, player_index: int) -> None:
    """Let a player's strike hit a monster: once per attack, or each time that it enters the sword's box."""
    monster = world.monsters[monster_index]
    tick = world.tick[player_index]
    player_bit = np.uint8(1 << player_index)
    is_struck = tick.is_present and tick.strikes and _is_struck(world, monster_index, player_index)
    if not tick.is_present:
        monster.noticed &= ~player_bit
        monster.bite[player_index] = 0
    was_inside = monster.inside & player_bit
    monster.inside &= ~player_bit
    if not is_struck:
        return
    is_first = monster.struck_by[player_index] != world.players[player_index].attack
    if world.settings.hit_on_entry and tick.strikes == BLADE:
        is_first = not was_inside
        monster.inside |= player_bit
    if is_first and monster.safe == 0 and monster.hp > 0.0:
        _apply_hit(world, monster_index, player_index)


@inlined
def _strike(world: World, player_index: int) -> Array:
    """Return what a player strikes with."""
    player_stats = world.player_stats[player_index]
    if world.tick[player_index].strikes == BURNING:
        return player_stats.flame
    return player_stats.sword


@inlined
def _is_struck(world: World, monster_index: int, player_index: int) -> bool:
    """Return whether the box of a player's strike overlaps a monster's body."""
    monster = world.monsters[monster_index]
    monster_stats = world.monster_stats[monster_index]
    player = world.players[player_index]
    strike = _strike(world, player_index)
    x = player.x + strike.x[player.facing]
    y = player.y + strike.y[player.facing]
    width = strike.half_width[player.facing] + monster_stats.half_width
    height = strike.half_height[player.facing] + monster_stats.half_height
    across = abs(monster.x + monster_stats.body_x - x) < width
    return across and abs(monster.y + monster_stats.body_y - y) < height


@inlined
def _apply_hit(world: World, monster_index: int, player_index: int) -> None:
    """Apply a player's strike to a monster."""
    monster = world.monsters[monster_index]
    player = world.players[player_index]
    monster_stats = world.monster_stats[monster_index]
    strike = _strike(world, player_index)
    monster.struck_by[player_index] = player.attack
    monster.safe = monster_stats.safe
    monster.hp = max(monster.hp - strike.damage, 0.0)
    world.events[player_index].hits += 1
    if monster.hp <= 0.0:
        world.boxes[monster_index].alive = False
        _credit_kill(world, monster_index, player_index)
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
def _credit_kill(world: World, monster_index: int, striker: int) -> None:
    """Credit a kill to the player who struck, or to all players within the attack circle."""
    monster = world.monsters[monster_index]
    monster_stats = world.monster_stats[monster_index]
    world.episode.monsters_left -= 1
    world.players[striker].kills += 1
    world.events[striker].kills += 1
    for player_index in range(len(world.players)):
        earns = player_index == striker
        if world.settings.credit_near:
            earns = monster.bite[player_index] > 0
        tick = world.tick[player_index]
        if tick.is_present and earns:
            tick.paid = 1
            tick.xp += monster_stats.xp
            tick.healed += monster_stats.heal


@inlined
def _sense(world: World, monster_index: int, player_index: int) -> float:
    """Notice a player, and bite it if it is near enough; return the squared distance to it."""
    monster = world.monsters[monster_index]
    monster_stats = world.monster_stats[monster_index]
    player = world.players[player_index]
    player_stats = world.player_stats[player_index]
    tick = world.tick[player_index]
    player_bit = np.uint8(1 << player_index)
    notice_x = monster.x + monster_stats.notice_x
    notice_y = monster.y + monster_stats.notice_y
    squared_gap = _squared_gap(notice_x, notice_y, player, player_stats)
    if squared_gap > monster_stats.notice_squared:
        monster.noticed &= ~player_bit
    elif not monster.noticed & player_bit:
        monster.noticed |= player_bit
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
            if (
                player_stats.safe == 0 or tick.bitten == 0.0
            ):  # one bite per tick for players who are safe after it
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
def _end_tick(world: World, player_index: int) -> None:
    """Apply the tick's results to a player: first healing, then bites."""
    player = world.players[player_index]
    player_stats = world.player_stats[player_index]
    event = world.events[player_index]
    tick = world.tick[player_index]
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
        world.boxes[len(world.monsters) + player_index].alive = False
        _charge(world, player_index)


# --- Statistics of episodes ----------------------------------------------------------------------


@inlined
def record_step(world: World, actions: Array) -> None:
    """Add a step, with its rewards, to a world's `slots`, `tally` and `action_counts`.

    A player's episode ends with its death, or with its world. From the next step until the world ends its
    slot is idle.
    """
    episode = world.episode
    rewards = hp_lost = 0.0
    for player_index in range(len(world.players)):
        slot = world.slots[player_index]
        event = world.events[player_index]
        has_died = world.players[player_index].hp <= 0.0
        present = event.present > 0
        if present:
            slot.returns += event.reward
            slot.lengths += 1
            slot.ending = episode.ending
            if has_died:
                slot.ending = KILLED
            slot.episodes += slot.ending != RUNNING
            world.action_counts[actions[player_index]] += 1
        slot.begins = slot.ending != RUNNING
        slot.idle = has_died and not present
        rewards += event.reward
        hp_lost += event.hp_lost
    tally = world.tally
    tally.returns += rewards / len(world.players)
    tally.hp_lost += hp_lost / len(world.players)
    if episode.monsters_left == 0 and tally.cleared == 0:
        tally.cleared = episode.steps


# --- Moving --------------------------------------------------------------------------------------


@kernel
def move(
    world: World, body_index: int, step_x: float, step_y: float, stops: int, among_bodies: bool
) -> tuple[float, float]:
    """Move a body's box, x first, in terrain, and among other bodies if asked for; return its place.

    `stops` has a bit for each code of terrain that stops it.
    """
    box_place = world.boxes[body_index].place
    distances = step_x, step_y
    for axis in range(2):
        if distances[axis] != 0.0:
            box_place[axis] = _moved_along(world, body_index, axis, distances[axis], stops, among_bodies)
    return box_place[0], box_place[1]


@inlined
def _moved_along(
    world: World, body_index: int, axis: int, distance: float, stops: int, among_bodies: bool
) -> float:
    """Return x, or y, after a move along it, stopped flush at the first obstacle."""
    mover = world.boxes[body_index]
    start = mover.place[axis]
    offset = mover.offset[axis]
    end = start + offset + distance
    direction = -1.0
    if distance > 0.0:
        direction = 1.0
    limit = _stop_at_tiles(world, mover, axis, direction, end, stops)
    if among_bodies:
        limit = min(limit, _stop_at_bodies(world, body_index, axis, direction))
    if direction * end <= limit:
        return start + distance
    if distance > 0.0:
        return max(start, limit - offset)
    return min(start, -limit - offset)


@inlined
def _stop_at_tiles(world: World, mover: Array, axis: int, direction: float, end: float, stops: int) -> float:
    """Return where a box's centre, times `direction`, is flush with tiles its leading edge would enter."""
    aside = 1 - axis
    tile = world.settings.tile
    corner = world.settings.corner
    half = mover.half[axis]
    middle_aside = mover.place[aside] + mover.offset[aside]
    first_line = math.floor((middle_aside - mover.half[aside] - corner[aside]) / tile)
    last_line = math.ceil((middle_aside + mover.half[aside] - corner[aside]) / tile) - 1
    if direction > 0.0:
        tile_line = math.ceil((end + half - corner[axis]) / tile) - 1
        flush = corner[axis] + tile_line * tile - half
    else:
        tile_line = math.floor((end - half - corner[axis]) / tile)
        flush = corner[axis] + (tile_line + 1) * tile + half
    for tile_line_aside in range(first_line, last_line + 1):
        column, row = tile_line, tile_line_aside
        if axis == 1:
            column, row = tile_line_aside, tile_line
        if blocked(world.terrain, column, row, stops):
            return direction * flush
    return math.inf


@inlined
def _stop_at_bodies(world: World, body_index: int, axis: int, direction: float) -> float:
    """Return where a box's centre, times `direction`, touches the first body ahead; it may overlap others."""
    mover = world.boxes[body_index]
    aside = 1 - axis
    middle = mover.place[axis] + mover.offset[axis]
    middle_aside = mover.place[aside] + mover.offset[aside]
    limit = math.inf
    neighbours = world.neighbours[body_index]
    for neighbour in range(neighbours[0]):
        obstacle = world.boxes[neighbours[neighbour + 1]]
        ahead = direction * (obstacle.place[axis] + obstacle.offset[axis] - middle)
        reach = mover.half[axis] + obstacle.half[axis]
        apart = abs(middle_aside - (obstacle.place[aside] + obstacle.offset[aside]))
        passes_by = apart >= mover.half[aside] + obstacle.half[aside] - CONTACT_EPS
        if obstacle.alive and not passes_by and ahead >= reach - CONTACT_EPS:
            limit = min(limit, direction * (obstacle.place[axis] + obstacle.offset[axis]) - reach)
    return limit


@inlined
def blocked(terrain: Array, column: int, row: int, stops: int) -> bool:
    """Return whether a tile stops a body; tiles off the grid do."""
    if column < 0 or row < 0 or row >= terrain.shape[0] or column >= terrain.shape[1]:
        return True
    return (stops >> terrain[row, column]) & 1 != 0
