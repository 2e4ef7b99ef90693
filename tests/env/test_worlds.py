"""Worlds: hunters clear them, and the docstring has their arguments and bounds."""

from __future__ import annotations

import inspect
import re

import numpy as np
import pytest

from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.gym import PneumaEnv
from pneuma.env.players import Hunter
from pneuma.env.worlds import Worlds
from pneuma.values import shown_value

from .arena import ARENA, begin


@pytest.mark.parametrize("players", [1, 2])
@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, players: int) -> None:
    worlds = Worlds(6, make_env_config({"players": players, "end_on_clear": True, "start": "random"}, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    hunter = Hunter(worlds)
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(hunter.act(worlds))
    assert [worlds.ending(index) for index in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()


def docstring_part(start: str, end: str) -> str:
    return str(inspect.getdoc(PneumaEnv)).partition(start)[2].partition(end)[0]


def test_the_docstring_has_every_argument_with_its_defaults() -> None:
    table = re.findall(r"^\| `(\w+)` \| (.*?) \|", docstring_part("## Arguments", "## Versions"), re.M)
    configs = [vars(make_env_config({}, env_id)) for env_id in ENVIRONMENTS]
    expected = []
    for name in configs[0]:
        defaults = [shown_value(config[name]).removesuffix(".0") for config in configs]
        if len(set(defaults)) == 1:
            defaults = defaults[:1]
        expected.append((name, ", ".join(defaults)))
    assert table == [*expected, ("render_mode", "none"), ("camera", "map")]


def test_the_docstring_has_every_number_of_the_arena_with_its_bounds() -> None:
    bounds = np.full((2, 64), np.nan)
    table = docstring_part("## Observations\n", "Rows of the dead")
    for numbers, low, high in re.findall(r"^\| (\d.*?) \| .* \| (\S+) \| (\S+) \|$", table, re.M):
        for number in numbers.split(", "):
            first, _, repeats = number.partition(" + ")
            bounds[:, int(first) :: 4 if repeats else 64] = [[float(low)], [float(high)]]
    space = begin(1, env_id=ARENA).space
    np.testing.assert_allclose(bounds, [space.low, space.high], rtol=0.003)
