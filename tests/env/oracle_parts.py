"""What the oracle knows of a world: what is given, what changes, and what is done to players and monsters.

Parts of `oracle.py`. Units: pixels, ticks of 1/60 s, pixels a tick; y points down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace

from pneuma.env.fields import EnvConfig
from pneuma.env.rules import DOWN, LEFT, RIGHT, UP

from .oracle_moves import Box, Ground

WAYS = {DOWN: (0.0, 1.0), LEFT: (-1.0, 0.0), UP: (0.0, -1.0), RIGHT: (1.0, 0.0)}

# --- What is given ---------------------------------------------------------------------------------


Row = SimpleNamespace
"""Fields of a player, a monster or the world that do not change: a row of the arrays of `Worlds`.

What they mean is in `pneuma/env/state.py`; lists go by facing.
"""


@dataclass(frozen=True)
class Rulebook:
    """Everything that does not change while a world is played; the last four go by level."""

    config: EnvConfig
    actions: tuple[str, ...]
    rewards: tuple[str, ...]  # of each player
    closed_to_players: frozenset[int]  # the codes of tiles that stop them
    closed_to_monsters: frozenset[int]
    settings: Row  # ticks, and scales of what is seen
    stats: list[Row]
    kinds: list[list[Row]]
    grounds: list[Ground]
    starts: list[list[tuple[float, float]]]
    homes: list[list[tuple[float, float]]]  # of the monsters


# --- What changes ----------------------------------------------------------------------------------


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
    distance: float = math.inf  # to the nearest living monster, as seen at the end of the step
    died: int = 0
    present: int = 0


@dataclass(frozen=True)
class Blow:
    """What a player strikes with in one tick, and what it does to a monster that it meets."""

    number: int
    box: Box
    hilt: tuple[float, float]  # what it knocks away from
    damage: float
    knock_speed: float
    knock_ticks: int  # below 0: it knocks nobody back


@dataclass
class Player:
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

    @property
    def box(self) -> Box:
        """The player's body."""
        stats = self.stats
        return Box((self.x + stats.body_x, self.y + stats.body_y), (stats.half_width, stats.half_height))

    def gap_squared(self, x: float, y: float) -> float:
        """Return the squared distance from a point to the body."""
        body = self.box
        across = max(abs(body.centre[0] - x) - body.half[0], 0.0)
        down = max(abs(body.centre[1] - y) - body.half[1], 0.0)
        return across * across + down * down

    def die(self) -> None:
        self.hp = 0.0
        self.busy = self.action_kind = 0
        self.events.died = 1

    def heal(self, hp: float, capped: bool) -> None:
        """Give HP; where they are capped, up to full HP, and never fewer than it has."""
        healed = self.hp + hp
        if capped:
            healed = max(self.hp, min(healed, self.stats.hp))
        self.events.hp_gained += healed - self.hp
        self.hp = healed

    def blow(self, strike: Row) -> Blow:
        """Return what a sword or flame does in this tick; a swing bears its attack's number."""
        facing = self.facing
        return Blow(
            number=self.attack,
            box=Box(
                (self.x + strike.x[facing], self.y + strike.y[facing]),
                (strike.half_width[facing], strike.half_height[facing]),
            ),
            hilt=(self.x + strike.hilt_x[facing], self.y + strike.hilt_y[facing]),
            damage=strike.damage,
            knock_speed=strike.knock_speed,
            knock_ticks=strike.knock_ticks,
        )

    def formula(self) -> float:
        """Return the reward for a step; `pneuma/env/reward.py` says the formulas in words."""
        stats, events = self.stats, self.events
        if self.reward == "thesis":
            return self.xp - self.hp / stats.hp
        if self.reward == "pygame":
            return self.xp + self.hp / stats.hp
        if self.reward == "kills":
            return events.xp_gained - events.hp_lost / stats.hp
        if self.reward == "distance-sigmoid":
            if events.distance == math.inf:
                return events.xp_gained + 0.0
            z = (150.0 - events.distance) / 50.0
            return events.xp_gained + (0.5 + 0.5 * z / math.sqrt(1.0 + z * z))
        assert self.reward == "godot"
        return events.reward  # kept event by event


@dataclass
class Monster:
    """A monster; lists and the set go by player."""

    kind: Row
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

    @property
    def box(self) -> Box:
        """The monster's body."""
        kind = self.kind
        return Box((self.x + kind.body_x, self.y + kind.body_y), (kind.half_width, kind.half_height))

    def knock_back(self, blow: Blow) -> None:
        """Fly from the hilt, unless it flies already; one that is right there stays there."""
        if blow.knock_ticks < 0 or self.knocked > 0:
            return
        kind = self.kind
        own = kind.knock_ticks >= 0
        speed = kind.knock_speed if own else blow.knock_speed
        away_x, away_y = self.x - blow.hilt[0], self.y - blow.hilt[1]
        length = math.sqrt(away_x * away_x + away_y * away_y)
        self.knock_x = away_x / length * speed if length > 0.0 else 0.0
        self.knock_y = away_y / length * speed if length > 0.0 else 0.0
        self.knocked = kind.knock_ticks if own else blow.knock_ticks

    def approach(self, offset: float) -> float:
        """Return a chasing monster's step on one axis: its full pace, or none within its stand-off."""
        if offset > self.kind.stand_off:
            return self.kind.speed
        if offset < -self.kind.stand_off:
            return -self.kind.speed
        return 0.0


@dataclass
class Gain:
    """What one tick brings a player, until it is settled at the end of the tick."""

    kill_heal: float = 0.0
    bitten: float = 0.0
    xp: float = 0.0
    hits: int = 0
    kills: int = 0
    notices: int = 0
    contacts: int = 0
    deaths: int = 0  # of monsters that paid the player
