"""A study's figure: the same bytes every time, and honest about how many runs it shows."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from pneuma.analysis.run_index import open_study
from pneuma.errors import UserError
from pneuma.figures import FIGURE_FORMATS
from pneuma.figures.looks import MOST_IN_A_PANEL
from pneuma.figures.panel import log_ticks
from pneuma.study.store import Status

from .hand_made import BUDGET, HandMade, headline, legend, make_id, words

# --- Files ---------------------------------------------------------------------------------------


def test_a_figure_is_named_by_its_study(study: HandMade, tmp_path: Path) -> None:
    paths = study.draw(tmp_path / "figures", formats=("png", "svg", "pdf"))
    assert paths == [tmp_path / "figures" / f"fig-mine.{form}" for form in ("png", "svg", "pdf")]
    assert sorted((tmp_path / "figures").iterdir()) == sorted(paths)


@pytest.mark.parametrize("form", FIGURE_FORMATS)
def test_drawing_twice_gives_the_same_bytes(study: HandMade, tmp_path: Path, form: str) -> None:
    (first,) = study.draw(tmp_path / "first", formats=(form,))
    (second,) = study.draw(tmp_path / "second", formats=(form,))
    assert first.read_bytes() == second.read_bytes()
    assert len(first.read_bytes()) > 5000


def test_a_persons_own_style_changes_no_byte(study: HandMade, tmp_path: Path) -> None:
    (first,) = study.draw(tmp_path / "first", formats=("svg",))
    with mpl.rc_context({"lines.linewidth": 9.0, "font.size": 20, "axes.facecolor": "red"}):
        (second,) = study.draw(tmp_path / "second", formats=("svg",))
        assert mpl.rcParams["lines.linewidth"] == 9.0  # and is left alone
    assert first.read_bytes() == second.read_bytes()


def test_other_numbers_give_other_bytes(study: HandMade, tmp_path: Path) -> None:
    (first,) = study.draw(tmp_path / "first", formats=("svg",))
    study.store.save_run(make_id("tanh", 0), Status("planned"), {})
    study.record["runs"].pop(0)
    study.add("tanh", 0, evaluations=(0.1, 0.2, 0.3, 0.9))
    (second,) = study.draw(tmp_path / "second", formats=("svg",))
    assert first.read_bytes() != second.read_bytes()


def test_every_run_of_another_study_is_drawn_beside(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    other = open_study(study.store, {**study.record, "study": "other", "title": "Another"})
    study.draw(tmp_path, quantities=("return",))
    (path, _) = study.draw(tmp_path, quantities=("return",), beside=other)
    alone, beside = (figure.axes[0] for figure in drawn)
    assert path.name == "fig-mine-return-beside-other.png"
    assert len(beside.lines) == len(alone.lines) + len(other.runs) == len(alone.lines) + 4
    assert "Another" in legend(drawn[1])


# --- What it says --------------------------------------------------------------------------------


def test_the_legend_says_of_how_many_runs(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    study.add("tanh", 2)
    study.draw(tmp_path)
    assert legend(drawn[0])[:2] == ["tanh (n = 3)", "relu (n = 2)"]
    told = "covers the mean in as little as 82 % (n = 3) of cases at a point; bands of two runs say little"
    assert words(drawn[0]).replace("\n", " ").count(told) == 1


@pytest.mark.parametrize(
    ("band", "said"),
    [
        ("std", "± 1 standard deviation"),
        ("variance", "unit: how wide this band looks means nothing"),
        ("se", "± 1 standard error"),
        ("ci", "95 % interval of the mean (Student's t)"),
        ("bootstrap", "95 % interval of the mean (bootstrap)"),
        ("minmax", "least to greatest"),
        ("iqr", "first to third quartile"),
        ("runs", "every run as a thin line"),
    ],
)
def test_a_figure_says_what_its_band_is(
    study: HandMade, tmp_path: Path, drawn: list[Figure], band: str, said: str
) -> None:
    study.draw(tmp_path, band=band)
    assert said in words(drawn[0]).replace("\n", " ")


@pytest.mark.parametrize(("window", "said"), [("budget-5%", "last 5 %"), ("trailing-100", "100 episodes")])
def test_a_figure_says_what_a_point_averages(
    study: HandMade, tmp_path: Path, drawn: list[Figure], window: str, said: str
) -> None:
    study.draw(tmp_path, window=window)
    assert said in words(drawn[0]).replace("\n", " ")


@pytest.mark.parametrize(
    ("quantities", "window", "said"),
    [
        (("entropy",), "trailing-100", "the updates of the last 5 % of the budget before each point."),
        (("return", "entropy"), "budget-5%", "the episodes or updates of the last 5 % of the budget"),
        (
            ("return", "entropy"),
            "trailing-100",
            "each run's last 100 episodes, or the updates of the last 5 %",
        ),
    ],
)
def test_what_updates_average_is_said_of_them(
    study: HandMade, tmp_path: Path, drawn: list[Figure], quantities: tuple[str, ...], window: str, said: str
) -> None:
    study.draw(tmp_path, quantities=quantities, window=window)
    assert f"Curves of training average {said}" in words(drawn[0]).replace("\n", " ")


def test_evaluations_alone_average_nothing(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    study.draw(tmp_path, quantities=("share_killed",))
    assert "average" not in words(drawn[0])


def test_conditions_that_were_not_run_are_named(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    study.add("leaky-relu", 0, status="crashed")
    study.draw(tmp_path)
    assert "Without a finished run: leaky-relu." in words(drawn[0]).replace("\n", " ")


def test_a_name_that_is_no_text_is_refused(study: HandMade, tmp_path: Path) -> None:
    """A stranger's record may hold half a character."""
    study.add("half\ud800", 0, run_id="a" * 16)
    with pytest.raises(UserError, match="the name 'half.ud800' is no text"):
        study.draw(tmp_path / "figures")
    assert not (tmp_path / "figures").exists()


def test_a_figure_names_its_study_and_environment(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path)
    assert headline(drawn[0]) == "Mine in the text's world"
    assert "pneuma/Pneuma-v0" in words(drawn[0])


@pytest.mark.parametrize(
    ("environments", "said"),
    [
        (("pneuma/PneumaGodot-v0",), "Mine in the published code's world"),
        (("pneuma/Pneuma-v0", "pneuma/PneumaGodot-v0"), "Mine"),
        (("CartPole-v1",), "Mine"),
    ],
)
def test_where_a_study_is_played_is_told_by_its_runs_not_by_its_name(
    study: HandMade, tmp_path: Path, drawn: list[Figure], environments: tuple[str, ...], said: str
) -> None:
    """As of forks of runs in the published code's world, or of the winner of a search there."""
    for place, run in enumerate(study.record["runs"]):
        run["run"]["env"] = environments[place % len(environments)]
    study.draw(tmp_path)
    assert headline(drawn[0]) == said


def test_an_a_a_comparison_is_noted_in_the_headline(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.record["same"] = [["tanh", "again"]]
    study.add("again", 0, run_id=make_id("tanh", 0))
    study.add("again", 1, run_id=make_id("tanh", 1))
    study.draw(tmp_path, band="std")
    assert "A/A" in headline(drawn[0])
    assert "tanh = again" in headline(drawn[0])
    assert {"tanh (n = 2)", "again (n = 2)"} <= set(legend(drawn[0]))


def test_lines_are_the_means_and_bands_lie_around_them(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, band="minmax")
    right, left = drawn[0].axes
    tanh = left.get_lines()[0]
    # 1,000 / 200 = 5 steps a point, 50 steps a window: at 50 (point 10) episode 0 alone, returning 0 and 1
    assert np.isnan(np.asarray(tanh.get_ydata(), float)[:9]).all()
    assert np.asarray(tanh.get_ydata(), float)[9] == 0.5
    np.testing.assert_allclose(np.asarray(right.get_lines()[0].get_ydata(), float), [0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(np.asarray(right.get_lines()[0].get_xdata(), float), [250, 500, 750, 1000])
    assert left.get_xlim() == right.get_xlim() == (0, BUDGET)


# --- Few runs, short runs ------------------------------------------------------------------------


def _corners_of_bands(figure: Figure) -> int:
    """Count the finite corners of everything that is filled in."""
    paths = [path for axes in figure.axes for band in axes.collections for path in band.get_paths()]
    return sum(int(np.isfinite(np.asarray(path.vertices)).all(axis=1).sum()) for path in paths)


def test_one_seed_is_drawn_without_a_band(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    study.add("tanh", 0)
    study.draw(tmp_path)
    assert legend(drawn[0])[0] == "tanh (n = 1)"
    assert _corners_of_bands(drawn[0]) == 0
    study.add("tanh", 1)
    study.draw(tmp_path)
    assert _corners_of_bands(drawn[1]) > 0


def test_a_diverged_run_of_few_episodes_is_drawn_as_far_as_it_went(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.add("tanh", 2, episodes=2, evaluations=(0.1,), status="diverged")
    study.draw(tmp_path, band="std")
    assert legend(drawn[0])[0] == "tanh (n = 3, 2 at the end)"
    line = np.asarray(drawn[0].axes[1].get_lines()[0].get_ydata(), float)
    assert line[9] == 1.0  # at step 50: of seeds 0, 1 and 2
    assert np.isnan(line[199])  # at step 1,000 only seeds 0 and 1 have a value: drawn faint
    faint = np.asarray(drawn[0].axes[1].get_lines()[1].get_ydata(), float)
    assert faint[199] == 19.5  # their episode 19


@pytest.mark.parametrize("episodes", [0, 2])
def test_a_diverged_run_that_was_never_evaluated_is_still_counted(
    study: HandMade, tmp_path: Path, drawn: list[Figure], episodes: int
) -> None:
    """Design section 4: a diverged run stays in every statistic."""
    study.add("tanh", 2, episodes=episodes, evaluations=(), status="diverged")
    study.draw(tmp_path)
    assert legend(drawn[0])[0] == "tanh (n = 3, 2 at the end)"
    tanh, _ = (band for band in drawn[0].axes[0].collections if isinstance(band, PolyCollection))
    assert not tanh.get_paths()  # those that are left are no sample, so there is no band


def test_a_condition_whose_runs_all_diverged_at_once_stays_in_the_legend(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.add("explosive", 0, episodes=0, evaluations=(), status="diverged")
    study.draw(tmp_path)
    assert "explosive (n = 1, 0 at the end)" in legend(drawn[0])


def test_runs_in_which_no_episode_ended_are_drawn_with_their_evaluations(tmp_path: Path) -> None:
    study = HandMade(tmp_path)
    study.add("tanh", 0, episodes=0)
    assert study.draw(tmp_path, formats=("svg",))[0].exists()


def test_more_conditions_than_colours_are_still_told_apart(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for number in range(MOST_IN_A_PANEL):
        study.add(f"condition-{number}", 0)
    study.draw(tmp_path, formats=("svg",))
    looks = [
        (str(line.get_color()), str(line.get_linestyle()), str(line.get_marker()))
        for line in drawn[0].axes[0].get_lines()[: 2 * MOST_IN_A_PANEL : 2]
    ]
    assert len({colour for colour, _, _ in looks}) == len(set(looks)) == MOST_IN_A_PANEL


@pytest.mark.parametrize("size", ["page", "column"])
def test_a_page_of_any_number_of_conditions_has_room_for_all(
    tmp_path: Path, drawn: list[Figure], size: str
) -> None:
    study = HandMade(tmp_path)
    for number in range(90):
        study.add(f"learning_rate={number + 1}e-4, reward=thesis, scale=raw, wide-clip", 0)
    study.draw(tmp_path, formats=("svg",), size=size)
    assert len(drawn[0].axes) == 90
    least = min(axes.get_position().height for axes in drawn[0].axes) * drawn[0].get_figheight()
    assert least >= 0.2  # inches
    assert "Panels: learning_rate, reward, scale, condition." in words(drawn[0]).replace("\n", " ")


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (1e-4, 1e-3, [1e-4, 1e-3]),
        (1e-6, 1e-1, [1e-6, 1e-4, 1e-2]),
        (2e-4, 8e-4, [2e-4, 5e-4]),
        (256, 2048, [500, 1000, 2000]),
        (3e-4, 4e-4, [3e-4, 4e-4]),
    ],
)
def test_a_logarithmic_axis_has_numbers_however_short_it_is(
    low: float, high: float, ticks: list[float]
) -> None:
    assert log_ticks(low, high) == ticks


def test_a_study_without_a_finished_run_is_told_and_nothing_is_written(tmp_path: Path) -> None:
    study = HandMade(tmp_path)
    study.add("tanh", 0, status="crashed")
    with pytest.raises(UserError, match="no run of this selection of study mine has finished"):
        study.draw(tmp_path / "figures")
    assert not (tmp_path / "figures").exists()
