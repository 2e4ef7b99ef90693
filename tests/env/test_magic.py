"""The rules of magic (thesis section 5.2): flame and heal, paid from energy that comes back.

A base player has magic 4, 60 of energy and recovers 0.6 x 4 / 60 = 0.04 a tick. A flame burns a box of
320 x 64 px ahead for 5 + 4 = 9 HP and costs 20; healing gives 20 HP and costs 10; both take 24 ticks.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from pneuma.env.worlds import Worlds

from .arena import (
    DOWN,
    FLAME,
    HEAL,
    LEFT,
    RIGHT,
    UP,
    Place,
    monster_at,
    monster_hp,
    play,
    player_at,
    player_hp,
    stage,
)

WAYS = {DOWN: (0, 1), LEFT: (-1, 0), UP: (0, -1), RIGHT: (1, 0)}


def cast(
    level: str,
    *monsters: Place,
    facing: int = RIGHT,
    ticks: int = 8,
    settings: Mapping[str, object] | None = None,
) -> Worlds:
    """Set up a world with magic in which monsters neither move nor bite."""
    magic = {"magic": True, **(settings or {})}
    worlds = stage(level, *monsters, facing=facing, ticks=ticks, still=True, settings=magic)
    worlds.monster_stats["damage"] = 0.0
    return worlds


def energy(worlds: Worlds) -> float:
    return float(worlds.players["energy"][0, 0])


# --- Flame ---------------------------------------------------------------------------------------


def beside(facing: int, along: float, across: float) -> Place:
    """Return the place of a bamboo whose body is so far ahead of a player, and so far to the side."""
    x, y = WAYS[facing]
    return x * along + y * across, y * along + x * across - 2


@pytest.mark.parametrize("facing", WAYS)
def test_a_flame_burns_the_320_x_64_px_ahead_and_nothing_else(arena: str, facing: int) -> None:
    # A body is 24 x 50 px: half of it along the way faced, and half across.
    along, across = (12.0, 25.0) if facing in (LEFT, RIGHT) else (25.0, 12.0)
    for inside, burnt in ((0.001, 31), (0.0, 40)):
        for place in (
            beside(facing, 320 + along - inside, 0.0),
            beside(facing, -along + inside, 0.0),
            beside(facing, 160.0, 32 + across - inside),
            beside(facing, 160.0, -32 - across + inside),
        ):
            worlds = cast(arena, place, facing=facing)
            play(worlds, FLAME)
            assert monster_hp(worlds) == burnt, place


def test_a_flame_burns_every_monster_once_and_knocks_nobody_back(arena: str) -> None:
    worlds = cast(arena, (40.0, 0.0), (200.0, 20.0), (310.0, -20.0), (-100.0, 0.0))
    play(worlds, FLAME, FLAME, FLAME)
    assert [monster_hp(worlds, m) for m in range(4)] == [31, 31, 31, 40]
    assert monster_at(worlds, 1) == (200.0, 20.0)
    assert worlds.monsters["knocked"][0].tolist() == [0] * 4


# --- Heal ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("before", "after"), [(50, 70), (80, 100), (95, 100)])
def test_healing_gives_20_hp_up_to_full(arena: str, before: float, after: float) -> None:
    worlds = cast(arena)
    worlds.players["hp"] = before
    play(worlds, HEAL)
    assert player_hp(worlds) == after
    assert worlds.events["hp_gained"][0, 0] == after - before
    play(worlds, HEAL, HEAL)  # still the same spell
    assert player_hp(worlds) == after


# --- Energy --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("spell", "cost"), [(FLAME, 20), (HEAL, 10)])
def test_a_spell_costs_energy_and_takes_24_ticks(arena: str, spell: int, cost: float) -> None:
    worlds = cast(arena, ticks=1)
    worlds.players["hp"] = 10
    play(worlds, spell)
    assert energy(worlds) == pytest.approx(60 - cost + 0.04)
    play(worlds, *[spell] * 23)
    assert energy(worlds) == pytest.approx(60 - cost + 24 * 0.04)
    play(worlds, RIGHT)
    assert player_at(worlds) == (5.0, 0.0)


@pytest.mark.parametrize(
    ("name", "full", "gained"),
    [("base", 60, 0.04), ("tank", 70, 0.05), ("mage", 80, 0.06), ("warrior", 60, 0.04)],
)
def test_energy_comes_back_by_magic_up_to_full(arena: str, name: str, full: float, gained: float) -> None:
    worlds = cast(arena, settings={"classes": name})  # 0.6 a second for each point of magic
    assert energy(worlds) == full
    worlds.players["energy"] = 10
    play(worlds, RIGHT, LEFT)
    assert energy(worlds) == pytest.approx(10 + 16 * gained)
    worlds.players["energy"] = full - 0.1
    play(worlds, RIGHT)
    assert energy(worlds) == full
