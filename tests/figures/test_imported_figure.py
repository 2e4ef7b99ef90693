"""The figure of an imported study: what there is, and that it was averaged before."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pneuma.analysis.run_index import open_study
from pneuma.errors import UserError
from pneuma.figures import curves, style
from pneuma.figures.curves import draw_study
from pneuma.study.imported import import_tensorboard
from pneuma.study.store import Store

WriteEvents = Callable[[Path, Any], Path]
RETURN = "rollout/ep_rew_mean"


@pytest.fixture
def figure(tmp_path: Path, write_events: WriteEvents, monkeypatch: pytest.MonkeyPatch) -> Figure:
    """The figure of two runs of 'small', the second of which was stopped at half of its steps."""
    for name, end in (("small_1", 1000), ("small_2", 500)):
        points = [(RETURN, step, step / 100) for step in range(100, end + 1, 100)]
        write_events(tmp_path / "logs" / name / "events.out.tfevents.1.host", points)
    store = Store(tmp_path / "results")
    import_tensorboard([tmp_path / "logs"], store)
    figures: list[Figure] = []

    def save(figure: Figure, *arguments: Any) -> list[Path]:
        figures.append(figure)
        return style.save_figure(figure, *arguments)

    monkeypatch.setattr(curves, "save_figure", save)
    data = open_study(store, store.selection("logs") or {})
    draw_study(data, tmp_path / "figures", band="std", formats=("svg",))
    with pytest.raises(UserError, match="window budget-5% cannot be had"):
        draw_study(data, tmp_path / "other", window="budget-5%")
    assert not (tmp_path / "other").exists()
    return figures[0]


def test_there_is_one_panel_whose_axis_says_what_was_averaged(figure: Figure) -> None:
    (axes,) = figure.axes
    assert axes.get_title(loc="left") == "Return in training"
    assert axes.get_ylabel() == "Return, mean of 100 episodes"
    words = " ".join(" ".join(text.get_text() for text in figure.texts).split())  # wrapped anywhere
    assert "mean over its last 100 episodes, as Stable-Baselines3 logs them" in words
    assert "last 5 %" not in words


def test_the_legend_counts_the_runs_that_reached_the_end(figure: Figure) -> None:
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["small (n = 2, 1 at the end)"]


def test_the_line_is_what_was_logged_and_faint_where_a_run_had_ended(figure: Figure) -> None:
    whole, faint, common = figure.axes[0].get_lines()
    assert np.asarray(common.get_xdata(), float).tolist() == [500, 500]  # where the shorter log ends
    at = {int(step): place for place, step in enumerate(np.asarray(whole.get_xdata(), float))}
    places = [at[step] for step in (95, 100, 195, 500, 505)]
    np.testing.assert_array_equal(np.asarray(whole.get_ydata(), float)[places], [np.nan, 1, 1, 5, np.nan])
    assert np.asarray(faint.get_ydata(), float)[at[1000]] == 10
