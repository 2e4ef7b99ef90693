"""The oracle: the rules of one world, slowly and tick by tick, in plain Python, to be read.

The compiled kernel (`pneuma/env/rules.py`) plays the same game; `test_oracle.py` compares them bit for bit.
Every monster lives through every tick, and every move is checked tile by tile and body by body. A tick:

1. Every living player acts, in order.
2. Every living monster, in order, is struck by the players' swords and flames, in their order; if it
   lives, it looks for every player and bites those within reach; then it flies or chases.
3. Every player who was present gets what the tick brought: first what kills heal, then the bites. Who has
   no HP left is dead from the next tick on; until then he stands in the way.

Living bodies stop each other as walls do; nobody pushes. Inputs are the configuration, and what `Worlds` made
of levels and characters (`oracle_arrays.py`). Units: pixels, ticks of 1/60 s; y points down. Axis 0 is x.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import NamedTuple

from pneuma.env.rules import CLEARED, DOWN, KILLED, LEFT, RIGHT, RUNNING, TIME_LIMIT, UP

Pair = tuple[float, float]
"""A number along x and one along y."""
Row = SimpleNamespace
"""Fields of a row of the arrays of `Worlds` that do not change; lists go by facing."""
DIRECTIONS = {DOWN: (0.0, 1.0), LEFT: (-1.0, 0.0), UP: (0.0, -1.0), RIGHT: (1.0, 0.0)}
CONTACT_EPS = 2**-10
"""Bodies that overlap by less only touch: what rounding leaves of a contact stops nobody from turning off."""

# --- Boxes and moves -------------------------------------------------------------------------------


class Box(NamedTuple):
    """A body, or what strikes one: its centre and half its sides, x first."""

    centre: Pair
    half: Pair

    def meets(self, other: Box) -> bool:
        """Return whether two boxes overlap; touching is no overlap."""
        apart = [abs(self.centre[axis] - other.centre[axis]) for axis in (0, 1)]
        return apart[0] < self.half[0] + other.half[0] and apart[1] < self.half[1] + other.half[1]


@dataclass(frozen=True)
class Ground:
    """The tiles of a level: `tiles[row][column]`."""

    corner: Pair
    tile: float
    tiles: list[list[int]]

    def is_closed(self, column: int, row: int, closed: Collection[int]) -> bool:
        """Return whether a tile is of a closed code; everything off the grid is closed."""
        if not (0 <= row < len(self.tiles) and 0 <= column < len(self.tiles[0])):
            return True
        return self.tiles[row][column] in closed

    def covered(self, body: Box, axis: int) -> range:
        """Return the columns or rows that a body lies in, without one that it only touches."""
        low = body.centre[axis] - body.half[axis] - self.corner[axis]
        high = body.centre[axis] + body.half[axis] - self.corner[axis]
        return range(math.floor(low / self.tile), math.ceil(high / self.tile))

    def stop(self, body: Box, axis: int, step: float, closed: Collection[int]) -> float:
        """Return how far along an axis a body's centre gets: flush to a closed tile, or anywhere.

        It looks at the column or row of tiles that the leading edge would enter, as far as the body is wide.
        """
        corner, half = self.corner[axis], body.half[axis]
        if step > 0:
            line = math.ceil((body.centre[axis] + step + half - corner) / self.tile) - 1
            flush = corner + line * self.tile - half
        else:
            line = math.floor((body.centre[axis] + step - half - corner) / self.tile)
            flush = corner + (line + 1) * self.tile + half
        for across in self.covered(body, 1 - axis):
            column, row = (line, across) if axis == 0 else (across, line)
            if self.is_closed(column, row, closed):
                return flush
        return math.copysign(math.inf, step)


def move(
    start: Pair, offset: Pair, half: Pair, steps: Pair, ground: Ground, closed: Collection[int],
    obstacles: Sequence[Box],
) -> Pair:  # fmt: skip
    """Return where a body gets, first along x, then along y, among tiles and the bodies of others.

    On each axis it goes its whole step, or up to the first thing that stops it, and never back. `offset` is
    the centre of its box from its position.
    """
    position = list(start)
    for axis, step in enumerate(steps):
        if step == 0.0:
            continue
        body = Box((position[0] + offset[0], position[1] + offset[1]), half)
        limits = [ground.stop(body, axis, step, closed), *_stops_at_bodies(body, axis, step, obstacles)]
        end = body.centre[axis] + step
        if step > 0 and end > min(limits):
            position[axis] = max(position[axis], min(limits) - offset[axis])
        elif step < 0 and end < max(limits):
            position[axis] = min(position[axis], max(limits) - offset[axis])
        else:
            position[axis] += step
    return position[0], position[1]


def _stops_at_bodies(body: Box, axis: int, step: float, obstacles: Sequence[Box]) -> list[float]:
    """Return where a body's centre touches each body ahead, not one that it passes or is inside."""
    across, direction = 1 - axis, math.copysign(1.0, step)
    stops = []
    for obstacle in obstacles:
        touching = body.half[axis] + obstacle.half[axis]
        aside = abs(body.centre[across] - obstacle.centre[across])
        ahead = (obstacle.centre[axis] - body.centre[axis]) * direction
        if (
            aside < body.half[across] + obstacle.half[across] - CONTACT_EPS
            and ahead >= touching - CONTACT_EPS
        ):
            stops.append(obstacle.centre[axis] - touching * direction)
    return stops


# --- Players and monsters --------------------------------------------------------------------------


@dataclass
class Events:
    """What one step did to a player."""

    reward: float = 0.0
    xp_gained: float = 0.0
    hp_lost: float = 0.0
    hp_gained: float = 0.0
    hits: int = 0
    kills: int = 0
    notices: int = 0
    contacts: int = 0
    distance: float = math.inf  # to the nearest living monster at the end of the step
    died: int = 0
    present: int = 0


class Body:
    """A player or a monster."""

    x: float
    y: float
    hp: float
    stats: Row

    @property
    def box(self) -> Box:
        stats = self.stats
        return Box((self.x + stats.body_x, self.y + stats.body_y), (stats.half_width, stats.half_height))


@dataclass
class Player(Body):
    """A player; dead without HP."""

    stats: Row
    reward: str
    x: float = 0.0
    y: float = 0.0
    hp: float = 0.0
    xp: float = 0.0
    energy: float = 0.0
    facing: int = DOWN
    busy: int = 0
    action_kind: int = 0
    attack: int = 0
    safe: int = 0
    kills: int = 0
    events: Events = field(default_factory=Events)

    def gap_squared(self, x: float, y: float) -> float:
        """Return the squared distance from a point to the body."""
        body = self.box
        across = max(abs(body.centre[0] - x) - body.half[0], 0.0)
        down = max(abs(body.centre[1] - y) - body.half[1], 0.0)
        return across * across + down * down

    def heal(self, hp: float) -> None:
        self.events.hp_gained += hp - self.hp
        self.hp = hp

    def blow(self, strike: Row) -> Row:
        """Return what a sword or flame does in this tick; a swing bears its attack's number."""
        facing = self.facing
        half = (strike.half_width[facing], strike.half_height[facing])
        box = Box((self.x + strike.x[facing], self.y + strike.y[facing]), half)
        hilt = (self.x + strike.hilt_x[facing], self.y + strike.hilt_y[facing])
        return Row(number=self.attack, strike=strike, box=box, hilt=hilt)

    def formula(self) -> float:
        """Return the reward for a step."""
        events = self.events
        if self.reward == "thesis":
            return self.xp - self.hp / self.stats.hp
        if self.reward == "pygame":
            return self.xp + self.hp / self.stats.hp
        if self.reward == "kills":
            return events.xp_gained - events.hp_lost / self.stats.hp
        if self.reward == "distance-sigmoid":
            if events.distance == math.inf:
                return events.xp_gained + 0.0
            z = (150.0 - events.distance) / 50.0
            return events.xp_gained + (0.5 + 0.5 * z / math.sqrt(1.0 + z * z))
        assert self.reward == "godot"
        return events.reward  # kept event by event


@dataclass
class Monster(Body):
    """A monster; lists and sets go by player."""

    stats: Row
    x: float
    y: float
    hp: float
    bite: list[int]
    struck_by: list[int]
    noticed: set[int] = field(default_factory=set)
    knock_x: float = 0.0
    knock_y: float = 0.0
    knocked: int = 0
    safe: int = 0
    inside: set[int] = field(default_factory=set)  # whose strikes met it in the last tick

    def knock_back(self, blow: Row) -> None:
        """Fly from the hilt, unless it flies already; one that is right there stays there."""
        if blow.strike.knock_ticks < 0 or self.knocked > 0:
            return
        source = self.stats if self.stats.knock_ticks >= 0 else blow.strike
        away_x, away_y = self.x - blow.hilt[0], self.y - blow.hilt[1]
        length = math.sqrt(away_x * away_x + away_y * away_y)
        self.knocked, self.knock_x, self.knock_y = source.knock_ticks, 0.0, 0.0
        if length > 0.0:
            self.knock_x = away_x / length * source.knock_speed
            self.knock_y = away_y / length * source.knock_speed

    def approach(self, offset: float) -> float:
        """Return a chasing monster's step on one axis: its full pace, or none within its stand-off."""
        if abs(offset) <= self.stats.stand_off:
            return 0.0
        return math.copysign(self.stats.speed, offset)


# --- The world -------------------------------------------------------------------------------------


class Oracle:
    """One world."""

    def __init__(self, rulebook: Row, key: int) -> None:
        """Make a world by what does not change; see `read_rulebook`."""
        self.rulebook = rulebook
        self.key = key
        self.draws = self.steps = self.level = self.start = 0
        self.monsters_left = self.players_left = 0
        self.ending = RUNNING
        self.players = [
            Player(stats, reward) for stats, reward in zip(rulebook.stats, rulebook.rewards, strict=True)
        ]
        self.monsters: list[Monster] = []

    @property
    def ground(self) -> Ground:
        """The tiles of the level that is played."""
        return self.rulebook.grounds[self.level]

    def seed(self, key: int) -> None:
        """Begin a random stream; XP that outlives episodes starts again from 0."""
        self.key, self.draws = key, 0
        for player in self.players:
            player.xp = 0.0

    def reset(self, start: int) -> None:
        """Begin an episode at a start place, or at a random one if `start` is below zero."""
        rulebook = self.rulebook
        self.steps, self.ending, self.level, self.start = 0, RUNNING, 0, start
        if len(rulebook.starts) > 1:
            self.level = self._draw_below(len(rulebook.starts))
        starts = rulebook.starts[self.level]
        if start < 0:
            self.start = self._draw_below(len(starts))
        for index, player in enumerate(self.players):
            x, y = starts[(self.start + index) % len(starts)]
            fresh = Player(player.stats, player.reward, x, y, events=player.events)
            fresh.hp, fresh.energy = player.stats.hp, player.stats.energy
            if rulebook.config.xp_scope == "forever":
                fresh.xp = player.xp
            self.players[index] = fresh
        self.monsters = []
        for stats, (x, y) in zip(rulebook.monster_stats[self.level], rulebook.homes[self.level], strict=True):
            none_yet = [0] * len(self.players)
            self.monsters.append(Monster(stats, x, y, stats.hp, none_yet, none_yet.copy()))
        self.monsters_left, self.players_left = len(self.monsters), len(self.players)

    def step(self, actions: list[int]) -> bool:
        """Play one agent step; return whether the episode ended with it. After its end nothing happens."""
        for player in self.players:
            player.events = Events()
        if self.ending != RUNNING:
            return False
        for _ in range(self.rulebook.settings.ticks):
            self._tick(actions)
        self.steps += 1
        self._end()
        return self.ending != RUNNING

    def reward(self) -> None:
        """Pay those who were present, once they have observed how the step ended."""
        present = [player for player in self.players if player.events.present]
        for player in present:
            player.events.reward = player.formula()
        if self.rulebook.config.shared_reward:
            total = 0.0  # not by `sum`, which rounds differently from Python 3.12 on
            for player in self.players:
                total += player.events.reward
            for player in present:
                player.events.reward = total / len(self.players)

    def _draw_below(self, bound: int) -> int:
        """Return a random number below a bound, by splitmix64 (Steele, Lea and Flood 2014)."""
        self.draws += 1
        bits = (self.key + self.draws * 0x9E3779B97F4A7C15) % 2**64
        bits = ((bits ^ (bits >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        bits = ((bits ^ (bits >> 27)) * 0x94D049BB133111EB) % 2**64
        return ((bits ^ (bits >> 31)) >> 32) * bound >> 32

    def _end(self) -> None:
        """Decide whether the episode is over, and charge the living for an ending."""
        config = self.rulebook.config
        self.players_left = sum(player.hp > 0.0 for player in self.players)
        self.monsters_left = sum(monster.hp > 0.0 for monster in self.monsters)
        if self.players_left == 0:
            self.ending = KILLED
        elif self.monsters_left == 0 and config.end_on_clear:
            self.ending = CLEARED
        elif self.steps >= config.episode_steps:
            self.ending = TIME_LIMIT
        if self.ending in (CLEARED, TIME_LIMIT):
            for player in self.players:
                if player.hp > 0.0:
                    self._charge(player)

    def _charge(self, player: Player) -> None:
        """Take the XP that an ending costs; the published code then sets the reward to the XP."""
        cost = self.rulebook.config.ending_cost
        if cost != 0.0:
            player.xp -= cost
            player.events.xp_gained -= cost
            player.events.reward = player.xp

    def _tick(self, actions: list[int]) -> None:
        gains = [Row(heal=0.0, bitten=0.0, xp=0.0, kills=0, signs=0, is_paid=False) for _ in self.players]
        blows: dict[int, Row] = {}
        for index, player in enumerate(self.players):
            if player.hp > 0.0:
                blow = self._act(player, actions[index])
                if blow:
                    blows[index] = blow
        present = [index for index, player in enumerate(self.players) if player.hp > 0.0]
        for monster in self.monsters:
            if monster.hp > 0.0:
                self._live(monster, present, blows, gains)
        for index in present:
            self._settle(self.players[index], gains[index])

    # --- A tick: players act ---------------------------------------------------------------------

    def _act(self, player: Player, action: int) -> Row | None:
        """Let a player act, unless an attack or spell still lasts; return what strikes in this tick."""
        stats, name = player.stats, self.rulebook.actions[action]
        blow = None
        if player.busy == 0:
            if name == "attack":
                player.busy, player.action_kind = stats.swing, 1
                player.attack += 1
            elif name == "flame" and player.energy >= stats.flame_cost:
                player.energy -= stats.flame_cost
                player.busy, player.action_kind = stats.flame_ticks, 2
                player.attack += 1
                blow = player.blow(stats.flame)
            elif name == "heal" and player.energy >= stats.heal_cost:
                player.energy -= stats.heal_cost
                player.busy, player.action_kind = stats.heal_ticks, 3
                for patient in self.players:
                    dx, dy = patient.x - player.x, patient.y - player.y
                    near = dx * dx + dy * dy <= stats.heal_reach * stats.heal_reach and stats.heal_reach > 0.0
                    if patient is player or (near and patient.hp > 0.0):
                        patient.heal(max(patient.hp, min(patient.hp + stats.heal, patient.stats.hp)))
            elif action in DIRECTIONS:
                player.facing = action
                player.x, player.y = self.walked(player, self._others(player))
        if player.busy > 0:
            player.busy -= 1
            if player.action_kind == 1:
                blow = player.blow(stats.sword)
        player.energy = min(player.energy + stats.energy_gain, stats.energy)
        return blow

    def walked(self, player: Player, obstacles: list[Box]) -> Pair:
        """Return where one tick of walking the way it faces takes a player among obstacles."""
        stats, (x, y) = player.stats, DIRECTIONS[player.facing]
        steps, offset = (x * stats.speed, y * stats.speed), (stats.body_x, stats.body_y)
        closed = self.rulebook.closed_to_players
        return move((player.x, player.y), offset, player.box.half, steps, self.ground, closed, obstacles)

    def _others(self, mover: Body) -> list[Box]:
        """Return the bodies that stop one: of all others who live."""
        bodies: list[Body] = [*self.players, *self.monsters]
        return [body.box for body in bodies if body is not mover and body.hp > 0.0]

    # --- A tick: monsters live -------------------------------------------------------------------

    def _live(self, monster: Monster, present: list[int], blows: dict[int, Row], gains: list[Row]) -> None:
        """Let a monster live one tick among the players who are present."""
        monster.safe = max(monster.safe - 1, 0)
        for index in range(len(self.players)):
            if index not in present:
                monster.noticed.discard(index)
                monster.bite[index] = 0
        meeting = {index for index, blow in blows.items() if monster.box.meets(blow.box)}
        swords = {index for index in blows if self.players[index].action_kind == 1}
        if self.rulebook.config.blow == "attack":
            swords = set()
        for index in sorted(meeting):
            hit = monster.struck_by[index] != blows[index].number
            if index in swords:
                hit = index not in monster.inside
            if hit and monster.hp > 0.0 and monster.safe == 0:
                self._strike(monster, index, blows[index], present, gains)
        monster.inside = meeting & swords
        if monster.hp <= 0.0:
            return
        target = self._sense(monster, present, gains)
        steps = (0.0, 0.0)
        if monster.knocked > 0:
            monster.knocked -= 1
            steps = monster.knock_x, monster.knock_y
        elif target is not None:
            steps = monster.approach(target.x - monster.x), monster.approach(target.y - monster.y)
        position, offset = (monster.x, monster.y), (monster.stats.body_x, monster.stats.body_y)
        closed, obstacles = self.rulebook.closed_to_monsters, self._others(monster)
        monster.x, monster.y = move(position, offset, monster.box.half, steps, self.ground, closed, obstacles)

    def _strike(
        self, monster: Monster, striker: int, blow: Row, present: list[int], gains: list[Row]
    ) -> None:
        """Strike a living monster that a blow meets for the first time."""
        stats = monster.stats
        monster.struck_by[striker] = blow.number
        monster.safe = stats.safe
        monster.hp = max(monster.hp - blow.strike.damage, 0.0)
        self.players[striker].events.hits += 1
        if monster.hp > 0.0:
            monster.knock_back(blow)
            return
        gains[striker].kills += 1
        for index in present:
            earns = index == striker
            if self.rulebook.config.kill_credit == "near":  # by the attack circle as it was a tick ago
                earns = monster.bite[index] > 0
            if earns:
                gains[index].is_paid = True
                gains[index].xp += stats.xp
                gains[index].heal += stats.heal

    def _sense(self, monster: Monster, present: list[int], gains: list[Row]) -> Player | None:
        """Let a monster look for all players, and bite; return the nearest that it notices.

        In flight it does not bite: what is due then comes when it has landed.
        """
        stats, target, nearest = monster.stats, None, math.inf
        flies = monster.knocked > 0
        for index in present:
            player, gain = self.players[index], gains[index]
            gap = player.gap_squared(monster.x + stats.notice_x, monster.y + stats.notice_y)
            if gap > stats.notice_squared:
                monster.noticed.discard(index)
            else:
                if index not in monster.noticed:
                    player.events.notices += 1
                    gain.signs += 1
                monster.noticed.add(index)
                if gap < nearest:
                    target, nearest = player, gap
            gap = player.gap_squared(monster.x + stats.attack_x, monster.y + stats.attack_y)
            if gap > stats.attack_squared:
                monster.bite[index] = 0
            elif monster.bite[index] > 1:
                monster.bite[index] -= 1
            else:
                if monster.bite[index] == 0:
                    player.events.contacts += 1
                    gain.signs += 1
                monster.bite[index] = 1 if flies else stats.bite_ticks
                # A player who is safe after a bite gets one a tick.
                if not flies and (player.stats.safe == 0 or gain.bitten == 0.0):
                    gain.bitten += stats.damage
        return target

    # --- A tick: what it brought -----------------------------------------------------------------

    def _settle(self, player: Player, gain: Row) -> None:
        """Give a player what a tick brought: XP, what kills heal, then the bites."""
        events = player.events
        events.present += 1
        player.xp += gain.xp
        player.kills += gain.kills
        events.xp_gained += gain.xp
        events.kills += gain.kills
        if gain.is_paid:
            events.reward = player.xp
        events.reward += gain.signs
        player.safe = max(player.safe - 1, 0)
        player.heal(player.hp + gain.heal)
        if gain.bitten > 0.0 and player.safe == 0:
            hp = max(player.hp - gain.bitten, 0.0)
            events.hp_lost += player.hp - hp
            player.hp, player.safe = hp, player.stats.safe
            if player.hp <= 0.0:
                player.busy = player.action_kind = 0
                events.died = 1
                self._charge(player)
