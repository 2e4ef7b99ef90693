"""The rules with other classes, weapons and monsters: blows, cool-downs and invulnerability."""

from __future__ import annotations

import pytest

from .arena import (
    ATTACK,
    RIGHT,
    STAND,
    UP,
    monster_at,
    monster_hp,
    move_monster,
    play,
    player_at,
    player_hp,
    stage,
)

SPIRIT_OF_ZOO = 1  # the kinds of the zoo's monsters: bamboo, spirit, raccoon, squid


# --- Blows ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "hp"),
    [
        ({}, [20, 0]),  # base with its blade: 0 + 20
        ({"classes": "tank"}, [15, 0]),  # with a sword: 10 + 15 = 25
        ({"classes": "mage"}, [18, 0]),  # 7 + 15 = 22
        ({"classes": "warrior"}, [13, 0]),  # 12 + 15 = 27
        ({"classes": "warrior", "weapons": "lance"}, [0]),  # 12 + 30 = 42
        ({"classes": "tank", "weapons": "lance"}, [0]),  # 10 + 30 = 40
        ({"classes": "mage", "weapons": "lance"}, [3, 0]),  # 7 + 30 = 37
        ({"classes": "tank", "weapons": "axe"}, [10, 0]),  # 10 + 20 = 30
        ({"classes": "mage", "weapons": "rapier"}, [25, 10, 0]),  # 7 + 8 = 15
        ({"classes": "mage", "weapons": "sai"}, [23, 6, 0]),  # 7 + 10 = 17
        ({"weapons": "rapier"}, [32, 24, 16, 8, 0]),  # 0 + 8
    ],
    ids=str,
)
def test_a_bamboo_of_40_hp_loses_attack_and_damage_at_every_blow(
    arena: str, settings: dict[str, object], hp: list[float]
) -> None:
    worlds = stage(arena, ticks=1, still=True, settings=settings)
    left: list[float] = []
    while monster_hp(worlds) > 0 and len(left) < 9:
        move_monster(worlds, 0, 54.0, 0.0)
        play(worlds, *[ATTACK] * int(worlds.player_stats["swing"][0]))
        left.append(monster_hp(worlds))
    assert left == hp


@pytest.mark.parametrize(
    ("weapon", "ticks"),
    [("blade", 24), ("sword", 30), ("lance", 48), ("axe", 42), ("rapier", 27), ("sai", 29)],
)
def test_an_attack_lasts_400_ms_and_the_weapons_cool_down(arena: str, weapon: str, ticks: int) -> None:
    worlds = stage(arena, ticks=1, settings={"weapons": weapon})
    play(worlds, ATTACK, *[RIGHT] * (ticks - 1))
    assert player_at(worlds) == (0.0, 0.0)
    play(worlds, RIGHT)
    assert player_at(worlds) == (5.0, 0.0)


# --- Invulnerability -----------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "bitten"), [("base", 14), ("tank", 7)])
def test_of_two_bites_in_a_tick_only_one_hurts_whoever_is_safe_after_it(
    arena: str, name: str, bitten: float
) -> None:
    worlds = stage(arena, (-30.0, 0.0), (-30.0, 10.0), ticks=1, settings={"classes": name})
    play(worlds, STAND)
    assert worlds.events["hp_lost"][0, 0] == bitten
    assert worlds.events["contacts"][0, 0] == 2


@pytest.mark.parametrize(("pause", "hurts"), [(1, False), (17, False), (18, True), (19, True)])
def test_after_a_bite_300_ms_pass_before_the_next_one_hurts(arena: str, pause: int, hurts: bool) -> None:
    worlds = stage(arena, (-30.0, 0.0), (-500.0, 0.0), ticks=1, still=True, settings={"classes": "tank"})
    play(worlds, *[STAND] * pause)  # bitten in the first of these ticks
    assert player_hp(worlds) == 143
    move_monster(worlds, 1, -30.0, 10.0)
    play(worlds, STAND)
    assert player_hp(worlds) == (136 if hurts else 143)
    assert worlds.events["contacts"][0, 0] == 1  # it bites all the same, and again a second later


def test_a_struck_spirit_is_safe_for_300_ms(zoo: str) -> None:
    worlds = stage(zoo, players=[(-54.0, 0.0), (-54.0, 0.0)], ticks=1, still=True)
    worlds.monster_stats["knock_speed"] = 0.0
    worlds.monsters["hp"] = 100
    move_monster(worlds, SPIRIT_OF_ZOO, 0.0, 0.0)
    hp = []
    for _ in range(24):
        play(worlds, ATTACK)
        hp.append(monster_hp(worlds, SPIRIT_OF_ZOO))
    # Struck by the first player in tick 1; the second's sword meets it until tick 24 and hits once it may.
    assert hp == [80] * 18 + [60] * 6


def test_a_spirit_flies_back_its_own_way(zoo: str) -> None:
    # 60 px away from the hilt, as a bamboo, but 20 px a tick for 3 ticks: from (84, -26), which is
    # 50 x (0.6, -0.8) from (54, 14), to (120, -74).
    worlds = stage(zoo, ticks=1, still=True)
    worlds.monsters["hp"] = 100
    move_monster(worlds, SPIRIT_OF_ZOO, 84.0, -26.0)
    play(worlds, ATTACK)
    assert monster_at(worlds, SPIRIT_OF_ZOO) == pytest.approx((96.0, -42.0))
    play(worlds, STAND, STAND, STAND, STAND)
    assert monster_at(worlds, SPIRIT_OF_ZOO) == pytest.approx((120.0, -74.0))


# --- Other monsters ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("monster", "bite", "pace"),
    [(0, 7, 2.5), (1, 2, 4.0), (2, 5, 2.0), (3, 2, 3.0)],
    ids=["bamboo", "spirit", "raccoon", "squid"],
)
def test_each_kind_chases_and_bites_in_its_own_way(zoo: str, monster: int, bite: float, pace: float) -> None:
    worlds = stage(zoo, ticks=1, facing=UP)
    move_monster(worlds, monster, 0.0, 170.0)  # 144 px off: noticed, but out of every reach
    play(worlds, STAND)
    assert monster_at(worlds, monster) == (0.0, 170.0 - pace)
    assert player_hp(worlds) == 100
    move_monster(worlds, monster, 0.0, 50.0)
    play(worlds, STAND)
    assert player_hp(worlds) == 100 - bite


@pytest.mark.parametrize(
    ("monster", "notice", "attack"),
    [(0, 300, 40), (1, 220, 100), (2, 180, 100), (3, 200, 100)],
    ids=["bamboo", "spirit", "raccoon", "squid"],
)
def test_each_kind_has_its_own_circles(zoo: str, monster: int, notice: float, attack: float) -> None:
    # The body's lower edge is at 26; a bamboo's circles are centred 7 and 5 px below its place.
    below = (7.0, 5.0) if monster == 0 else (0.0, 0.0)
    for radius, event, at in ((notice, "notices", below[0]), (attack, "contacts", below[1])):
        for outside in (0.0, 0.25):
            worlds = stage(zoo, ticks=1, facing=UP, still=True)
            move_monster(worlds, monster, 0.0, 26.0 - at + radius + outside)
            play(worlds, STAND)
            assert worlds.events[event][0, 0] == (outside == 0), event


def test_a_kill_pays_what_each_kind_is_worth(zoo: str) -> None:
    # Bamboo 1 XP and 7 HP, spirit 11, raccoon 25, squid 10, and no HP.
    worlds = stage(zoo, still=True, ticks=1)
    worlds.monsters["hp"] = 1
    worlds.players["hp"] = 50
    for monster in range(4):
        move_monster(worlds, monster, 54.0, 40.0)
    worlds.monster_stats["attack_squared"] = 1.0  # nobody bites
    play(worlds, ATTACK)
    assert worlds.events["kills"][0, 0] == 4
    assert worlds.players["xp"][0, 0] == 47
    assert player_hp(worlds) == 57
