"""The rules of bodies, by hand-derived values: kernel and oracle side by side, and both against them.

A player stands at (512, 512): its body is 47 x 48 px around (510.5, 514), a bamboo's 24 x 50 px around a
point 2 px below its place. So they touch 35.5 px apart on x and 49 px apart on y, centre from centre.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.env.rules import ATTACK, DOWN, LEFT, RIGHT, UP

from .oracle_stage import act, put, set_up, told

TOUGH = "[monsters.bamboo]\nhp = 5000\n"
STILL = f"{TOUGH}speed = 0\n"


@pytest.mark.parametrize(("knocked", "hp"), [(False, [100, 100, 100, 93]), (True, [93, 93, 93, 93])])
def test_what_flies_bites_when_it_has_landed(tmp_path: Path, knocked: bool, hp: list[float]) -> None:
    # Struck in tick 1, it flies to the end of tick 30, and never out of reach.
    pair = set_up(tmp_path, (550.0, 526.0), characters=STILL, bite_while_knocked=knocked)
    put(pair, facing=RIGHT)
    left, contacts = [], 0.0
    for _ in range(4):
        act(pair, ATTACK)
        left += told(pair, "hp")
        contacts += told(pair, "contacts")[0]
    assert (left, contacts) == (hp, 1)


@pytest.mark.parametrize(("cap", "hp"), [(False, 107.0), (True, 100.0)])
def test_a_kill_heals_past_full_hp_unless_that_is_a_cap(tmp_path: Path, cap: bool, hp: float) -> None:
    pair = set_up(tmp_path, (580.0, 526.0), healing_cap=cap)
    pair.worlds.monsters["hp"] = 20
    put(pair, facing=RIGHT)
    act(pair, ATTACK)
    assert (told(pair, "kills"), told(pair, "hp"), told(pair, "hp_gained")) == ([1], [hp], [hp - 100])


@pytest.mark.parametrize(
    ("what", "facing", "last", "outwards"),
    [
        # The blade. Half of box and body: 39.5 + 12 or 25.5 + 12 on x, 25.5 + 25 or 39.5 + 25 on y.
        ("hits", RIGHT, (512 + 38.5 + 51.25, 512.0), (1, 0)),
        ("hits", RIGHT, (580.0, 512 + 3.5 - 2 + 50.25), (0, 1)),
        ("hits", LEFT, (512 - 38.5 - 51.25, 512.0), (-1, 0)),
        ("hits", LEFT, (440.0, 512 + 24.5 - 2 - 50.25), (0, -1)),
        ("hits", DOWN, (512 - 1.5 + 37.25, 570.0), (1, 0)),
        ("hits", DOWN, (512.0, 512 + 36.5 - 2 + 64.25), (0, 1)),
        ("hits", UP, (512 - 2.5 - 37.25, 460.0), (-1, 0)),
        ("hits", UP, (512.0, 512 - 28.5 - 2 - 64.25), (0, -1)),
        # The notice circle, 7 px below a bamboo, and the attack circle, 5 px below.
        ("notices", UP, (834.0, 512.0), (1, 0)),  # 510.5 + 23.5 + 300
        ("notices", UP, (512.0, 831.0), (0, 1)),  # 514 + 24 + 300 - 7
        ("notices", UP, (512.0, 183.0), (0, -1)),  # 514 - 24 - 300 - 7
        ("contacts", DOWN, (574.0, 512.0), (1, 0)),  # 510.5 + 23.5 + 40
        ("contacts", DOWN, (512.0, 445.0), (0, -1)),  # 514 - 24 - 40 - 5
    ],
)
def test_blade_and_circles_reach_as_far_as_in_the_scenes(
    tmp_path: Path, what: str, facing: int, last: tuple[float, float], outwards: tuple[int, int]
) -> None:
    for further in (0.0, 0.25):
        bamboo = last[0] + further * outwards[0], last[1] + further * outwards[1]
        pair = set_up(tmp_path / str(further), bamboo)
        put(pair, facing=facing)
        act(pair, ATTACK)
        assert told(pair, what) == [further == 0]
