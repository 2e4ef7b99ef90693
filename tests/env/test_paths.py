"""Ways over a level: their lengths, and steps that are those of the rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pneuma.env import paths, rules
from pneuma.env.level import Level
from pneuma.env.paths import Body, Ways, spot

from .arena import DOWN, LEFT, RIGHT, UP, begin

BODY = Body(23.5, 24.0, -1.5, 2.0)
WALLS = 1 << rules.SOLID | 1 << rules.COAST
REACH = 40.0

# Two rooms and a gap that is one tile wide. Tiles of 64 px; the upper left corner is at 0, 0.
ROOMS = (
    "........",
    "........",
    "##.#####",
    "........",
    "..~~....",
)


def rooms(tile: float = 64.0) -> Level:
    """Return the two rooms as a level."""
    codes = {".": rules.OPEN, "#": rules.SOLID, "~": rules.COAST}
    terrain = np.array([[codes[mark] for mark in row] for row in ROOMS], np.uint8)
    return Level("rooms", "Rooms", tile, 0.0, 0.0, terrain, terrain, np.zeros((1, 2)), ())


def lengths(ways: Ways, goal: tuple[float, float], *places: tuple[float, float]) -> list[float]:
    """Return how many tiles it is to a goal from each place."""
    x, y = np.array(places).T
    goals = np.full((len(places), 1), goal[0]), np.full((len(places), 1), goal[1])
    return [float(length) for length in ways.lengths(np.zeros(len(places), np.int64), *goals, x, y)[:, 0]]


def test_lengths_count_tiles_around_what_is_closed() -> None:
    ways = Ways([rooms()], BODY, WALLS, False)
    # To column 0, row 3: from itself, from column 2 of the gap, from the other room's far corner.
    found = lengths(ways, (32, 224), (32, 224), (160, 160), (480, 32))
    assert found == [0, 3, 5 + 3 + 2]
    assert lengths(ways, (480, 288), (32, 288)) == [1 + 7 + 1]  # along row 3, around the coast


def test_fields_that_are_too_many_are_forgotten_and_found_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a large level, or of many, those to every tile would fill the memory."""
    level = rooms()
    far = (480.0, 32.0)
    goals = [(x, y) for y in (32.0, 96.0, 224.0) for x in np.arange(32.0, 512.0, 64.0)]
    free = Ways([level], BODY, WALLS, False)
    expected = [lengths(free, goal, far) for goal in goals]
    monkeypatch.setattr(paths, "MOST_CELLS", 5 * free._fields.shape[1])
    tight = Ways([level], BODY, WALLS, False)
    for _ in range(2):
        assert [lengths(tight, goal, far) for goal in goals] == expected
        assert len(tight._lists) <= 6
        assert tight.plan(0, far, goals[-1], REACH) == free.plan(0, far, goals[-1], REACH) != {}


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


def test_a_plan_leads_through_a_gap_that_steps_of_its_length_miss() -> None:
    """From x = 140 steps of 40 px stand at 20, 60, …; only 153 to 170 lead through the gap."""
    ways = Ways([rooms()], BODY, WALLS, False)
    place, goal = (140.0, 32.0), (160.0, 224.0)
    for _ in range(10):
        plan = ways.plan(0, place, goal, REACH)
        while spot(place) in plan:
            there = ways.step(0, place, plan[spot(place)], REACH)
            assert there is not None
            place = there
    assert place[1] >= 192  # a tile from the goal at most


def test_levels_have_ways_of_their_own() -> None:
    field = replace(rooms(), terrain=np.zeros_like(rooms().terrain))
    ways = Ways([rooms(), field], BODY, WALLS, False)
    level = np.array([0, 1])
    goal = np.full((2, 1), 480.0), np.full((2, 1), 224.0)
    here = np.full(2, 480.0), np.full(2, 96.0)
    assert ways.lengths(level, *goal, *here).tolist() == [[2 * 5 + 2], [2]]
