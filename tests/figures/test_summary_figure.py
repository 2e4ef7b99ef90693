"""The figures of what runs came to: values by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.analysis.summaries import show_outcomes
from pneuma.figures.grid import save_page
from pneuma.figures.summary import summary_page

from .hand_made import HandMade, legend


def _points(axes: Axes, marker: str) -> list[float]:
    """Return where on the horizontal axis markers of a kind are."""
    lines = [line for line in axes.get_lines() if line.get_marker() == marker]
    return [float(x) for line in lines for x in np.asarray(line.get_xdata(), float)]


def test_every_run_is_a_dot_beside_the_means(tmp_path: Path, figures: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for seed, (tanh, relu) in enumerate([(0.2, 0.1), (0.3, 0.1), (0.3, 0.2), (0.5, 0.3), (0.7, 0.3)]):
        study.add("relu", seed, evaluations=(0.0, relu))
        study.add("tanh", seed, evaluations=(0.0, tanh))
    save_page(summary_page(show_outcomes({"": study.data})), tmp_path, ("svg",))
    (runs,) = figures[0].axes
    assert _points(runs, "o") == pytest.approx([0.1, 0.1, 0.2, 0.3, 0.3, 0.2, 0.3, 0.3, 0.5, 0.7])
    assert _points(runs, "D") == pytest.approx([0.2, 0.4])
    assert [label.get_text() for label in runs.get_yticklabels()] == ["relu (5)", "tanh (5)"]
    assert _points(runs, "s") == pytest.approx([0.2, 1.1 / 3])  # means of the middle three
    assert "random player (4 %)" in legend(figures[0])
