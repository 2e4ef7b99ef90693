"""The picture of all verdicts: where an effect stands, and the same bytes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.intervals import Interval
from pneuma.analysis.judgement import Comparison
from pneuma.figures.verdicts import draw_verdicts, in_margins

from .hand_made_verdicts import claim, comparison, judged


def shown(verdict: str, effect: float, low: float, high: float, **fields: Any) -> Comparison:
    own = comparison(verdict, effect, of=claim(**fields))
    return replace(own, contrast=replace(own.contrast, simultaneous=Interval(low, high, 0.999, "t")))


@pytest.mark.parametrize(
    ("fields", "numbers", "told"),
    [
        ({"margin": 0.5}, (1.0, 0.5, 2.0), (2, 1, 4)),
        ({"margin": 0.5, "direction": "less"}, (1.0, 0.5, 2.0), (-2, -4, -1)),
        ({"margin": 0.5, "direction": "different"}, (-1.0, -2.0, -0.5), (2, 1, 4)),
        ({}, (1.0, 0.5, 2.0), None),
    ],
)
def test_effects_are_in_margins_and_right_is_as_claimed(
    fields: dict[str, Any], numbers: tuple[float, float, float], told: tuple[float, ...] | None
) -> None:
    found = in_margins(claim(**fields), shown("supported", *numbers, **fields))
    assert found == (told if told is None else pytest.approx(told))


def test_all_verdicts_are_drawn_and_again_to_the_same_bytes(tmp_path: Path) -> None:
    fields = {"margin": 0.5, "outcome": ("final-return", "final-share-killed")}
    both = shown("supported", 1.0, 0.1, 90.0, **fields), shown("refuted", -1.0, -2.0, -0.1, **fields)
    both = both[0], replace(both[1], outcome="final-share-killed")
    claims = {
        "one": judged(claim("one", **fields), text=("mixed", "", both)),
        "two": judged(claim("two"), arena=("untestable", "A/A: the same", ())),
    }
    (first,), (again,) = (draw_verdicts(claims, tmp_path / name) for name in ("first", "again"))
    assert first.name == "verdicts.png" and first.read_bytes() == again.read_bytes()
