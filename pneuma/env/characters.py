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
_Duration = Annotated[float, Field(ge=1 / TICKS_PER_SECOND, le=60)]
_Side = Annotated[float, Field(ge=1, le=4096), Rounded]
_Offset = Annotated[float, Field(ge=-4096, le=4096), Rounded]
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
        for offset, side in zip(self.body_at, self.body, strict=True):
            if abs(offset) >= side / 2:
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
    """For each facing, a place relative to the player."""

    down: _Place
    left: _Place
    up: _Place
    right: _Place


class Weapon(Table):
    damage: _Points
    swing: _Duration
    knock_back: _Speed
    knock_back_time: _Seconds
    box: _Box
    reach: Reach
    hilt: Reach | None = None


class Spell(Table):
    strength: _Points
    cost: _Points
    cast: _Duration


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
        for class_name, player in self.players.items():
            if player.weapon not in self.weapons:
                unknown = unknown_name("weapon", player.weapon, self.weapons)
                raise wrong(f"[players.{class_name}] weapon: {unknown}")
        names_by_code = {START_CODE: "a start place"}
        for monster_name, monster in self.monsters.items():
            if monster.code in names_by_code:
                problem = f"code = {monster.code} already stands for {names_by_code[monster.code]}"
                raise wrong(f"[monsters.{monster_name}] {problem}")
            names_by_code[monster.code] = monster_name
        return self


def load_characters(characters_name: str = "") -> Characters:
    """Read the shipped characters, and a file that overrides some of them.

    It is a user's own, by its path, or a shipped variant, by its name; empty for none.
    """
    characters_file = read_toml(DATA / "characters.toml")
    override_files = character_files(characters_name)
    if characters_name in SHIPPED_CHARACTERS:
        override_files = [DATA / f"{characters_name}.toml"]
    for path in override_files:
        override = read_toml(path)
        characters_file = TomlFile(path, override.text, _overridden(characters_file.data, override.data))
    return read_model(Characters, characters_file)


def _overridden(shipped: Any, override: Any) -> Any:
    """Return tables in which a file's keys replace those of the shipped ones, key by key."""
    if not isinstance(override, dict) or not isinstance(shipped, dict):
        return override
    joined_tables = dict(shipped)
    for key, override_value in override.items():
        joined_tables[key] = _overridden(shipped.get(key, {}), override_value)
    return joined_tables


def character_files(characters_name: str) -> list[Path]:
    """Return the user's file behind a name of characters, if there is one."""
    if not characters_name or characters_name in SHIPPED_CHARACTERS:
        return []
    characters_path = Path(os.path.expanduser(characters_name))
    if not os.path.isfile(characters_path):  # a Path would refuse a long name
        hint = nearest_name(characters_name, SHIPPED_CHARACTERS)
        shipped = ", ".join(SHIPPED_CHARACTERS)
        raise UserError(f"characters {characters_name!r}: no such file{hint}; shipped are {shipped}")
    return [characters_path]


def monster_codes(characters: Characters) -> dict[int, str]:
    """Return the monster's name for each code in a level's table of objects."""
    return {monster.code: monster_name for monster_name, monster in characters.monsters.items()}


def make_player_stats(characters: Characters, classes: Sequence[str]) -> np.ndarray:
    """Return the stats of each player, (P,) `state.PLAYER_STATS`."""
    stats = np.zeros(len(classes), state.PLAYER_STATS)
    for stats_row, class_name in zip(stats, classes, strict=True):
        if class_name not in characters.players:
            raise unknown_name("class", class_name, characters.players)
        player = characters.players[class_name]
        _fill_player(stats_row, player, characters.weapons[player.weapon], characters.spells)
    return stats


def make_monster_stats(
    characters: Characters, levels: Sequence[Level], players: np.ndarray, magic: bool
) -> np.ndarray:
    """Return the stats of each monster of each level, (L, M) `state.MONSTER_STATS`."""
    stats_by_name = {}
    for monster_name, monster in characters.monsters.items():
        monster_row = np.zeros(1, state.MONSTER_STATS)[0]
        _fill_monster(monster_row, monster)
        monster_row["reach_squared"] = _reach(monster_row, players, magic) ** 2
        stats_by_name[monster_name] = monster_row.item()
    rows_by_level = []
    for level in levels:
        rows_by_level.append([stats_by_name[monster.name] for monster in level.monsters])
    return np.array(rows_by_level, state.MONSTER_STATS)


def greatest_speed(players: np.ndarray, monsters: np.ndarray) -> float:
    """Return the greatest speed of any body, in pixels per tick."""
    speeds = players["speed"], players["sword"]["knock_speed"], monsters["speed"], monsters["knock_speed"]
    return float(max(speed.max(initial=0.0) for speed in speeds))


# --- Filling the rows -----------------------------------------------------------------------------


def _ticks(seconds: float) -> int:
    return round(seconds * TICKS_PER_SECOND)


def _fill_body(stats: Any, body: _Body) -> None:
    stats["hp"] = body.hp
    stats["speed"] = body.speed / TICKS_PER_SECOND
    stats["half_width"], stats["half_height"] = np.divide(body.body, 2)
    stats["body_x"], stats["body_y"] = body.body_at
    stats["safe"] = _ticks(body.invulnerable)


def _fill_player(stats: Any, player: Player, weapon: Weapon, spells: Spells) -> None:
    _fill_body(stats, player)
    stats["energy"] = player.energy
    stats["energy_gain"] = player.energy_recovery * player.magic / TICKS_PER_SECOND
    stats["swing"] = _ticks(weapon.swing)
    for spell_name, spell in (("flame", spells.flame), ("heal", spells.heal)):
        stats[f"{spell_name}_ticks"] = _ticks(spell.cast)
        stats[f"{spell_name}_cost"] = spell.cost
    stats["heal"] = spells.heal.strength
    stats["heal_reach"] = spells.heal.reach
    sword = stats["sword"]
    _fill_strike(sword, weapon.box, weapon.damage + player.attack)
    sword["x"], sword["y"] = _by_facing(weapon.reach)
    sword["hilt_x"], sword["hilt_y"] = _by_facing(weapon.hilt or weapon.reach)
    sword["knock_speed"] = weapon.knock_back / TICKS_PER_SECOND
    sword["knock_ticks"] = _ticks(weapon.knock_back_time)
    flame = stats["flame"]
    ahead = spells.flame.length / 2
    _fill_strike(flame, (spells.flame.length, spells.flame.width), spells.flame.strength + player.magic)
    flame["x"] = [0, -ahead, 0, ahead]
    flame["y"] = [ahead, 0, -ahead, 0]
    flame["knock_ticks"] = -1


def _by_facing(reach: Reach) -> np.ndarray:
    """Return x and y relative to the player, by facing, (2, 4)."""
    return np.transpose([getattr(reach, facing) for facing in FACINGS])


def _fill_strike(strike: Any, box: tuple[float, ...], damage: float) -> None:
    ahead, aside = box[0] / 2, box[1] / 2  # its sides are those of facing left or right
    strike["half_width"] = [aside, ahead, aside, ahead]
    strike["half_height"] = [ahead, aside, ahead, aside]
    strike["damage"] = damage


def _fill_monster(stats: Any, monster: Monster) -> None:
    _fill_body(stats, monster)
    for field_name in ("stand_off", "damage", "xp", "heal"):
        stats[field_name] = getattr(monster, field_name)
    for circle in ("notice", "attack"):
        radius = getattr(monster, circle)
        stats[f"{circle}_squared"] = radius * radius
        stats[f"{circle}_x"], stats[f"{circle}_y"] = getattr(monster, f"{circle}_at")
    stats["bite_ticks"] = _ticks(monster.bite_time)
    stats["knock_ticks"] = -1
    if monster.knock_back is not None and monster.knock_back_time is not None:
        stats["knock_speed"] = monster.knock_back / TICKS_PER_SECOND
        stats["knock_ticks"] = _ticks(monster.knock_back_time)


def _reach(monster: Any, players: np.ndarray, magic: bool) -> float:
    """Return the distance to a player's body beyond which a resting monster meets nothing in a step.

    That is the farthest distance at which it senses, blocks, or is reached by a weapon or flame, plus the
    distance that a player walks.
    """
    body = float(np.hypot(monster["half_width"], monster["half_height"]))
    distances = [body + float(np.hypot(monster["body_x"], monster["body_y"]))]
    for circle in ("notice", "attack"):
        offset = float(np.hypot(monster[f"{circle}_x"], monster[f"{circle}_y"]))
        distances.append(math.sqrt(monster[f"{circle}_squared"]) + offset)
    strikes = [players["sword"]]
    if magic:
        strikes.append(players["flame"])
    for strike in strikes:
        x = np.abs(strike["x"] - players["body_x"][:, None]) + strike["half_width"]
        y = np.abs(strike["y"] - players["body_y"][:, None]) + strike["half_height"]
        distances.append(float(np.hypot(x, y).max()) + distances[0])
    return max(distances) + float(players["speed"].max()) * TICKS_PER_STEP + 1.0
