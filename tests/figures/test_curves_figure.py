"""A study's curves: the same bytes every time, means and bands in their place, and what is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import matplotlib as mpl
import numpy as np
import pandas as pd
import PIL
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image
from scipy import stats

from pneuma import __version__
from pneuma.analysis.curves import _notes_on_random_levels, find_curves
from pneuma.analysis.notes import notes_on_windows
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.figures import FIGURE_FORMATS
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import save_page
from pneuma.presets import WORLDS
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Query

from .hand_made import BUDGET, HandMade, legend, words


def _lines_of_runs(figure: Figure, panel: int) -> int:
    return sum(line.get_linewidth() < 0.6 for line in figure.axes[panel].get_lines())


# --- Files -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FIGURE_FORMATS)
def test_drawing_twice_gives_the_same_bytes_whatever_style_a_person_has(
    study: HandMade, tmp_path: Path, form: str
) -> None:
    (first,) = study.draw(tmp_path / "first", formats=(form,))
    with mpl.rc_context({"lines.linewidth": 9.0, "font.size": 20, "axes.facecolor": "red"}):
        (second,) = study.draw(tmp_path / "second", formats=(form,))
        assert mpl.rcParams["lines.linewidth"] == 9.0  # and is left alone
    assert first.read_bytes() == second.read_bytes()
    assert first.name == f"mine.{form}"
    for version in (mpl.__version__, PIL.__version__, __version__):  # nor do they change with a version
        assert version.encode() not in first.read_bytes()


@pytest.mark.parametrize("quantity", ["return", "share_killed"])
def test_another_study_is_drawn_beside_as_the_studys_own_runs_are(
    study: HandMade, tmp_path: Path, figures: list[Figure], quantity: str
) -> None:
    data = study.data
    other = replace(data, study=data.study.model_copy(update={"name": "other", "title": "Another"}))
    study.draw(tmp_path, quantity, band="minmax")
    (path,) = study.draw(tmp_path, quantity, band="minmax", beside=other)
    alone, beside = (figure.axes[0] for figure in figures)
    assert path.stem == f"mine-{quantity}-minmax-beside-other"
    assert len(beside.collections) == 2 * len(alone.collections) > 0
    assert len(beside.lines) == len(alone.lines) + 2 + 4  # two means, and of few runs each
    assert "tanh, Another in the text's world (2)" in legend(figures[1])  # in the colour of tanh
    dashed = [line for line in beside.lines if line.get_linestyle() == "--"]
    assert {line.get_color() for line in dashed} >= {"C0", "C1"}


def test_curves_of_several_budgets_come_with_the_steps_that_a_point_averages(study: HandMade) -> None:
    """The runs have 1,000 steps and, beside, 2,000: a twentieth of each is averaged."""
    longer = SimpleNamespace(rows=[SimpleNamespace(budget=2 * BUDGET)])
    (note,) = notes_on_windows(study.data, cast(StudyData, longer))
    assert "points average 50 or 100 steps" in note
    assert notes_on_windows(study.data, study.data) == []


def test_runs_beside_are_of_the_same_environment_or_not_drawn(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    other = HandMade(tmp_path / "other", "CartPole-v1")
    other.add("tanh", 0)
    with pytest.raises(UserError, match="beside='mine': its runs are in CartPole-v1, not in pneuma/Pneu"):
        study.draw(tmp_path, beside=other.data)
    both = find_curves({"One": study.data, "Other": other.data}, ["return"], beside=other.data)
    save_page(curves_page(both), tmp_path, ("svg",))
    one, beside = figures[0].axes
    assert "--" not in [line.get_linestyle() for line in one.lines]
    assert "--" in [line.get_linestyle() for line in beside.lines]


def test_the_random_players_return_is_no_share(tmp_path: Path, figures: list[Figure]) -> None:
    study = HandMade(tmp_path, "CartPole-v1")
    study.add("tanh", 0, returned=22.0)
    study.draw(tmp_path, "evaluated_return")
    assert legend(figures[0])[-1] == "random player (22)"


@pytest.mark.parametrize(
    ("episodes", "status", "returned", "title"),
    [
        (20, "done", 0.5, "Return in training"),  # each point of a twentieth of the budget has an episode
        (4, "done", 0.5, "Return in evaluation"),  # those up to a fifth of it
        (4, "done", float("nan"), "Return in training"),  # where evaluations have none
        (4, "diverged", 0.5, "Return in training"),  # a run that ended has no gaps
    ],
)
def test_a_return_of_few_episodes_is_that_of_evaluations(
    tmp_path: Path, figures: list[Figure], episodes: int, status: str, returned: float, title: str
) -> None:
    """Its curve of training would be stubs."""
    study = HandMade(tmp_path)
    study.add("tanh", 0, returned=returned)
    study.add("tanh", 1, episodes, status=status, returned=returned)
    study.draw(tmp_path)
    assert figures[0].axes[0].get_title(loc="left") == title


def test_few_evaluations_elsewhere_are_replaced_by_training_and_are_seen_where_asked_for(
    tmp_path: Path, figures: list[Figure]
) -> None:
    study = HandMade(tmp_path, "CartPole-v1")
    for seed in range(3):
        study.add("tanh", seed, evaluations=(float("nan"),), returned=22.0 + seed)
    study.draw(tmp_path)
    assert figures[0].axes[0].get_title(loc="left") == "Return in training"
    assert "With fewer than 3 evaluations, the return is that in training." in words(figures[0])
    study.draw(tmp_path, "evaluated_return", beside=study.data)
    bar, _ = figures[1].axes[0].collections  # of the study, and of the one beside
    assert isinstance(bar, LineCollection)
    assert [np.asarray(segment).tolist() for segment in bar.get_segments()] == [[[250, 22], [250, 24]]]
    beside = [line for line in figures[1].axes[0].lines if line.get_linestyle() == "--"]
    assert {line.get_marker() for line in beside if np.size(line.get_xdata()) == 1} == {"o"}


def test_no_word_reaches_over_the_edge(study: HandMade, tmp_path: Path, figures: list[Figure]) -> None:
    study.add("learning_rate=1e-4, reward=thesis, scale=unit, stationary", 0, status="diverged")
    (path,) = study.draw(tmp_path, formats=("png",))
    with Image.open(path) as image:
        assert image.width == 1400
    width, height = figures[0].bbox.size
    for text in (*figures[0].texts, *figures[0].legends):
        box = text.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text


# --- Curves ------------------------------------------------------------------------------------------


def test_lines_are_the_means_of_runs(study: HandMade, tmp_path: Path, figures: list[Figure]) -> None:
    study.draw(tmp_path, band="minmax")
    returned, killed = figures[0].axes
    tanh, killed_by_tanh = returned.get_lines()[2], killed.get_lines()[2]  # before them are its two runs
    # 1,000 / 200 = 5 steps a point, 50 steps a window: at 50 (point 10) episode 0 alone, returning 0 and 1
    assert np.isnan(np.asarray(tanh.get_ydata(), float)[:9]).all()
    assert np.asarray(tanh.get_ydata(), float)[9] == 0.5
    assert np.asarray(killed_by_tanh.get_ydata()).tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert killed.get_xlim() == returned.get_xlim() == (0, BUDGET)


@pytest.mark.parametrize("run_count", [5, 6, 7, 30])
def test_the_interval_is_drawn_only_where_it_is_inside_the_deviation(
    tmp_path: Path, figures: list[Figure], run_count: int
) -> None:
    """Of 5 runs it has 1.24 times the deviation's width, of 6 1.05 times, and of 7 0.92 times."""
    study = HandMade(tmp_path)
    for seed in range(run_count):
        study.add("tanh", seed, evaluations=(0.1, 0.4 + 0.2 * (-1) ** seed), random=0.01)
    study.draw(tmp_path)
    bands = [band.get_paths()[0].get_extents() for band in figures[0].axes[1].collections]
    drawn = ["± 1 SD between runs", "95 % interval of the mean"]
    if run_count < 7:
        drawn[1] = "every run"
    assert legend(figures[0])[1:4] == ["mean of (n) runs", *drawn]
    assert _lines_of_runs(figures[0], 1) == (run_count if run_count < 7 else 0)
    assert ("Of fewer than 7 runs, the 95 % interval" in words(figures[0])) == (run_count < 7)
    last = np.array([0.4 + 0.2 * (-1) ** seed for seed in range(run_count)])
    deviation = last.std(ddof=1)
    assert bands[0].y1 == pytest.approx(last.mean() + deviation)
    if run_count >= 7:
        half_width = stats.t.ppf(0.975, run_count - 1) * deviation / run_count**0.5
        assert half_width < deviation
        assert bands[1].y1 == pytest.approx(last.mean() + half_width)
    assert len(bands) == 1 + (run_count >= 7)


def test_conditions_of_few_and_of_many_runs_are_drawn_each_in_its_way(
    tmp_path: Path, figures: list[Figure]
) -> None:
    """Where not all runs have a value, no interval is drawn either."""
    study = HandMade(tmp_path)
    for seed in range(8):
        study.add("tanh", seed, evaluations=(0.1 + 0.1 * (seed % 2),) * (4 if seed < 5 else 2))
    for seed in range(5):
        study.add("relu", seed, evaluations=(0.5 + 0.1 * (seed % 2),) * 4)
    study.draw(tmp_path)
    ends = [band.get_paths()[0].get_extents().x1 for band in figures[0].axes[1].collections]
    assert ends == [1000, 500, 1000]  # tanh's deviation and interval, ReLU's deviation
    assert _lines_of_runs(figures[0], 1) == 5
    assert "Of fewer than 7 runs, the 95 % interval of the mean is wider" in words(figures[0])


def test_a_band_that_was_asked_for_is_drawn_or_named_as_lacking(
    tmp_path: Path, figures: list[Figure]
) -> None:
    """Four runs have a deviation, which some call variance, but are too few for an interval of their mean."""
    study = HandMade(tmp_path)
    for seed in range(4):
        study.add("tanh", seed)
    for band in ("sd", "variance"):
        (path,) = study.draw(tmp_path, band=band)
        assert path.name == "mine.svg" and "± 1 SD between runs" in words(figures[-1])
        assert len(figures[-1].axes[0].collections) == 1 and _lines_of_runs(figures[-1], 0) == 4
    study.draw(tmp_path, band="ci")
    assert not figures[-1].axes[0].collections and _lines_of_runs(figures[-1], 0) == 4
    assert "The band ci needs 5 runs: not drawn for tanh (4 runs)." in words(figures[-1])


def test_a_diverged_run_counts_and_ends_in_a_cross(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    study.add("tanh", 2, episodes=2, evaluations=(0.1,), status="diverged")
    study.draw(tmp_path)
    assert "2 of 3 runs of tanh reach the end." in words(figures[0])
    crosses = [line for line in figures[0].axes[1].get_lines() if line.get_marker() == "x"]
    assert [np.asarray(line.get_xydata()).tolist() for line in crosses] == [[[250.0, 0.1]]]
    line = np.asarray(figures[0].axes[0].get_lines()[3].get_ydata(), float)  # after the three runs
    assert line[9] == 1.0  # at step 50: of seeds 0, 1 and 2
    assert np.isnan(line[199])  # where seeds 0 and 1 alone have a value
    assert "×: a run diverged" in words(figures[0])


# --- Columns ------------------------------------------------------------------------------------------


def test_columns_share_colours_and_a_label_is_written_once(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    """The first column has no runs of ReLU, and the second one has them first."""
    other = HandMade(tmp_path / "other")
    for condition in ("relu", "tanh"):
        other.add(condition, 0)
    both = find_curves({"One": study.data.of_conditions(["tanh"]), "Other": other.data})
    save_page(curves_page(both), tmp_path, ("svg",))
    axes = figures[0].axes
    colours = [{line.get_color() for line in panel.lines if line.get_marker() == "o"} for panel in axes]
    assert colours == [{"C0"}] * 4  # of tanh
    assert [panel.get_title(loc="left") for panel in axes] == ["One", "Other", "", ""]
    assert [panel.get_ylabel() for panel in axes] == [
        "Return in training", "", "Monsters killed in evaluation", "",
    ]  # fmt: skip
    assert words(figures[0]).count("Environment steps") == 1
    assert legend(figures[0])[:2] == ["tanh (2, 1)", "relu (0, 1)"]
    assert "In brackets: runs in each column." in words(figures[0])


def test_bands_end_at_the_bounds_of_a_return(tmp_path: Path, figures: list[Figure]) -> None:
    """An episode of CartPole returns 500 at most: of 500, 500 and 200 the mean is 400, the deviation 173."""
    study = HandMade(tmp_path, "CartPole-v1")
    for seed, returned in enumerate((500.0, 500.0, 200.0)):
        study.add("tanh", seed, returned=returned)
    study.draw(tmp_path, "evaluated_return", band="sd")
    (band,) = figures[0].axes[0].collections
    extents = band.get_paths()[0].get_extents()
    assert (extents.y0, extents.y1) == (pytest.approx(400 - 3e4**0.5), 500)


def test_every_return_has_the_random_players_line(figures: list[Figure], tmp_path: Path) -> None:
    """Where XP is never reset, that of as many steps over as many environments."""
    index = RunIndex(Store("none"))
    for world in WORLDS:
        data = open_study(index, Query("optimizer", world, conditions=("non-stationary",)))
        save_page(curves_page(find_curves({"": data}, ["return"])), tmp_path, ("svg",))
        (line,) = (line for line in figures[-1].axes[0].lines if line.get_label() == "random player")
        assert np.max(line.get_xdata()) == pytest.approx(data.budget, rel=0.01)
        assert np.min(line.get_xdata()) == 0 or world == "godot"


def test_random_players_that_differ_are_named_as_in_the_legend(study: HandMade) -> None:
    """Those that kill as many stand together; no words if all do."""
    data = study.data
    labelled = replace(data, study=data.study.model_copy(update={"labels": {"relu": "ReLU"}}))
    levels = [("tanh", 0.2), ("relu", 0.1), ("other", 0.2)]
    rows = [("share_killed", condition, np.nan, level) for condition, level in levels]
    reference = pd.DataFrame(rows, columns=["quantity", "condition", "x", "value"])
    (note,) = _notes_on_random_levels(labelled, reference)
    assert note == "Random players kill 20 % (tanh; other), 10 % (ReLU)."
    assert _notes_on_random_levels(labelled, reference[:1]) == []
