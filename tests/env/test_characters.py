"""Characters: the published numbers reach the rules, and a user's own file overrides them or is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pneuma.env.fields import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import BAMBOO, RIGHT, UP, begin, play, player_at, write_level

# facts.md section 2, in its own units: points, milliseconds and pixels a tick.
CLASSES = {  # HP, energy, attack, magic, speed
    "tank": (150, 70, 10, 5, 5),
    "mage": (70, 80, 7, 6, 5),
    "warrior": (100, 60, 12, 4, 5),
}
MONSTERS = {  # HP, XP, attack, speed, knock-back, attack radius, notice radius
    "squid": (1, 10, 2, 3, 20, 100, 200),
    "raccoon": (1, 25, 5, 2, 10, 100, 180),
    "spirit": (1, 11, 2, 4, 20, 100, 220),
    "bamboo": (1, 9, 1, 3, 20, 100, 300),
}
ORDER = ("bamboo", "spirit", "raccoon", "squid")  # of the zoo


def player_row(**settings: object) -> np.void:
    """Return the stats of the first player of a world with these settings."""
    row: np.void = Worlds(1, make_env_config(settings)).player_stats[0]
    return row


def monster_rows(level: str, characters: str) -> dict[str, np.void]:
    """Return the stats of each kind of monster of the zoo."""
    worlds = Worlds(1, make_env_config({"level": level, "characters": characters}))
    return dict(zip(ORDER, worlds.monster_stats[0], strict=True))


# --- The published numbers -----------------------------------------------------------------------


@pytest.mark.parametrize("name", CLASSES)
def test_every_number_of_a_class_reaches_the_rules(name: str) -> None:
    hp, energy, attack, magic, speed = CLASSES[name]
    row = player_row(classes=name)
    assert (row["hp"], row["energy"], row["speed"]) == (hp, energy, speed)
    assert row["sword"]["damage"] == attack + 15  # with the sword
    assert row["flame"]["damage"] == 5 + magic  # a flame's strength is 5
    assert row["heal"] == 20
    assert row["safe"] == 18  # 300 ms


@pytest.mark.parametrize("name", MONSTERS)
def test_every_number_of_a_monster_reaches_the_rules(zoo: str, name: str) -> None:
    hp, xp, attack, speed, knock_back, attack_radius, notice_radius = MONSTERS[name]
    row = monster_rows(zoo, "pygame")[name]
    assert (row["hp"], row["xp"], row["damage"], row["speed"]) == (hp, xp, attack, speed)
    assert row["knock_speed"] == knock_back
    assert (row["attack_squared"], row["notice_squared"]) == (attack_radius**2, notice_radius**2)
    assert row["safe"] == 18


def test_base_and_bamboo_are_those_of_the_godot_version(zoo: str) -> None:
    # facts.md section 1: 0.4 s, damage 20, 120 px/s for 0.5 s; 150 px/s, circles of 300 and 40 px, 7 HP
    # every second, 1 XP and 7 HP for the kill.
    row = player_row()
    assert (row["hp"], row["speed"], row["swing"], row["safe"]) == (100, 5, 24, 0)
    assert (row["half_width"], row["half_height"]) == (23.5, 24)
    assert [row["sword"][name] for name in ("damage", "knock_speed", "knock_ticks")] == [20, 2, 30]
    assert (row["body_x"], row["body_y"]) == (-1.5, 2)
    bamboo = monster_rows(zoo, "")["bamboo"]
    assert (bamboo["hp"], bamboo["speed"], bamboo["damage"], bamboo["bite_ticks"]) == (40, 2.5, 7, 60)
    assert (bamboo["half_width"], bamboo["half_height"], bamboo["stand_off"]) == (12, 25, 30)
    assert (bamboo["notice_squared"], bamboo["attack_squared"]) == (300**2, 40**2)
    assert (bamboo["xp"], bamboo["heal"], bamboo["safe"]) == (1, 7, 0)
    assert bamboo["knock_ticks"] == -1  # as the striker's weapon has it


# --- A file of one's own -------------------------------------------------------------------------

ROGUE = """
[players.rogue]
hp = 80
energy = 50
attack = 9
magic = 3
speed = 360
body = [40, 44]
weapon = "club"
invulnerable = 0.5
energy_recovery = 1.0
body_at = [3, -4]

[weapons.club]
damage = 33
swing = 1.0
knock_back = 240
knock_back_time = 0.25
box = [60, 50]
reach = { down = 40, left = [-41, 6], up = 42, right = 43 }

[monsters.wolf]
code = 500
hp = 12
speed = 90
body = [30, 20]
notice = 150
attack = 50
stand_off = 25
damage = 4
bite_time = 0.5
invulnerable = 0.1
xp = 3
heal = 2
"""


def write(folder: Path, text: str, name: str = "mine.toml") -> str:
    """Write a file of characters and return its path."""
    path = folder / name
    path.write_text(text)
    return str(path)


def test_a_file_may_add_a_class_and_a_weapon(tmp_path: Path) -> None:
    row = player_row(characters=write(tmp_path, ROGUE), classes="rogue")
    assert (row["hp"], row["energy"], row["speed"], row["safe"]) == (80, 50, 6, 30)
    assert (row["half_width"], row["half_height"]) == (20, 22)
    assert (row["body_x"], row["body_y"], row["swing"]) == (3, -4, 60)
    sword = row["sword"]
    assert [sword[name] for name in ("damage", "knock_speed", "knock_ticks")] == [9 + 33, 4, 15]
    assert sword["x"].tolist() == [0, -41, 0, 43] and sword["y"].tolist() == [40, 6, -42, 0]
    assert np.array_equal(sword["hilt_x"], sword["x"]) and np.array_equal(sword["hilt_y"], sword["y"])
    assert sword["half_width"].tolist() == [25, 30, 25, 30]  # 60 along the way faced, 50 across
    assert row["energy_gain"] == 1.0 * 3 / 60
    other = player_row(characters=write(tmp_path, ROGUE), weapons="club")
    assert other["sword"]["damage"] == 33  # base adds 0


def test_a_file_may_add_a_monster_that_levels_then_know(tmp_path: Path) -> None:
    file = write(tmp_path, ROGUE)
    level = write_level(tmp_path / "den", [(0.0, 0.0)], [(200.0, 0.0), (300.0, 0.0)], codes=(500, BAMBOO))
    worlds = Worlds(1, make_env_config({"level": level, "characters": file}))
    assert [kind for kind, _, _ in worlds.level.monsters] == ["wolf", "bamboo"]
    wolf = worlds.monster_stats[0, 0]
    worlds.reset()
    assert worlds.monsters[0, 0][["x", "y", "hp"]].tolist() == (200, 0, 12) and wolf["speed"] == 1.5
    assert (wolf["bite_ticks"], wolf["safe"], wolf["knock_ticks"]) == (30, 6, -1)
    with pytest.raises(UserError, match="unknown code 500; known are"):
        Worlds(1, make_env_config({"level": level}))


def test_a_body_of_any_size_slides_along_a_wall(tmp_path: Path) -> None:
    # Unrounded, this one would overlap the wall at x = -512 by the last bit of its place.
    file = write(tmp_path, "[players.base]\nbody = [5.1, 20]\nbody_at = [-2, 0]\n")
    level = write_level(tmp_path / "wall", [(-544.0, 48.0)], [(400.0, 400.0)], [(2, 10)])
    worlds = begin(1, level=level, characters=file)
    play(worlds, RIGHT, RIGHT, UP)
    assert player_at(worlds) == pytest.approx((-512 + 2 - 5.1 / 2, 48 - 40), abs=1e-3)


# --- Mistakes in it ------------------------------------------------------------------------------


def complaint(file: str, **settings: object) -> str:
    """Return what is said of a file of characters."""
    with pytest.raises(UserError) as caught:
        Worlds(1, make_env_config({"characters": file, **settings}))
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[monsters.bamboo]\nbody_at = [12, 0]", "the position must lie inside"),
        ('[players.base]\nweapon = "swrod"', "unknown weapon 'swrod' (did you mean sword?)"),
        ("[monsters.bamboo]\ncode = 400", "code = 400 already stands for a start place"),
        ("[monsters.bamboo]\nknock_back = 9", "knock_back and knock_back_time go"),
    ],
)
def test_a_mistake_is_one_line_with_file_table_key_and_value(tmp_path: Path, text: str, told: str) -> None:
    file = write(tmp_path, text)
    message = complaint(file)
    assert message.startswith(file) and told in message
