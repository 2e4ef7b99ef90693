"""Ways over a level: their steps are those of the rules."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env.paths import Body, Ways

from .arena import DOWN, LEFT, RIGHT, UP, begin

BODY = Body(23.5, 24.0, -1.5, 2.0)
REACH = 40.0


@pytest.mark.parametrize("coast", ["wall", "deadly"])
def test_steps_lead_where_the_rules_lead(coast: str) -> None:
    """From random places of a random level, hundreds of steps in every direction."""
    count = 2000
    worlds = begin(count, level="random:test:3", coast=coast, bodies="pass")
    ways = Ways(worlds.levels, BODY, int(worlds.settings["player_stops"][0]), coast == "deadly")
    generator = np.random.default_rng(0)
    for _ in range(30):  # away from the start places, to walls and shores
        worlds.step(generator.integers(4, size=(count, 1)))
    for action in (DOWN, LEFT, UP, RIGHT):
        before = worlds.players[:, 0].copy()
        worlds.step(np.full((count, 1), action))
        for old, new in zip(before, worlds.players[:, 0], strict=True):
            if old["hp"] > 0 and old["busy"] == 0:
                there = ways.step(0, (float(old["x"]), float(old["y"])), action, REACH)
                drowned = new["hp"] <= 0 and coast == "deadly"
                assert there == (None if drowned else (float(new["x"]), float(new["y"])))
