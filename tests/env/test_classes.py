"""The rules with other classes, weapons and monsters: blows, cool-downs and invulnerability."""

from __future__ import annotations

import pytest

from .arena import (
    ATTACK,
    RIGHT,
    STAND,
    UP,
    monster_at,
    move_monster,
    play,
    player_at,
    player_hp,
    stage,
)

# --- Blows ---------------------------------------------------------------------------------------


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


@pytest.mark.parametrize(("pause", "hurts"), [(1, False), (17, False), (18, True), (19, True)])
def test_after_a_bite_300_ms_pass_before_the_next_one_hurts(arena: str, pause: int, hurts: bool) -> None:
    worlds = stage(arena, (-30.0, 0.0), (-500.0, 0.0), ticks=1, still=True, settings={"classes": "tank"})
    play(worlds, *[STAND] * pause)  # bitten in the first of these ticks
    assert player_hp(worlds) == 143
    move_monster(worlds, 1, -30.0, 10.0)
    play(worlds, STAND)
    assert player_hp(worlds) == (136 if hurts else 143)
    assert worlds.events["contacts"][0, 0] == 1  # it bites all the same, and again a second later


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
