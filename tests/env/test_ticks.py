"""The law that guards the rules' shortcut.

The rules leave out the monsters to which nothing can happen in a step. It may not show.
"""

from __future__ import annotations

from typing import Any

import pytest

from .arena import (
    BAMBOO,
    GODOT,
    RACCOON,
    SPIRIT,
    SQUID,
    THESIS,
    Fighter,
    begin,
    bits,
    write_level,
)


@pytest.fixture(scope="module")
def crowd(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a level in which three starts and monsters of all kinds lie close to each other and to rocks."""
    places = [(-120.0 + 80 * column, -150.0 + 100 * row) for column in range(4) for row in range(4)]
    codes = [BAMBOO, SPIRIT, RACCOON, SQUID] * 4
    starts = [(-200.0, 0.0), (32.0, 210.0), (160.0, -100.0)]
    rocks = [(8, 6), (13, 9), (9, 13), (11, 6)]
    folder = tmp_path_factory.mktemp("crowd")
    return write_level(folder, starts, places, rocks, codes)


CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "one player": (THESIS, {}),
    "passing": (THESIS, {"bodies": "pass", "bite_while_knocked": True, "healing_cap": True}),
    "magic": (THESIS, {"classes": "mage", "magic": True}),
    "three players": (
        THESIS,
        {
            "players": 3,
            "magic": True,
            "classes": ["base", "tank", "mage"],
            "weapons": ["own", "lance", "sai"],
        },
    ),
    "eight players": (THESIS, {"players": 8}),
    "godot": (GODOT, {"start": "random", "ending_cost": 0.0}),
    "three at a deadly coast": (
        GODOT,
        {"start": "random", "ending_cost": 0.0, "players": 3, "coast": "deadly"},
    ),
}


@pytest.mark.parametrize("where", ["crowd", "thesis"])
@pytest.mark.parametrize("name", CASES)
def test_the_shortcut_changes_no_bit(name: str, where: str, crowd: str) -> None:
    """Play so, and looking at all monsters."""
    env_id, settings = CASES[name]
    level = {"crowd": crowd, "thesis": "thesis"}[where]
    worlds, others = (begin(12, env_id=env_id, level=level, **settings) for _ in range(2))
    others.monster_stats["reach_squared"] = 1e18
    fighter = Fighter(worlds, seed=1)
    for _ in range(150):
        actions = fighter.act(worlds)
        assert worlds.step(actions) == others.step(actions)
        assert bits(worlds.players, worlds.monsters, worlds.events) == bits(
            others.players, others.monsters, others.events
        )
        over = worlds.worlds["ending"] != 0
        worlds.reset(over)
        others.reset(over)
