"""Characters: classes, weapons, spells and monsters, read from `data/characters.toml`.

A user's own file of the same form overrides the shipped one, table by table and key by key, and may
add to it. Seconds and pixels a second become the ticks and pixels a tick that the rules use.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.config import SHIPPED_CHARACTERS
from pneuma.env import state
from pneuma.env.level import Level
from pneuma.env.tiled import START_CODE, read_text
from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.values import Number, Several, Text

TICKS_PER_SECOND = 60
TICKS_PER_STEP = 8
"""Godot RL Agents repeats every action for this many ticks."""

DATA = Path(__file__).parent / "data"
FACINGS = ("down", "left", "up", "right")

_POINTS = Number(0, 1e6)
_SECONDS = Number(0, 60)
_SIDE = Number(1, 4096)
_BOX = Several(_SIDE, 2, 2)
_OFFSET = Several(Number(-4096, 4096), 2, 2)
_FORM: dict[str, dict[str, Any]] = {
    "players": {
        "hp": Number(0, 1e6, above=True), "energy": _POINTS, "attack": _POINTS, "magic": _POINTS,
        "speed": Number(0, 3000), "body": _BOX, "body_at": _OFFSET, "weapon": Text(),
        "invulnerable": _SECONDS, "energy_recovery": _POINTS,
    },
    "weapons": {
        "damage": _POINTS, "swing": Number(1 / TICKS_PER_SECOND, 60), "knock_back": Number(0, 3000),
        "knock_back_time": _SECONDS, "box": _BOX, "reach": None, "hilt": None,
    },
    "spells": {
        "strength": _POINTS, "cost": _POINTS, "cast": Number(1 / TICKS_PER_SECOND, 60),
        "length": _SIDE, "width": _SIDE,
    },
    "monsters": {
        "code": Number(0, 2**28 - 1, whole=True), "hp": Number(0, 1e6, above=True),
        "speed": Number(0, 3000), "body": _BOX, "body_at": _OFFSET, "notice": _POINTS,
        "notice_at": _OFFSET, "attack": _POINTS, "attack_at": _OFFSET, "stand_off": _POINTS,
        "damage": _POINTS, "bite_time": Number(1 / TICKS_PER_SECOND, 500),
        "invulnerable": _SECONDS, "xp": _POINTS, "heal": _POINTS, "knock_back": Number(0, 3000),
        "knock_back_time": _SECONDS,
    },
}  # fmt: skip
_OPTIONAL = {
    "players": ("body_at",),
    "weapons": ("hilt",),
    "spells": ("length", "width"),
    "monsters": ("body_at", "notice_at", "attack_at", "knock_back", "knock_back_time"),
}
_MIDDLE = (0.0, 0.0)

Characters = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""{"players" | "weapons" | "spells" | "monsters": {name: {key: value}}}."""


def load_characters(name: str = "") -> Characters:
    """Read the shipped characters, overridden by those of a file.

    Args:
        name: path of a user's own file, or the name of a shipped variant; empty for none.

    Raises:
        UserError: naming file, table, key and value.
    """
    with open(DATA / "characters.toml", "rb") as file:
        characters = tomllib.load(file)
    for path in character_files(name) if name not in SHIPPED_CHARACTERS else [DATA / f"{name}.toml"]:
        _override(characters, path)
    return characters


def _override(characters: dict[str, Any], path: Path) -> None:
    """Lay a file over the characters so far, and check that what comes of it holds together."""
    for group, members in _read_file(path).items():
        known = list(characters[group])
        for member, values in members.items():
            if group == "spells" and member not in known:
                raise UserError(f"{path}: {unknown_name('spell', member, known)}")
            characters[group][member] = {**characters[group].get(member, {}), **values}
            _check_complete(path, group, member, characters[group][member], known)
    for member, values in characters["players"].items():
        if values["weapon"] not in characters["weapons"]:
            problem = unknown_name("weapon", values["weapon"], characters["weapons"])
            raise UserError(f"{path}: [players.{member}] weapon: {problem}")
    codes = {START_CODE: "a start place"}
    for member, values in characters["monsters"].items():
        code = int(values["code"])
        if code in codes:
            raise UserError(f"{path}: [monsters.{member}] code = {code} already stands for {codes[code]}")
        codes[code] = member


def character_files(name: str) -> list[Path]:
    """Return the user's own file that a name of characters stands for, if it does."""
    if not name or name in SHIPPED_CHARACTERS:
        return []
    path = Path(os.path.expanduser(name))
    if not path.is_file():
        hint, known = nearest_name(name, SHIPPED_CHARACTERS), ", ".join(SHIPPED_CHARACTERS)
        raise UserError(f"characters {name!r}: no such file{hint}; shipped are {known}")
    return [path]


def monster_codes(characters: Characters) -> dict[int, str]:
    """Return which entity code of a level's layer stands for which kind of monster."""
    return {int(kind["code"]): name for name, kind in characters["monsters"].items()}


def player_stats(characters: Characters, classes: Sequence[str], weapons: Sequence[str]) -> np.ndarray:
    """Return the stats of each player, shape (P,), dtype `state.PLAYER_STATS`.

    Args:
        characters: what `load_characters` returned.
        classes: class of each player.
        weapons: weapon of each player; 'own' for the class's.
    """
    stats = np.zeros(len(classes), state.PLAYER_STATS)
    for row, name, weapon in zip(stats, classes, weapons, strict=True):
        if name not in characters["players"]:
            raise unknown_name("class", name, characters["players"])
        character = characters["players"][name]
        weapon = character["weapon"] if weapon == "own" else weapon
        if weapon not in characters["weapons"]:
            raise unknown_name("weapon", weapon, ["own", *characters["weapons"]])
        _fill_player(row, character)
        _fill_weapon(row, characters["weapons"][weapon], character)
        _fill_spells(row, characters["spells"], character)
    return stats


def monster_stats(
    characters: Characters, level: Level, players: np.ndarray, magic: bool = False
) -> np.ndarray:
    """Return the stats and home of each monster of a level, shape (M,), dtype `state.MONSTER_STATS`."""
    stats = np.zeros(len(level.monsters), state.MONSTER_STATS)
    for row, (kind, x, y) in zip(stats, level.monsters, strict=True):
        _fill_monster(row, characters["monsters"][kind])
        row["home_x"], row["home_y"] = x, y
        row["reach_squared"] = _reach(row, players, magic) ** 2
    return stats


def margin(players: np.ndarray, monsters: np.ndarray) -> float:
    """Return how far from its centre, on either axis, any body can reach within one tick."""
    knock = players["knock_speed"].max()
    reach = [max(row["half_width"], row["half_height"]) + row["speed"] for row in players]
    for row in monsters:
        fastest = max(row["speed"], knock, row["knock_speed"])
        reach.append(max(row["half_width"], row["half_height"]) + fastest)
    return float(max(reach))


def fastest(players: np.ndarray, monsters: np.ndarray) -> float:
    """Return the greatest speed of anybody who walks or flies, in pixels a tick."""
    speeds = [stats[name] for stats in (players, monsters) for name in ("speed", "knock_speed")]
    return float(max(each.max(initial=0.0) for each in speeds))


def crowd(players: np.ndarray, monsters: np.ndarray) -> float:
    """Return how far apart, on an axis, two positions are at most whose bodies can meet within a step."""
    widest = 0.0
    for stats in (players, monsters):
        for half, at in (("half_width", "body_x"), ("half_height", "body_y")):
            widest = max(widest, float((stats[half] + np.abs(stats[at])).max(initial=0.0)))
    return 2 * (widest + fastest(players, monsters) * TICKS_PER_STEP) + 1.0


# --- Filling the rows -----------------------------------------------------------------------------


def _ticks(seconds: float) -> int:
    return round(seconds * TICKS_PER_SECOND)


def _fill_player(row: Any, character: Mapping[str, Any]) -> None:
    row["hp"], row["energy"] = character["hp"], character["energy"]
    row["energy_gain"] = character["energy_recovery"] * character["magic"] / TICKS_PER_SECOND
    row["speed"] = character["speed"] / TICKS_PER_SECOND
    _fill_body(row, character)
    row["safe"] = _ticks(character["invulnerable"])


def _fill_body(row: Any, character: Mapping[str, Any]) -> None:
    row["half_width"], row["half_height"] = (side / 2 for side in character["body"])
    row["body_x"], row["body_y"] = character.get("body_at", _MIDDLE)


def _fill_weapon(row: Any, weapon: Mapping[str, Any], character: Mapping[str, Any]) -> None:
    row["damage"] = weapon["damage"] + character["attack"]
    row["swing"] = _ticks(weapon["swing"])
    row["knock_ticks"] = _ticks(weapon["knock_back_time"])
    row["knock_speed"] = weapon["knock_back"] / TICKS_PER_SECOND
    _fill_box(row, "sword", weapon["box"], weapon["reach"])
    row["hilt_x"], row["hilt_y"] = _by_facing(weapon.get("hilt", weapon["reach"]))


def _fill_spells(row: Any, spells: Mapping[str, Any], character: Mapping[str, Any]) -> None:
    flame, heal = spells["flame"], spells["heal"]
    row["flame_ticks"], row["heal_ticks"] = _ticks(flame["cast"]), _ticks(heal["cast"])
    row["flame_damage"] = flame["strength"] + character["magic"]
    row["flame_cost"], row["heal_cost"] = flame["cost"], heal["cost"]
    row["heal"] = heal["strength"]
    _fill_box(row, "flame", (flame["length"], flame["width"]), dict.fromkeys(FACINGS, flame["length"] / 2))


def _fill_box(row: Any, name: str, box: Sequence[float], reach: Mapping[str, Any]) -> None:
    """Write where a box is by facing; its sides are those of facing left or right."""
    along, across = box[0] / 2, box[1] / 2
    row[f"{name}_x"], row[f"{name}_y"] = _by_facing(reach)
    row[f"{name}_half_width"] = [across, along, across, along]
    row[f"{name}_half_height"] = [along, across, along, across]


def _by_facing(reach: Mapping[str, Any]) -> tuple[list[float], list[float]]:
    """Return x and y from the player by facing; a plain number is a distance straight ahead."""
    ahead = {"down": (0, 1), "left": (-1, 0), "up": (0, -1), "right": (1, 0)}
    places = [
        (reach[name] * ahead[name][0], reach[name] * ahead[name][1])
        if _is_number(reach[name])
        else reach[name]
        for name in FACINGS
    ]
    return [x for x, _ in places], [y for _, y in places]


def _fill_monster(row: Any, character: Mapping[str, Any]) -> None:
    for name in ("hp", "stand_off", "damage", "xp", "heal"):
        row[name] = character[name]
    row["speed"] = character["speed"] / TICKS_PER_SECOND
    _fill_body(row, character)
    row["notice_squared"], row["attack_squared"] = character["notice"] ** 2, character["attack"] ** 2
    row["notice_x"], row["notice_y"] = character.get("notice_at", _MIDDLE)
    row["attack_x"], row["attack_y"] = character.get("attack_at", _MIDDLE)
    row["bite_ticks"] = _ticks(character["bite_time"])
    row["safe"] = _ticks(character["invulnerable"])
    own = "knock_back" in character
    row["knock_ticks"] = _ticks(character["knock_back_time"]) if own else -1
    row["knock_speed"] = character["knock_back"] / TICKS_PER_SECOND if own else 0.0


def _reach(monster: Any, players: np.ndarray, magic: bool) -> float:
    """Return a distance to a player's body beyond which a resting monster meets nothing in a step.

    The furthest that it senses, that it is in the way, or that a weapon or flame reaches it, and as far as a
    player walks.
    """
    body = float(np.hypot(monster["half_width"], monster["half_height"]))
    furthest = [body + float(np.hypot(monster["body_x"], monster["body_y"]))]
    for name in ("notice", "attack"):
        away = np.hypot(monster[f"{name}_x"], monster[f"{name}_y"])
        furthest.append(math.sqrt(monster[f"{name}_squared"]) + float(away))
    for name in ("sword", "flame") if magic else ("sword",):
        x, y = (
            players[f"{name}_x"] - players["body_x"][:, None],
            players[f"{name}_y"] - players["body_y"][:, None],
        )
        x = np.abs(x) + players[f"{name}_half_width"]
        y = np.abs(y) + players[f"{name}_half_height"]
        furthest.append(float(np.hypot(x, y).max()) + furthest[0])
    return max(furthest) + float(players["speed"].max()) * TICKS_PER_STEP + 1.0


# --- A user's file --------------------------------------------------------------------------------


def _read_file(path: Path) -> dict[str, dict[str, dict[str, Any]]]:
    """Read and check a file of characters."""
    text = read_text(path)
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, brackets without end
        raise UserError(f"{path}: not TOML: {error}") from None
    for group, members in data.items():
        if group not in _FORM:
            raise UserError(f"{path}: {unknown_name('table', group, _FORM)}")
        if not isinstance(members, dict):
            raise UserError(f"{path}: {group} must hold tables, one for each name")
        for member, values in members.items():
            if not isinstance(values, dict):
                raise UserError(f"{path}: [{group}.{member}] must be a table")
            data[group][member] = {
                key: _read_value(f"{path}: [{group}.{member}]", group, key, value)
                for key, value in values.items()
            }
    return data


def _read_value(where: str, group: str, key: str, value: object) -> Any:
    form = _FORM[group]
    if key not in form:
        raise UserError(f"{where} unknown key {key!r}{nearest_name(key, form)}; known are {', '.join(form)}")
    if key in ("reach", "hilt"):
        sound = isinstance(value, dict) and set(value) == set(FACINGS)
        if not sound or not all(_is_place(side) for side in value.values()):  # type: ignore[attr-defined]
            names = ", ".join(FACINGS)
            raise UserError(
                f"{where} {key} = {value!r} is not allowed: a number or [x, y] for each of {names}"
            )
        return value
    try:
        return form[key].read(value)
    except (ValueError, TypeError, OverflowError):
        raise UserError(f"{where} {key} = {value!r} is not allowed: {form[key].allowed}") from None


def _is_place(value: object) -> bool:
    if isinstance(value, list):
        return len(value) == 2 and all(_is_number(side) for side in value)
    return _is_number(value) and value >= 0  # type: ignore[operator]


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and -4096 <= value <= 4096


def _check_complete(
    path: Path, group: str, member: str, values: Mapping[str, Any], known: Sequence[str]
) -> None:
    """Refuse a new character that lacks something, half a knock-back, and a position outside the body."""
    lacking = [key for key in _FORM[group] if key not in values and key not in _OPTIONAL.get(group, ())]
    if lacking:
        keys = f"the key{'s' if len(lacking) > 1 else ''} {', '.join(map(repr, lacking))}"
        raise UserError(f"{path}: [{group}.{member}] is new{nearest_name(member, known)} and lacks {keys}")
    if ("knock_back" in values) != ("knock_back_time" in values) and group == "monsters":
        raise UserError(f"{path}: [{group}.{member}] knock_back and knock_back_time go together")
    away, sides = values.get("body_at", _MIDDLE), values.get("body", (1.0, 1.0))
    if any(abs(at) >= side / 2 for at, side in zip(away, sides, strict=True)):  # it may lie off the grid
        raise UserError(
            f"{path}: [{group}.{member}] body_at = {list(away)} with body = {list(sides)} is not allowed: "
            "the position must lie inside the body"
        )
