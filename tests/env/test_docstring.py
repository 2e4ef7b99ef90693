"""What the environment's docstring tells is so: how tasks differ, and every number's bounds."""

from __future__ import annotations

import inspect
import re

import numpy as np

from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.gym import PneumaEnv

from .arena import ARENA, begin

TEXT = str(inspect.getdoc(PneumaEnv))


def shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    value = value[0] if isinstance(value, tuple) and value else value or 0
    return f"{value:g}" if isinstance(value, float | int) else str(value)


def test_it_says_in_what_the_easier_and_the_harder_task_differ_from_the_arena() -> None:
    said = set(re.findall(r"`(\w+) = (\S+)`", " ".join(TEXT.split())))
    *_, arena, easy, hard = (vars(make_env_config({}, env_id)) for env_id in ENVIRONMENTS)
    for task in (easy, hard):
        assert {(name, shown(task[name])) for name in task if task[name] != arena[name]} <= said


def test_it_has_every_number_of_the_arena_with_its_bounds() -> None:
    bounds = np.full((2, 64), np.nan)
    table = TEXT.partition("## Observations\n")[2].partition("Before the monsters")[0]
    for numbers, low, high in re.findall(r"^\| (\d.*?) \| .* \| (\S+) \| (\S+) \|$", table, re.M):
        for number in numbers.split(", "):
            first, _, each = number.partition(" + ")
            bounds[:, int(first) :: 4 if each else 64] = [[float(low)], [float(high)]]
    space = begin(1, env_id=ARENA).space
    np.testing.assert_allclose(bounds, [space.low, space.high], rtol=0.003)
