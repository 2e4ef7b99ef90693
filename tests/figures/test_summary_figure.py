"""The figures of what runs came to, and of all verdicts: values by hand, and the same bytes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.figures.summary import draw_summary
from pneuma.figures.verdicts import draw_verdicts, in_margins

from .hand_made import HandMade, legend
from .hand_made_verdicts import claim, comparison, judged


def _points(axes: Axes, marker: str) -> list[float]:
    """Return where on the horizontal axis markers of a kind are."""
    lines = [line for line in axes.get_lines() if line.get_marker() == marker]
    return [float(x) for line in lines for x in np.asarray(line.get_xdata(), float)]


@pytest.fixture
def five(tmp_path: Path) -> HandMade:
    """Of five runs each: tanh ends with 0.2, 0.3, 0.3, 0.5 and 0.7 killed, relu with 0.1 to 0.3."""
    study = HandMade(tmp_path)
    for seed, (tanh, relu) in enumerate([(0.2, 0.1), (0.3, 0.1), (0.3, 0.2), (0.5, 0.3), (0.7, 0.3)]):
        study.add("relu", seed, evaluations=(0.0, relu))
        study.add("tanh", seed, evaluations=(0.0, tanh))
    return study


def test_every_run_is_a_dot_beside_the_means(five: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    draw_summary(five.data, tmp_path, ("svg",))
    (runs,) = drawn[0].axes
    assert _points(runs, "o") == pytest.approx([0.1, 0.1, 0.2, 0.3, 0.3, 0.2, 0.3, 0.3, 0.5, 0.7])
    assert _points(runs, "D") == pytest.approx([0.2, 0.4])
    assert [label.get_text() for label in runs.get_yticklabels()] == ["relu (5)", "tanh (5)"]
    assert _points(runs, "s") == pytest.approx([0.2, 1.1 / 3])  # means of the middle three
    assert "random player (4 %)" in legend(drawn[0])


# --- Verdicts -------------------------------------------------------------------------------------


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
    own, (effect, *ends) = claim(**fields), numbers
    found = in_margins(own, comparison("supported", effect, (ends[0], ends[1]), of=own))
    assert found == (told if told is None else pytest.approx(told))


def test_all_verdicts_are_drawn_and_again_to_the_same_bytes(tmp_path: Path) -> None:
    fields = {"margin": 0.5, "outcome": ("final-return", "final-share-killed")}
    own = claim("one", **fields)
    first = comparison("supported", 1.0, (0.1, 90.0), of=own)
    second = replace(comparison("refuted", -1.0, (-2.0, -0.1), of=own), outcome="final-share-killed")
    claims = {
        "one": judged(own, text=("mixed", "", (first, second))),
        "two": judged(claim("two"), arena=("untestable", "A/A: the same", ())),
    }
    (path,), (again,) = (draw_verdicts(claims, tmp_path / name) for name in ("first", "again"))
    assert path.name == "verdicts.png" and path.read_bytes() == again.read_bytes()
