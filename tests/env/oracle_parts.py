"""What the oracle knows of a world: what is given, the ground that bodies move on, and what changes.

Parts of `oracle.py`. Units: pixels, ticks of 1/60 s, pixels a tick; y points down.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pneuma.env.rules import COAST, DOWN, LEFT, RIGHT, SOLID, UP

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
    damage: float
    swing: int
    knock_ticks: int
    knock_speed: float
    safe: int
    sword_x: list[float]
    sword_y: list[float]
    sword_half_width: list[float]
    sword_half_height: list[float]
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
    deadly_coast: int
    credit_near: int
    ending_cost: float
    keep_xp: int
    magic: int
    layout: int
    fixed_order: int
    perceived: int
    middle_x: float
    middle_y: float
    scale_x: float
    scale_y: float
    xp_scale: float


@dataclass(frozen=True)
class Ground:
    """The tiles of a level: `tiles[row][column]`."""

    left: float
    top: float
    tile: float
    tiles: list[list[int]]

    def stops(self, column: int, row: int, coast_stops: bool) -> bool:
        """Tell whether a tile stops a body; what lies off the grid does."""
        if not (0 <= row < len(self.tiles) and 0 <= column < len(self.tiles[0])):
            return True
        code = self.tiles[row][column]
        return code == SOLID or (code == COAST and coast_stops)

    def is_sea(self, x: float, y: float) -> bool:
        """Tell whether a point lies beyond the coast."""
        return self.tiles[int((y - self.top) / self.tile)][int((x - self.left) / self.tile)] == COAST

    def move(
        self, x: float, y: float, half_width: float, half_height: float, dx: float, dy: float, coast: bool
    ) -> tuple[float, float]:
        """Return where a body gets, first along x, then along y; `coast` says whether the coast stops it.

        On each axis it looks at the column or row of tiles that its leading edge would come to lie in,
        as far as the body is wide, and stops flush at the edge of that if any tile of it is closed.
        """
        if dx != 0.0:
            rows = self._covered(y - half_height, y + half_height, self.top)
            column = self._entered(x + dx, half_width, dx, self.left)
            met = any(self.stops(column, row, coast) for row in rows)
            x = self._flush(x, half_width, dx, self.left, column) if met else x + dx
        if dy != 0.0:
            columns = self._covered(x - half_width, x + half_width, self.left)
            row = self._entered(y + dy, half_height, dy, self.top)
            met = any(self.stops(column, row, coast) for column in columns)
            y = self._flush(y, half_height, dy, self.top, row) if met else y + dy
        return x, y

    def _covered(self, low: float, high: float, origin: float) -> range:
        """Return the columns or rows that a stretch lies in; one that it only touches is not among them."""
        return range(math.floor((low - origin) / self.tile), math.ceil((high - origin) / self.tile))

    def _entered(self, centre: float, half: float, step: float, origin: float) -> int:
        """Return the column or row in which the leading edge lies after a step to `centre`."""
        if step > 0:
            return math.ceil((centre + half - origin) / self.tile) - 1
        return math.floor((centre - half - origin) / self.tile)

    def _flush(self, centre: float, half: float, step: float, origin: float, cell: int) -> float:
        """Return a centre whose leading edge touches a closed column or row, or the old one: never back."""
        if step > 0:
            return max(centre, origin + cell * self.tile - half)
        return min(centre, origin + (cell + 1) * self.tile + half)


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


@dataclass(frozen=True)
class Blow:
    """What a player strikes with in one tick: a box, and what it does to a monster that it meets."""

    number: int
    facing: int
    x: float
    y: float
    half_width: float
    half_height: float
    damage: float
    knock_speed: float
    knock_ticks: int  # below 0: it knocks nobody back


@dataclass
class Gain:
    """What one tick brings a player, until it is settled at the end of the tick."""

    spell_heal: float = 0.0
    kill_heal: float = 0.0
    bitten: float = 0.0
    xp: float = 0.0
    hits: int = 0
    kills: int = 0
    notices: int = 0
    contacts: int = 0
    deaths: int = 0  # of monsters, whoever killed them


# --- What is done to them ---------------------------------------------------------------------------


def die(player: Player) -> None:
    player.hp = 0.0
    player.busy = player.armed = 0
    player.events.died = 1


def sword_blow(player: Player) -> Blow:
    """Return the blow of a swing that lasts; all its ticks bear the number of the attack."""
    stats, facing = player.stats, player.facing
    return Blow(
        number=player.attack,
        facing=facing,
        x=player.x + stats.sword_x[facing],
        y=player.y + stats.sword_y[facing],
        half_width=stats.sword_half_width[facing],
        half_height=stats.sword_half_height[facing],
        damage=stats.damage,
        knock_speed=stats.knock_speed,
        knock_ticks=stats.knock_ticks,
    )


def flame_blow(player: Player) -> Blow:
    """Return the blow of a flame, which burns in the tick in which it is cast and knocks nobody back."""
    stats, facing = player.stats, player.facing
    return Blow(
        number=player.attack,
        facing=facing,
        x=player.x + stats.flame_x[facing],
        y=player.y + stats.flame_y[facing],
        half_width=stats.flame_half_width[facing],
        half_height=stats.flame_half_height[facing],
        damage=stats.flame_damage,
        knock_speed=0.0,
        knock_ticks=-1,
    )


def knock_back(monster: Monster, blow: Blow) -> None:
    """Let a monster fly from the centre of the box; if it is right there, the way the player faces."""
    if blow.knock_ticks < 0:
        return
    kind = monster.kind
    own = kind.knock_ticks >= 0
    speed = kind.knock_speed if own else blow.knock_speed
    away_x, away_y = monster.x - blow.x, monster.y - blow.y
    length = math.sqrt(away_x * away_x + away_y * away_y)
    if length == 0.0:
        (away_x, away_y), length = WAYS[blow.facing], 1.0
    monster.knock_x = away_x / length * speed
    monster.knock_y = away_y / length * speed
    monster.knocked = kind.knock_ticks if own else blow.knock_ticks


def gap_squared(monster: Monster, player: Player) -> float:
    """Return the squared distance from a monster's centre to a player's body box."""
    across = max(abs(player.x - monster.x) - player.stats.half_width, 0.0)
    down = max(abs(player.y - monster.y) - player.stats.half_height, 0.0)
    return across * across + down * down


def approach(offset: float, kind: Kind) -> float:
    """Return a chasing monster's step on one axis: its full pace, or none within its stand-off."""
    if offset > kind.stand_off:
        return kind.speed
    if offset < -kind.stand_off:
        return -kind.speed
    return 0.0
