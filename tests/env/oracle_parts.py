"""What the oracle knows of a world: what is given, what changes, and what is done to players and monsters.

Parts of `oracle.py`. Units: pixels, ticks of 1/60 s, pixels a tick; y points down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pneuma.env.rules import DOWN, LEFT, RIGHT, UP

from .oracle_moves import Box, Ground

WAYS = {DOWN: (0.0, 1.0), LEFT: (-1.0, 0.0), UP: (0.0, -1.0), RIGHT: (1.0, 0.0)}

# --- What is given ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlayerStats:
    """What a player's class, weapon and spells can do; lists go by facing."""

    hp: float
    energy: float
    energy_gain: float
    speed: float
    half_width: float
    half_height: float
    body_x: float  # the box's centre from the position
    body_y: float
    damage: float
    swing: int
    knock_ticks: int
    knock_speed: float
    safe: int
    sword_x: list[float]
    sword_y: list[float]
    sword_half_width: list[float]
    sword_half_height: list[float]
    hilt_x: list[float]  # what a sword knocks away from, from the position
    hilt_y: list[float]
    flame_ticks: int
    heal_ticks: int
    flame_damage: float
    flame_cost: float
    flame_x: list[float]
    flame_y: list[float]
    flame_half_width: list[float]
    flame_half_height: list[float]
    heal: float
    heal_cost: float
    reward: int
    hp_scale: float
    energy_scale: float


@dataclass(frozen=True)
class Kind:
    """What a monster is like, where it lives, and how it is seen."""

    home_x: float
    home_y: float
    hp: float
    speed: float
    half_width: float
    half_height: float
    body_x: float  # the centres of box and circles from the position
    body_y: float
    notice_x: float
    notice_y: float
    attack_x: float
    attack_y: float
    notice_squared: float
    attack_squared: float
    stand_off: float
    damage: float
    bite_ticks: int
    safe: int
    knock_ticks: int  # below 0: it flies as the weapon has it
    knock_speed: float
    xp: float
    heal: float
    perceived: int
    hp_scale: float
    distance_scale: float
    xp_scale: float


@dataclass(frozen=True)
class Settings:
    """What holds for the whole world."""

    ticks: int
    step_limit: int
    end_on_clear: int
    bodies_block: int
    player_stops: int  # bit c: tiles of code c stop players
    monster_stops: int
    deadly_coast: int
    bite_while_knocked: int
    healing_cap: int
    credit_near: int
    ending_cost: float
    keep_xp: int
    magic: bool
    layout: int
    observe_facing: int
    fixed_order: int
    perceived: int
    middle_x: float
    middle_y: float
    scale_x: float
    scale_y: float
    xp_scale: float


@dataclass(frozen=True)
class Rulebook:
    """Everything that does not change while a world is played; the last three go by level."""

    settings: Settings
    stats: list[PlayerStats]
    kinds: list[list[Kind]]
    grounds: list[Ground]
    starts: list[list[tuple[float, float]]]


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


@dataclass
class Player:
    """A player; dead without HP."""

    stats: PlayerStats
    x: float = 0.0
    y: float = 0.0
    hp: float = 0.0
    xp: float = 0.0
    energy: float = 0.0
    facing: int = DOWN
    busy: int = 0
    armed: int = 0
    attack: int = 0
    safe: int = 0
    kills: int = 0
    events: Events = field(default_factory=Events)

    @property
    def box(self) -> Box:
        """The player's body."""
        stats = self.stats
        return Box((self.x + stats.body_x, self.y + stats.body_y), (stats.half_width, stats.half_height))


@dataclass
class Monster:
    """A monster; lists and the set go by player."""

    kind: Kind
    bite: list[int]
    struck_by: list[int]
    noticed: set[int] = field(default_factory=set)
    x: float = 0.0
    y: float = 0.0
    hp: float = 0.0
    knock_x: float = 0.0
    knock_y: float = 0.0
    knocked: int = 0
    safe: int = 0

    @property
    def box(self) -> Box:
        """The monster's body."""
        kind = self.kind
        return Box((self.x + kind.body_x, self.y + kind.body_y), (kind.half_width, kind.half_height))


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


# --- What is done to them ---------------------------------------------------------------------------


def die(player: Player) -> None:
    player.hp = 0.0
    player.busy = player.armed = 0
    player.events.died = 1


def heal(player: Player, hp: float, capped: bool) -> None:
    """Give a player HP; where they are capped, up to full HP, and never fewer than it has."""
    healed = player.hp + hp
    if capped:
        healed = max(player.hp, min(healed, player.stats.hp))
    player.events.hp_gained += healed - player.hp
    player.hp = healed


def sword_blow(player: Player) -> Blow:
    """Return the blow of a swing that lasts; all its ticks bear the number of the attack."""
    stats, facing = player.stats, player.facing
    return Blow(
        number=player.attack,
        box=Box(
            (player.x + stats.sword_x[facing], player.y + stats.sword_y[facing]),
            (stats.sword_half_width[facing], stats.sword_half_height[facing]),
        ),
        hilt=(player.x + stats.hilt_x[facing], player.y + stats.hilt_y[facing]),
        damage=stats.damage,
        knock_speed=stats.knock_speed,
        knock_ticks=stats.knock_ticks,
    )


def flame_blow(player: Player) -> Blow:
    """Return the blow of a flame, which burns in the tick in which it is cast and knocks nobody back."""
    stats, facing = player.stats, player.facing
    return Blow(
        number=player.attack,
        box=Box(
            (player.x + stats.flame_x[facing], player.y + stats.flame_y[facing]),
            (stats.flame_half_width[facing], stats.flame_half_height[facing]),
        ),
        hilt=(player.x, player.y),
        damage=stats.flame_damage,
        knock_speed=0.0,
        knock_ticks=-1,
    )


def knock_back(monster: Monster, blow: Blow) -> None:
    """Let a monster fly from the hilt, unless it flies already; one that is right there stays there."""
    if blow.knock_ticks < 0 or monster.knocked > 0:
        return
    kind = monster.kind
    own = kind.knock_ticks >= 0
    speed = kind.knock_speed if own else blow.knock_speed
    away_x, away_y = monster.x - blow.hilt[0], monster.y - blow.hilt[1]
    length = math.sqrt(away_x * away_x + away_y * away_y)
    monster.knock_x = away_x / length * speed if length > 0.0 else 0.0
    monster.knock_y = away_y / length * speed if length > 0.0 else 0.0
    monster.knocked = kind.knock_ticks if own else blow.knock_ticks


def gap_squared(player: Player, x: float, y: float) -> float:
    """Return the squared distance from a point to a player's body."""
    body = player.box
    across = max(abs(body.centre[0] - x) - body.half[0], 0.0)
    down = max(abs(body.centre[1] - y) - body.half[1], 0.0)
    return across * across + down * down


def approach(offset: float, kind: Kind) -> float:
    """Return a chasing monster's step on one axis: its full pace, or none within its stand-off."""
    if offset > kind.stand_off:
        return kind.speed
    if offset < -kind.stand_off:
        return -kind.speed
    return 0.0
