"""Characters: classes, weapons, spells and monsters, read from `data/characters.toml`.

A user's own file of the same form overrides the shipped one, table by table and key by key, and may
add to it. Seconds and pixels a second become the ticks and pixels a tick that the rules use.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from pneuma.env import state
from pneuma.env.fields import SHIPPED_CHARACTERS
from pneuma.env.level import START_CODE, Level, Rounded
from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.schema import Table, TomlFile, read_model, read_toml, wrong

TICKS_PER_SECOND = 60
TICKS_PER_STEP = 8
"""Godot RL Agents repeats every action for this many ticks."""

DATA = Path(__file__).parent / "data"
FACINGS = ("down", "left", "up", "right")
"""Names of `rules.DOWN`, `LEFT`, `UP` and `RIGHT`."""

_Points = Annotated[float, Field(ge=0, le=1e6)]
_Hp = Annotated[float, Field(gt=0, le=1e6)]
_Speed = Annotated[float, Field(ge=0, le=3000)]
_Seconds = Annotated[float, Field(ge=0, le=60)]
_Lasting = Annotated[float, Field(ge=1 / TICKS_PER_SECOND, le=60)]
_Side = Annotated[float, Field(ge=1, le=4096), Rounded]
_Offset = Annotated[float, Field(ge=-4096, le=4096), Rounded]
_Ahead = Annotated[float, Field(ge=0, le=4096)]
_Box = Annotated[tuple[_Side, ...], Field(min_length=2, max_length=2)]
_Place = Annotated[tuple[_Offset, ...], Field(min_length=2, max_length=2)]


class _Body(Table):
    hp: _Hp
    speed: _Speed
    body: _Box
    body_at: _Place = (0.0, 0.0)
    """Centre of the body relative to the position."""
    invulnerable: _Seconds

    @model_validator(mode="after")
    def _position_inside(self) -> _Body:
        if any(abs(at) >= side / 2 for at, side in zip(self.body_at, self.body, strict=True)):
            message = f"body_at = {list(self.body_at)} with body = {list(self.body)} is not allowed"
            # The body may be at the grid's edge, where the position must not be outside.
            raise wrong(f"{message}: the position must lie inside the body")
        return self


class Player(_Body):
    energy: _Points
    attack: _Points
    magic: _Points
    weapon: str
    energy_recovery: _Points


class Reach(Table):
    """For each facing, a place relative to the player, or a distance straight ahead."""

    down: _Place | _Ahead
    left: _Place | _Ahead
    up: _Place | _Ahead
    right: _Place | _Ahead

    def places(self) -> list[tuple[float, ...]]:
        """Return x and y relative to the player, by facing."""
        ways = ((0, 1), (-1, 0), (0, -1), (1, 0))
        reaches = [getattr(self, facing) for facing in FACINGS]
        return [
            each if isinstance(each, tuple) else (each * x, each * y)
            for each, (x, y) in zip(reaches, ways, strict=True)
        ]


class Weapon(Table):
    damage: _Points
    swing: _Lasting
    knock_back: _Speed
    knock_back_time: _Seconds
    box: _Box
    reach: Reach
    hilt: Reach | None = None


class Spell(Table):
    strength: _Points
    cost: _Points
    cast: _Lasting


class Heal(Spell):
    reach: _Points = 0.0
    """Distance within which the other players are healed too."""


class Flame(Spell):
    """The spell that burns a box ahead of the player."""

    length: _Side
    width: _Side


class Spells(Table):
    flame: Flame
    heal: Heal


class Monster(_Body):
    code: Annotated[int, Field(ge=0, lt=2**28)]
    notice: _Points
    notice_at: _Place = (0.0, 0.0)
    attack: _Points
    attack_at: _Place = (0.0, 0.0)
    stand_off: _Points
    damage: _Points
    bite_time: Annotated[float, Field(ge=1 / TICKS_PER_SECOND, le=500)]
    xp: _Points
    heal: _Points
    knock_back: _Speed | None = None
    knock_back_time: _Seconds | None = None

    @model_validator(mode="after")
    def _whole_knock_back(self) -> Monster:
        if (self.knock_back is None) != (self.knock_back_time is None):
            raise wrong("knock_back and knock_back_time go together")
        return self


class Characters(Table):
    players: dict[str, Player]
    weapons: dict[str, Weapon]
    spells: Spells
    monsters: dict[str, Monster]

    @model_validator(mode="after")
    def _known_names(self) -> Characters:
        for name, player in self.players.items():
            if player.weapon not in self.weapons:
                raise wrong(f"[players.{name}] weapon: {unknown_name('weapon', player.weapon, self.weapons)}")
        codes = {START_CODE: "a start place"}
        for name, monster in self.monsters.items():
            if monster.code in codes:
                message = f"code = {monster.code} already stands for {codes[monster.code]}"
                raise wrong(f"[monsters.{name}] {message}")
            codes[monster.code] = name
        return self


def load_characters(name: str = "") -> Characters:
    """Read the shipped characters, of which a file overrides some.

    It is a user's own, by its path, or a shipped variant, by its name; empty for none.
    """
    file = read_toml(DATA / "characters.toml")
    for path in character_files(name) if name not in SHIPPED_CHARACTERS else [DATA / f"{name}.toml"]:
        users = read_toml(path)
        file = TomlFile(path, users.text, _laid_over(file.data, users.data))
    return read_model(Characters, file)


def _laid_over(data: Any, over: Any, depth: int = 2) -> Any:
    """Return tables in which a file's keys replace those of the shipped ones, key by key."""
    if depth < 0 or not isinstance(over, dict) or not isinstance(data, dict):
        return over
    return {**data, **{key: _laid_over(data.get(key, {}), value, depth - 1) for key, value in over.items()}}


def character_files(name: str) -> list[Path]:
    """Return the user's file behind a name of characters, if there is one."""
    if not name or name in SHIPPED_CHARACTERS:
        return []
    path = Path(os.path.expanduser(name))
    if not path.is_file():
        hint, known = nearest_name(name, SHIPPED_CHARACTERS), ", ".join(SHIPPED_CHARACTERS)
        raise UserError(f"characters {name!r}: no such file{hint}; shipped are {known}")
    return [path]


def monster_codes(characters: Characters) -> dict[int, str]:
    """Return the kind of monster of each entity code in a level's layer."""
    return {kind.code: name for name, kind in characters.monsters.items()}


def player_stats(characters: Characters, classes: Sequence[str]) -> np.ndarray:
    """Return the stats of each player, (P,) `state.PLAYER_STATS`."""
    stats = np.zeros(len(classes), state.PLAYER_STATS)
    for row, name in zip(stats, classes, strict=True):
        if name not in characters.players:
            raise unknown_name("class", name, characters.players)
        character = characters.players[name]
        _fill_player(row, character, characters.weapons[character.weapon], characters.spells)
    return stats


def monster_stats(
    characters: Characters, levels: Sequence[Level], players: np.ndarray, magic: bool
) -> np.ndarray:
    """Return the stats of each monster of each level, (L, M) `state.MONSTER_STATS`."""
    kinds = dict(
        zip(characters.monsters, np.zeros(len(characters.monsters), state.MONSTER_STATS), strict=True)
    )
    for name, row in kinds.items():
        _fill_monster(row, characters.monsters[name])
        row["reach_squared"] = _reach(row, players, magic) ** 2
    rows = [[kinds[monster.name].item() for monster in level.monsters] for level in levels]
    return np.array(rows, state.MONSTER_STATS)


def fastest(players: np.ndarray, monsters: np.ndarray) -> float:
    """Return the greatest speed of any body, in pixels per tick."""
    speeds = players["speed"], players["sword"]["knock_speed"], monsters["speed"], monsters["knock_speed"]
    return float(max(speed.max(initial=0.0) for speed in speeds))


# --- Filling the rows -----------------------------------------------------------------------------


def _ticks(seconds: float) -> int:
    return round(seconds * TICKS_PER_SECOND)


def _fill(row: Any, character: _Body) -> None:
    """Write what a character and the rules call alike, and its body."""
    for name in row.dtype.names:
        if isinstance(value := getattr(character, name, None), int | float):
            row[name] = value
    row["speed"] = character.speed / TICKS_PER_SECOND
    row["half_width"], row["half_height"] = (side / 2 for side in character.body)
    row["body_x"], row["body_y"] = character.body_at
    row["safe"] = _ticks(character.invulnerable)


def _fill_player(row: Any, character: Player, weapon: Weapon, spells: Spells) -> None:
    flame, heal = spells.flame, spells.heal
    _fill(row, character)
    row["energy_gain"] = character.energy_recovery * character.magic / TICKS_PER_SECOND
    row["swing"], row["flame_ticks"], row["heal_ticks"] = map(_ticks, (weapon.swing, flame.cast, heal.cast))
    row["flame_cost"], row["heal_cost"] = flame.cost, heal.cost
    row["heal"], row["heal_reach"] = heal.strength, heal.reach
    ahead = Reach(**dict.fromkeys(FACINGS, flame.length / 2))
    _fill_strike(row["sword"], weapon.box, weapon.reach, weapon.damage + character.attack)
    _fill_strike(row["flame"], (flame.length, flame.width), ahead, flame.strength + character.magic)
    row["flame"]["knock_ticks"] = -1
    sword = row["sword"]
    sword["hilt_x"], sword["hilt_y"] = zip(*(weapon.hilt or weapon.reach).places(), strict=True)
    sword["knock_speed"] = weapon.knock_back / TICKS_PER_SECOND
    sword["knock_ticks"] = _ticks(weapon.knock_back_time)


def _fill_strike(strike: Any, box: tuple[float, ...], reach: Reach, damage: float) -> None:
    along, across = box[0] / 2, box[1] / 2  # its sides are those of facing left or right
    strike["x"], strike["y"] = zip(*reach.places(), strict=True)
    strike["half_width"] = [across, along, across, along]
    strike["half_height"] = [along, across, along, across]
    strike["damage"] = damage


def _fill_monster(row: Any, kind: Monster) -> None:
    _fill(row, kind)
    for name in ("notice", "attack"):
        row[f"{name}_squared"] = getattr(kind, name) ** 2
        row[f"{name}_x"], row[f"{name}_y"] = getattr(kind, f"{name}_at")
    row["bite_ticks"] = _ticks(kind.bite_time)
    row["knock_ticks"] = -1 if kind.knock_back_time is None else _ticks(kind.knock_back_time)
    row["knock_speed"] = (kind.knock_back or 0.0) / TICKS_PER_SECOND


def _reach(monster: Any, players: np.ndarray, magic: bool) -> float:
    """Return the distance to a player's body beyond which a resting monster meets nothing in a step.

    That is the farthest distance at which it senses, blocks, or is reached by a weapon or flame, plus the
    distance that a player walks.
    """
    body = float(np.hypot(monster["half_width"], monster["half_height"]))
    furthest = [body + float(np.hypot(monster["body_x"], monster["body_y"]))]
    for name in ("notice", "attack"):
        away = np.hypot(monster[f"{name}_x"], monster[f"{name}_y"])
        furthest.append(math.sqrt(monster[f"{name}_squared"]) + float(away))
    for strike in (players["sword"], players["flame"]) if magic else (players["sword"],):
        x = np.abs(strike["x"] - players["body_x"][:, None]) + strike["half_width"]
        y = np.abs(strike["y"] - players["body_y"][:, None]) + strike["half_height"]
        furthest.append(float(np.hypot(x, y).max()) + furthest[0])
    return max(furthest) + float(players["speed"].max()) * TICKS_PER_STEP + 1.0
