"""A sensitivity figure's means, intervals and dots, by hand, and what it says is missing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from scipy import stats

from pneuma.analysis.sources import open_study
from pneuma.figures import sensitivity

from .hand_made import HandMade, words


def _xs(line: Any) -> list[float]:
    return np.asarray(line.get_xdata()).tolist()


def _ys(line: Any) -> list[float]:
    return np.asarray(line.get_ydata()).tolist()


def _draw(study: HandMade, folder: Path, outcome: str = "final-share-killed") -> None:
    points = [
        {"parameter": "learning_rate", "value": rate, "condition": f"learning_rate={rate:g}", "is_base": base}
        for rate, base in ((1e-4, False), (1e-3, True), (1e-2, False))
    ]
    document = {"base": "mine", "outcome": outcome, "logarithmic": ["learning_rate"], "points": points}
    sensitivity.draw_sensitivity(open_study(study.store, study.record), document, folder, ("svg",))


def test_means_with_their_intervals_and_every_run_over_a_logarithmic_axis(
    tmp_path: Path, drawn: list[Figure]
) -> None:
    study = HandMade(tmp_path)
    for seed, shares in enumerate([(0.1, 0.2, 0.3), (0.1, 0.4, 0.5)]):
        for rate, share in zip((1e-4, 1e-3, 1e-2), shares, strict=True):
            study.add(f"learning_rate={rate:g}", seed, evaluations=[share] * 4)
    _draw(study, tmp_path)
    (axes,) = [own for own in drawn[0].axes if own.get_visible()]
    assert axes.get_title(loc="left") == "learning_rate" and axes.get_xscale() == "log"
    (bar,) = axes.containers
    assert isinstance(bar, ErrorbarContainer)
    means, _, (stems,) = bar.lines
    assert _xs(means) == pytest.approx([1e-4, 1e-3, 1e-2])
    assert _ys(means) == pytest.approx([0.1, 0.3, 0.4])
    half = stats.t.ppf(0.975, 1) * 0.1  # of two runs 0.2 apart: their mean's standard error is 0.1
    low, high = zip(*[(own[0][1], own[1][1]) for own in stems.get_segments()], strict=True)
    assert low[1:] == pytest.approx([0.3 - half, 0.4 - half])
    assert high[1:] == pytest.approx([0.3 + half, 0.4 + half])
    assert (low[0], high[0]) == pytest.approx((0.1, 0.1))
    dots = [line for line in axes.get_lines() if line.get_marker() == "."]
    assert [sorted(_ys(line)) for line in dots] == [[0.1, 0.1], [0.2, 0.4], [0.3, 0.5]]
    (base,) = [line for line in axes.get_lines() if line.get_marker() == "D"]
    assert [*_xs(base), *_ys(base)] == pytest.approx([1e-3, 0.3])
    told = words(drawn[0])
    assert "2 seeds" in told and "not finished" not in told and "without a finite value" not in told


def test_runs_that_count_in_no_mean_are_told(tmp_path: Path, drawn: list[Figure]) -> None:
    """By hand: one run crashed, and two of five never killed a fifth."""
    study = HandMade(tmp_path)
    for seed, status in enumerate(("done", "crashed")):
        study.add("learning_rate=0.0001", seed, status=status)
        study.add("learning_rate=0.001", seed, evaluations=[0.1] * 4)
        study.add("learning_rate=0.01", seed)
    _draw(study, tmp_path, "steps-to:0.2")
    assert "; 1 run not finished; 2 runs without a finite value, in no mean" in words(drawn[0]).replace(
        "\n", " "
    )
