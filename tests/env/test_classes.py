"""The rules with other weapons and monsters: how long attacks last, and what kills pay."""

from __future__ import annotations

import pytest

from .arena import (
    ATTACK,
    RIGHT,
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


# --- Other monsters ------------------------------------------------------------------------------


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
