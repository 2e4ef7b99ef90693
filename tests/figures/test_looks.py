"""What a figure of curves can look like: other quantities, layouts and sizes, many conditions, odd runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from pneuma.analysis.curves import Curve, curve_names
from pneuma.analysis.published import published_path, read_published
from pneuma.analysis.publishing import encode_study
from pneuma.analysis.run_index import open_study
from pneuma.errors import UserError
from pneuma.figures.curves import settle
from pneuma.figures.multiples import _grid
from pneuma.figures.panel import RUN_ALPHA, alpha_of_runs, draw_curve, draw_references
from pneuma.figures.sizes import SIZES
from pneuma.figures.style import COLOURS, condition_look

from .hand_made import BUDGET, HandMade, legend, words

NAN = float("nan")


def _caption(figure: Figure) -> str:
    return words(figure).replace("\n", " ")


def _thin_lines(axes: Axes) -> int:
    return sum(line.get_linewidth() < 0.6 for line in axes.get_lines())


# --- Quantities ----------------------------------------------------------------------------------


def test_every_quantity_has_a_panel_of_its_own(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    (path,) = study.draw(tmp_path, quantities=("entropy", "action_4", "length"), formats=("svg",))
    assert path.name == "fig-mine-entropy-action_4-length.svg"
    titles = [axes.get_title(loc="left").replace("\n", " ") for axes in drawn[0].axes]
    assert titles == ["Entropy of the policy", "Share of action: attack", "Length of episodes in training"]


def test_all_that_there_is_can_be_drawn(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    names = curve_names(open_study(study.store, study.record))
    (path,) = study.draw(tmp_path, quantities=names, formats=("svg",))
    assert path.name == "fig-mine-all.svg"
    assert len(drawn[0].axes) == len(names) == 18  # 3 of evaluations, 4 of episodes, 11 of updates


def test_gradient_norms_have_a_logarithmic_axis_without_tex(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, quantities=("grad_norm", "grad_norm_actor"), formats=("svg",))
    left, right = drawn[0].axes
    assert (left.get_yscale(), right.get_yscale()) == ("log", "linear")  # the other is 0.5 throughout
    assert "10²" in [label.get_text() for label in left.get_yticklabels()]
    assert "$" not in words(drawn[0])


def test_a_band_that_reaches_below_nothing_is_said_to_be_cut_off(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, band="std", formats=("svg",))  # each condition's runs are alike: no width
    study.add("relu", 2, evaluations=(0.5, 0.1, 0.1, 0.2))  # of 0, 0 and 0.5: 0.17 ± 0.29
    study.draw(tmp_path, band="std", formats=("svg",))
    study.draw(tmp_path, band="minmax", formats=("svg",))
    told = ["Bands are cut off below 0 %." in _caption(figure) for figure in drawn]
    assert told == [False, True, False]
    low, high = drawn[1].axes[0].get_ylim()
    assert low == pytest.approx(-0.02 * high)


def test_a_quantity_that_is_not_there_is_told(study: HandMade, tmp_path: Path) -> None:
    with pytest.raises(
        UserError, match="the results folder holds no entropi; its curves are: return, length"
    ):
        study.draw(tmp_path, quantities=("entropi",))


def test_shares_are_in_per_cent_without_idle_decimals(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, formats=("svg",))
    ticks = [label.get_text() for label in drawn[0].axes[0].get_yticklabels()]
    assert ticks[:4] == ["", "0 %", "10 %", "20 %"]  # below 0 the axis reaches a little, and has no share


def test_seeds_that_were_added_by_looking_are_told(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, formats=("svg",))
    study.record["adaptive"] = {"looks": [{"seeds": 1}, {"seeds": 2}, {"seeds": 10}]}
    study.draw(tmp_path, formats=("svg",))
    told = "Seeds were added until all was decided (looked at with 1, 2)"  # of ten seeds it is no figure
    assert [told in _caption(figure) for figure in drawn] == [False, True]
    data = open_study(study.store, study.record)
    study.store.write(published_path(study.store, "mine"), encode_study(data, (), False))
    assert read_published(study.store, "mine").record["adaptive"] == {"looks": [{"seeds": 1}, {"seeds": 2}]}


# --- Players of known skill ------------------------------------------------------------------------


def test_random_player_and_hunter_are_lines_of_their_own(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, band="std", formats=("svg",))
    assert legend(drawn[0])[-2:] == ["random player", "scripted hunter"]
    levels = [float(np.asarray(line.get_ydata(), float)[0]) for line in drawn[0].axes[0].get_lines()[-2:]]
    assert levels == pytest.approx([0.04, 0.5])
    assert len(drawn[0].axes[1].get_lines()) == 4  # of returns there is no record


def test_a_level_far_above_all_curves_flattens_nothing() -> None:
    axes = Figure().subplots()
    axes.plot([0, 1], [0.0, 0.1])
    draw_references(axes, {"random player": 0.29, "scripted hunter": 0.31}, 0.1)
    assert axes.get_ylim()[1] < 0.31
    assert axes.get_legend_handles_labels()[1] == ["random player"]


def test_levels_that_differ_between_conditions_are_not_drawn_as_one(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.add("elsewhere", 0, hunter=0.9)
    study.draw(tmp_path, formats=("svg",))
    assert "scripted hunter" not in legend(drawn[0])
    assert "differ between conditions, and are not drawn" in _caption(drawn[0])


def test_many_conditions_have_levels_in_their_own_panels_and_nothing_is_said(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    for number in range(7):
        study.add(f"other-{number}", 0, hunter=0.9 if number else 0.5)
    study.draw(tmp_path, formats=("svg",))
    assert "scripted hunter" in legend(drawn[0])
    assert "differ between conditions" not in _caption(drawn[0])


def test_sixty_single_runs_are_half_as_dark_as_thirty() -> None:
    few = [Curve(name, np.arange(3.0), np.zeros((10, 3))) for name in "abc"]
    many = [Curve(name, np.arange(3.0), np.zeros((10, 3))) for name in "abcdef"]
    trusted = Curve("g", np.arange(3.0), np.zeros((50, 3)))  # its runs are not drawn beside its band
    assert alpha_of_runs(few, "ci") == alpha_of_runs([*few[:1], trusted], "ci") == RUN_ALPHA
    assert alpha_of_runs(many, "ci") == RUN_ALPHA / 2
    axes = Figure().subplots()
    draw_curve(axes, many[0], "ci", condition_look(0), runs_alpha=0.125)
    assert [line.get_alpha() for line in axes.get_lines() if line.get_alpha() == 0.125] == [0.125] * 10


# --- Layouts and sizes -----------------------------------------------------------------------------


def test_the_thesiss_layout_is_one_panel_of_trailing_returns_from_least_to_greatest(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    (path,) = study.draw(tmp_path, layout="thesis", formats=("svg",))
    assert path.name == "fig-mine-thesis.svg"
    (axes,) = drawn[0].axes
    assert axes.get_title(loc="left") == "Return in training"
    assert legend(drawn[0]) == ["tanh (n = 2)", "relu (n = 2)"]
    assert "band: least to greatest" in words(drawn[0])
    assert "each run's last 100 episodes" in _caption(drawn[0])


@pytest.mark.parametrize(
    ("size", "pixels"), [("page", (2100, None)), ("column", (990, None)), ("slide", (1920, 1080))]
)
def test_a_size_is_what_it_says(
    study: HandMade, tmp_path: Path, size: str, pixels: tuple[int, int | None]
) -> None:
    (path,) = study.draw(tmp_path, size=size, formats=("png",))
    with Image.open(path) as image:
        assert image.width == pixels[0] and pixels[1] in (None, image.height)


@pytest.mark.parametrize("size", SIZES)
def test_no_word_reaches_over_the_edge(
    study: HandMade, tmp_path: Path, drawn: list[Figure], size: str
) -> None:
    study.add("a-condition-with-quite-a-long-name", 0, status="diverged")
    study.draw(tmp_path, size=size, band="bootstrap", formats=("png",))
    figure = drawn[0]
    width, height = figure.bbox.size
    for text in (*figure.texts, *figure.legends):
        box = text.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height, text


def test_what_does_not_fit_a_slide_is_told(study: HandMade, tmp_path: Path) -> None:
    names = curve_names(open_study(study.store, study.record))
    with pytest.raises(UserError, match="6 rows of panels do not fit a height of 5.625 inches"):
        study.draw(tmp_path / "figures", quantities=names, size="slide")
    assert not (tmp_path / "figures").exists()


def test_what_is_left_open_is_settled_by_layout_and_data(study: HandMade) -> None:
    data = open_study(study.store, study.record)
    usual, thesis = settle(data), settle(data, layout="thesis")
    assert (usual.quantities, usual.band, usual.window) == (("share_killed", "return"), "ci", "budget-5%")
    assert (thesis.quantities, thesis.band, thesis.window) == (("return",), "minmax", "trailing-100")


# --- Many conditions -------------------------------------------------------------------------------


@pytest.mark.parametrize("size", SIZES)
def test_more_than_eight_conditions_get_a_panel_each(tmp_path: Path, drawn: list[Figure], size: str) -> None:
    study = HandMade(tmp_path)
    study.record["baseline"] = "condition-0"
    for number in range(24):
        study.add(f"condition-{number}", 0)
    study.draw(tmp_path, size=size, formats=("svg",))
    panels = drawn[0].axes
    titles = [axes.get_title(loc="left").replace("\n", " ") for axes in panels]
    assert titles == [f"condition-{number} (n = 1)" for number in range(24)]
    assert len({axes.get_ylim() for axes in panels}) == 1
    assert legend(drawn[0])[:3] == ["the panel's condition", "the others", "condition-0 (baseline)"]


def test_the_last_number_below_a_panel_ends_with_it(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for number in range(12):
        study.add(f"condition-{number}", 0)
    study.draw(tmp_path, formats=("png",))
    lowest = [axes for axes in drawn[0].axes if axes.xaxis.get_tick_params()["labelbottom"]]
    assert len(lowest) == 6
    for axes in lowest:
        last = axes.get_xticklabels()[-1]
        assert last.get_position()[0] == axes.get_xlim()[1]
        assert last.get_window_extent().x1 <= axes.get_window_extent().x1 + 1


def test_all_panels_have_one_random_player(tmp_path: Path, drawn: list[Figure]) -> None:
    """Not each the sample of it that its condition's evaluations drew."""
    study = HandMade(tmp_path)
    for number in range(9):
        study.add(f"condition-{number}", 0, random=0.04 + number / 1000)
    study.draw(tmp_path, formats=("svg",))
    lines = [
        line for axes in drawn[0].axes for line in axes.get_lines() if line.get_label() == "random player"
    ]
    assert [line.get_ydata()[0] for line in lines] == pytest.approx([0.044] * 9)  # type: ignore[index]


def test_a_level_above_all_panels_is_told_once(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for number in range(9):
        study.add(f"condition-{number}", 0, evaluations=(0.01, 0.02, 0.02, 0.03), hunter=1.0)
    study.draw(tmp_path, formats=("svg",))
    assert _caption(drawn[0]).count("Above the axis: scripted hunter 100 %.") == 1
    assert not [text for axes in drawn[0].axes for text in axes.texts]
    assert "scripted hunter" not in legend(drawn[0])


def test_a_condition_without_a_finished_run_is_left_out(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.add("never", 0, status="crashed")
    study.draw(tmp_path, formats=("svg",))
    assert not [entry for entry in legend(drawn[0]) if entry.startswith("never")]


def test_eight_looks_differ_in_grey() -> None:
    """Of any two, dashes or markers differ: their greys alone would not do."""
    looks = [condition_look(place) for place in range(8)]
    assert len({(str(look["linestyle"]), look["marker"]) for look in looks}) == 8
    greys = sorted(float(np.dot(to_rgb(colour), [0.299, 0.587, 0.114])) for colour in COLOURS)
    assert greys[-1] < 0.75  # the lightest is still seen on white


# --- Odd runs --------------------------------------------------------------------------------------


def test_a_band_that_covers_too_rarely_is_drawn_with_its_runs_and_marked(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, band="se", formats=("svg",))
    assert legend(drawn[0])[0] == "tanh (n = 2)"
    assert "Bands of two runs say little; so the runs are drawn too, as thin lines." in _caption(drawn[0])
    assert _thin_lines(drawn[0].axes[1]) == 4
    study.draw(tmp_path, band="std", formats=("svg",))
    assert legend(drawn[1])[0] == "tanh (n = 2)"
    assert _thin_lines(drawn[1].axes[1]) == 0


def test_what_no_run_has_a_value_of_is_not_drawn(tmp_path: Path, drawn: list[Figure]) -> None:
    mail = HandMade(tmp_path)
    mail.add("rate-1", 0, evaluations=(NAN,) * 4)
    mail.draw(tmp_path, formats=("svg",))
    assert [axes.get_title(loc="left") for axes in drawn[0].axes] == ["Return in training"]
    with pytest.raises(UserError, match="holds no share_killed; its curves are: "):
        mail.draw(tmp_path, quantities=("share_killed",))


@pytest.mark.parametrize("size", SIZES)
def test_long_names_fit_into_the_legend(tmp_path: Path, drawn: list[Figure], size: str) -> None:
    study = HandMade(tmp_path)
    for rate in ("1e-4", "3e-4", "1e-3"):
        study.add(f"learning_rate={rate}, reward=thesis, scale=unit, stationary", 0)
    study.draw(tmp_path, size=size, formats=("png",))
    (legend,) = drawn[0].legends
    box, room = legend.get_window_extent(), drawn[0].bbox
    assert box.x0 >= 0 and box.x1 <= room.width
    assert box.y0 >= max(axes.get_tightbbox().y1 for axes in drawn[0].axes)  # type: ignore[union-attr]


def test_every_run_can_be_drawn_in_place_of_a_band(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.draw(tmp_path, band="runs", formats=("svg",))
    assert _thin_lines(drawn[0].axes[1]) == 4
    assert legend(drawn[0])[0] == "tanh (n = 2)"


def test_a_diverged_run_ends_in_a_cross(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    study.add("tanh", 2, episodes=2, evaluations=(0.1,), status="diverged")
    study.draw(tmp_path, formats=("svg",))
    crosses = [line for line in drawn[0].axes[0].get_lines() if line.get_marker() == "x"]
    assert [(list(line.get_xdata()), list(line.get_ydata())) for line in crosses] == [([250.0], [0.1])]  # type: ignore[arg-type]
    assert "×: a run diverged" in _caption(drawn[0])


def test_a_run_without_a_finite_return_is_counted_and_told(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.add("tanh", 2, returns=NAN)
    study.draw(tmp_path, band="std", formats=("svg",))
    assert "1 of 3 runs of tanh have no return, and count in no mean of it" in _caption(drawn[0])
    faint = np.asarray(drawn[0].axes[1].get_lines()[1].get_ydata(), float)
    assert faint[199] == 19.5  # episode 19 of seeds 0 and 1


def test_equal_values_are_drawn(tmp_path: Path, drawn: list[Figure]) -> None:
    study = HandMade(tmp_path)
    for seed in range(3):
        study.add("tanh", seed, evaluations=(0.0,) * 4, returns=0.0)
    study.draw(tmp_path, formats=("svg",))
    low, high = drawn[0].axes[0].get_ylim()
    assert low < 0 < high <= 0.1  # a line at 0 lies above the axis
    assert "covers the mean in as little as 82 % (n = 3) of cases" in _caption(drawn[0])


def test_different_budgets_are_compared_where_all_were(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    study.add("big", 0, steps=BUDGET // 2, episodes=10, evaluations=(0.1, 0.2))
    study.draw(tmp_path, formats=("svg",))
    assert "Upright line: 500 steps" in _caption(drawn[0])
    assert any(list(line.get_xdata()) == [500, 500] for line in drawn[0].axes[0].get_lines())  # type: ignore[arg-type]
    assert "big (n = 1)" in legend(drawn[0])


def test_returns_of_unlike_rewards_do_not_stand_side_by_side(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    for run in study.record["runs"]:
        run["run"]["reward"] = ["thesis"] if run["condition"] == "tanh" else ["kills"]
    study.draw(tmp_path, formats=("svg",))
    study.draw(tmp_path, formats=("svg",), quantities=("return",))
    titles = [[axes.get_title(loc="left") for axes in figure.axes] for figure in drawn]
    assert titles == [
        ["Monsters killed in evaluation", "Length of episodes in training"],
        ["Return in training"],
    ]
    assert ["cannot be compared" in _caption(figure) for figure in drawn] == [False, True]


def test_forks_of_one_run_are_told(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    for run in study.record["runs"]:
        run["run"]["parent"] = "a1a1a1a1a1a1a1a1"
    study.draw(tmp_path, formats=("svg",))
    assert "Runs are forks of one run: intervals take them for independent." in _caption(drawn[0])


def test_engines_that_are_mixed_are_told(study: HandMade, tmp_path: Path, drawn: list[Figure]) -> None:
    for place, run in enumerate(study.record["runs"]):
        run["run"]["engine"] = ("batched", "sb3")[place % 2]
    study.draw(tmp_path, formats=("svg",))
    assert "Engines are mixed (batched, sb3): no contrast holds" in _caption(drawn[0])


# --- A page ----------------------------------------------------------------------------------------


def test_panels_leave_no_hole_where_that_may_be() -> None:
    assert [_grid(count, 6) for count in (9, 10, 12, 16, 32)] == [(3, 3), (2, 5), (2, 6), (4, 4), (8, 4)]
    assert [_grid(count, 6) for count in (11, 13)] == [(2, 6), (3, 5)]  # these cannot but have one


def test_long_names_of_crossed_conditions_head_panels_by_their_levels(
    tmp_path: Path, drawn: list[Figure]
) -> None:
    study = HandMade(tmp_path)
    for reward in ("thesis", "pygame", "godot", "kills"):
        for scale in ("unit", "map", "raw"):
            for kind in ("stationary", "non-stationary"):
                study.add(f"reward={reward}, scale={scale}, activation=tanh, {kind}", 0)
    study.draw(tmp_path, formats=("svg",))
    titles = [axes.get_title(loc="left") for axes in drawn[0].axes]
    assert titles[1].replace("\n", " ") == "thesis, unit, tanh, non-stationary (n = 1)"
    assert max(title.count("\n") for title in titles) <= 2
    assert "Panels: reward, scale, activation, condition." in words(drawn[0]).replace("\n", " ")
    assert drawn[0].get_size_inches()[1] < 10
