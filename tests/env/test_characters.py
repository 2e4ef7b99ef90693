"""Characters: the published numbers reach the rules, and a user's own file overrides them or is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.env.fields import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import EMPTY, RIGHT, UP, characters_file, stage
from .oracle_cases import CODES

# facts.md section 2, in its own units: points, milliseconds and pixels a tick.
CLASSES = {  # HP, energy, attack, magic, speed
    "tank": (150, 70, 10, 5, 5),
    "mage": (70, 80, 7, 6, 5),
    "warrior": (100, 60, 12, 4, 5),
}
WEAPONS = {"sword": (15, 100), "lance": (30, 400), "axe": (20, 300), "rapier": (8, 50), "sai": (10, 80)}
MONSTERS = {  # HP, XP, attack, speed, knock-back, ticks of safety, attack radius, notice radius
    "squid": (1, 10, 2, 3, 20, 18, 100, 200),
    "raccoon": (1, 25, 5, 2, 10, 18, 100, 180),
    "spirit": (1, 11, 2, 4, 20, 18, 100, 220),
    "bamboo": (1, 9, 1, 3, 20, 18, 100, 300),
}
BAMBOO = 40, 1, 7, 2.5, 0, 0, 40, 300
"""Of the thesis, in the same units; the weapon alone knocks it back."""


def make_worlds(**settings: object) -> Worlds:
    return Worlds(1, make_env_config(settings))


def numbers(row: Any, names: str) -> list[float]:
    return [row[name].item() for name in names.split()]


def test_every_number_of_a_class_and_a_weapon_reaches_the_rules(tmp_path: Path) -> None:
    for name, (hp, energy, attack, magic, speed) in CLASSES.items():
        stats = make_worlds(classes=name).player_stats[0]
        assert numbers(stats, "hp energy speed heal safe") == [hp, energy, speed, 20, 18]  # 300 ms
        # With the sword; a flame's strength is 5.
        assert (stats["sword"]["damage"], stats["flame"]["damage"]) == (attack + 15, 5 + magic)
    for name, (damage, cooldown) in WEAPONS.items():
        file = characters_file(tmp_path, f'[players.mage]\nweapon = "{name}"\n')
        stats = make_worlds(classes="mage", characters=file).player_stats[0]
        assert (stats["sword"]["damage"], stats["swing"]) == (7 + damage, round((400 + cooldown) * 0.06))


@pytest.mark.parametrize(("characters", "bamboo"), [("pygame", MONSTERS["bamboo"]), ("", BAMBOO)])
def test_every_number_of_each_shipped_monster_reaches_the_rules(
    characters: str, bamboo: tuple[float, ...], tmp_path: Path
) -> None:
    places = tuple((name, 90.0 * place, 400.0) for place, name in enumerate(CODES))
    worlds = make_worlds(level=replace(EMPTY, monsters=places).write(tmp_path), characters=characters)
    by_hand = {**MONSTERS, "bamboo": bamboo}
    for name, stats in zip(CODES, worlds.monster_stats[0], strict=True):
        *expected, attack_radius, notice_radius = by_hand[name]
        assert numbers(stats, "hp xp damage speed knock_speed safe") == expected, name
        assert numbers(stats, "attack_squared notice_squared") == [attack_radius**2, notice_radius**2], name


ROGUE = """
[players]
rogue = { hp = 80, energy = 50, attack = 9, magic = 3, speed = 360, body = [40, 44], body_at = [3, -4], \
weapon = "club", invulnerable = 0.5, energy_recovery = 1.0 }
[weapons]
club = { damage = 33, swing = 1.0, knock_back = 240, knock_back_time = 0.25, box = [60, 50], \
reach = { down = [0, 40], left = [-41, 6], up = [0, -42], right = [43, 0] } }
[monsters]
wolf = { code = 500, hp = 12, speed = 90, body = [30, 20], notice = 150, attack = 50, stand_off = 25, \
damage = 4, bite_time = 0.5, invulnerable = 0.1, xp = 3, heal = 2 }
"""


def test_a_file_may_add_a_class_a_weapon_and_a_monster_that_levels_then_know(tmp_path: Path) -> None:
    file = characters_file(tmp_path, ROGUE)
    level = replace(EMPTY, monsters=(("bamboo", 200.0, 0.0), ("bamboo", 300.0, 0.0))).write(tmp_path / "den")
    objects = tmp_path / "den" / "objects.csv"
    objects.write_text(objects.read_text().replace("390,200", "500,200"))
    worlds = make_worlds(level=level, characters=file, classes="rogue")
    stats, wolf = worlds.player_stats[0], worlds.monster_stats[0, 0]
    assert numbers(stats, "hp energy speed safe energy_gain") == [80, 50, 6, 30, 1.0 * 3 / 60]
    assert numbers(stats, "half_width half_height body_x body_y swing") == [20, 22, 3, -4, 60]
    sword = stats["sword"]
    assert numbers(sword, "damage knock_speed knock_ticks") == [9 + 33, 4, 15]
    assert sword["x"].tolist() == [0, -41, 0, 43] and sword["y"].tolist() == [40, 6, -42, 0]
    assert np.array_equal(sword["hilt_x"], sword["x"]) and np.array_equal(sword["hilt_y"], sword["y"])
    assert sword["half_width"].tolist() == [25, 30, 25, 30]  # 60 along the way faced, 50 across
    worlds.reset()
    assert worlds.monsters[0, 0][["x", "y", "hp"]].tolist() == (200, 0, 12)
    assert numbers(wolf, "speed bite_ticks safe knock_ticks") == [1.5, 30, 6, -1]
    with pytest.raises(UserError, match="unknown code 500; known are"):
        make_worlds(level=level)


def test_a_body_of_any_size_slides_along_a_wall(tmp_path: Path) -> None:
    # Unrounded, this one would overlap the wall at x = -512 by the last bit of its place.
    file = characters_file(tmp_path, "[players.base]\nbody = [5.1, 20]\nbody_at = [-2, 0]\n")
    level = replace(EMPTY, monsters=(("bamboo", 400.0, 400.0),), obstacles=((2, 10),)).write(tmp_path)
    pair = stage(level, characters=file)
    pair.put(x=-544.0, y=48.0)
    pair.play(RIGHT, RIGHT, UP)
    assert pair.player("x") + pair.player("y") == pytest.approx([-512 + 2 - 5.1 / 2, 48 - 40], abs=1e-3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[monsters.bamboo]\nbody_at = [12, 0]", "the position must lie inside"),
        ('[players.base]\nweapon = "swrod"', "unknown weapon 'swrod' (did you mean sword?)"),
        ("[monsters.bamboo]\ncode = 400", "code = 400 already stands for a start place"),
        ("[monsters.bamboo]\nknock_back = 9", "knock_back and knock_back_time go"),
    ],
)
def test_a_mistake_is_one_line_with_file_table_key_and_value(tmp_path: Path, text: str, message: str) -> None:
    file = characters_file(tmp_path, text)
    with pytest.raises(UserError) as caught:
        make_worlds(characters=file)
    assert str(caught.value).startswith(file) and message in str(caught.value)
    assert "\n" not in str(caught.value)
