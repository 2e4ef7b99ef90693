"""The environment's docstring has every number's bounds."""

from __future__ import annotations

import inspect
import re

import numpy as np

from pneuma.env.gym import PneumaEnv

from .arena import ARENA, begin

TEXT = str(inspect.getdoc(PneumaEnv))


def test_it_has_every_number_of_the_arena_with_its_bounds() -> None:
    bounds = np.full((2, 64), np.nan)
    table = TEXT.partition("## Observations\n")[2].partition("Rows of the dead")[0]
    for numbers, low, high in re.findall(r"^\| (\d.*?) \| .* \| (\S+) \| (\S+) \|$", table, re.M):
        for number in numbers.split(", "):
            first, _, each = number.partition(" + ")
            bounds[:, int(first) :: 4 if each else 64] = [[float(low)], [float(high)]]
    space = begin(1, env_id=ARENA).space
    np.testing.assert_allclose(bounds, [space.low, space.high], rtol=0.003)
