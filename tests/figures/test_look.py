"""What a user asks of figures: size, title, style sheet, own axes, another centre or horizontal axis."""

from __future__ import annotations

import itertools
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from pneuma.analysis.curves import find_curves
from pneuma.api import plot
from pneuma.errors import UserError
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import save_page
from pneuma.figures.style import Look

from .hand_made import HandMade, legend, words


def test_own_axes_are_drawn_in_matplotlibs_present_settings(study: HandMade) -> None:
    with mpl.rc_context({"lines.linewidth": 5.0, "axes.prop_cycle": "cycler('color', ['112233', '445566'])"}):
        axes = Figure().subplots()
        assert plot(study.data, "share_killed", axes) is axes
        lines = {line.get_label(): line for line in axes.get_lines() if line.get_linewidth() == 5}
        colours = [mpl.colors.to_hex(lines[name].get_color()) for name in ("tanh (2)", "relu (2)")]
    assert colours == ["#112233", "#445566"]
    assert np.asarray(lines["tanh (2)"].get_ydata()).tolist() == pytest.approx([0.1, 0.2, 0.3, 0.4])
    assert axes.get_legend() is not None and axes.get_xlabel() == "Environment steps"
    with pytest.raises(UserError, match="unknown curve"):
        plot(study.data, "kl", axes)


def test_a_figure_names_what_it_lies_over(study: HandMade, tmp_path: Path, figures: list[Figure]) -> None:
    (path,) = study.draw(tmp_path, x="wall-clock")
    assert path.stem == "mine-over-wall-clock" and "Seconds of training" in words(figures[0])
    assert "Within a run, all steps are taken to last equally long." in words(figures[0])


def test_a_log_axis_of_zeros_is_none_and_a_condition_of_zeros_is_named(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    """Nothing could be drawn of it, not even its name, beside a caption on logarithms."""
    zeros = HandMade(tmp_path / "zeros")
    for seed in (0, 1):
        zeros.add("none", seed, evaluations=(0.0,) * 4)
        study.add("none", seed, evaluations=(0.0,) * 4)
    zeros.draw(tmp_path, "share_killed", log=True)
    assert figures[0].axes[0].get_yscale() == "linear" and "none (2)" in words(figures[0])
    assert "Monsters killed in evaluation: no value is above 0, so the axis is linear." in words(figures[0])
    assert "logarithm" not in words(figures[0])
    study.draw(tmp_path, "share_killed", log=True)
    assert figures[1].axes[
        0
    ].get_yscale() == "log" and "Some of none (2 runs) have no value in a panel" in words(figures[1])


# --- Its look ----------------------------------------------------------------------------------------

PNG = ("png",)


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts if text.get_text()]


def test_a_figure_has_the_size_and_title_that_are_asked_for(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    save_page(
        study.page("return", "share_killed"), tmp_path, PNG, look=Look(width=3.25, height=5, title="Mine")
    )
    (figure,) = figures
    assert figure.get_size_inches().tolist() == [3.25, 5]
    assert texts(figure)[0] == "Mine"
    across = {round(axes.get_position().x0, 3) for axes in figure.axes}
    assert len(across) == 1  # one below the other, where a page has both in a row
    for text in figure.texts:
        assert text.get_window_extent().x1 <= figure.bbox.x1


def test_panels_and_legend_do_not_overlap_at_the_least_height(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    """At 3.25 by 2.4 inches two panels overlapped."""
    with pytest.raises(UserError, match=r"height='2.4': at least 3.2 inches for 2 panels$"):
        save_page(study.page(), tmp_path, PNG, look=Look(3.25, 2.4, plain=True))
    for quantities, height in (((), 3.2), (("return",), 2.4)):
        save_page(study.page(*quantities), tmp_path, PNG, look=Look(3.25, height, plain=True))
        assert figures[-1].get_size_inches().tolist() == [3.25, height]
        tight = [axes.get_tightbbox() for axes in figures[-1].axes]
        boxes = [box.padded(-1) for box in tight if box is not None]
        boxes.append(figures[-1].legends[0].get_window_extent())
        assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))


def test_columns_of_worlds_go_below_each_other_where_they_do_not_fit(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    page = curves_page(find_curves({"One world": study.data, "Another world": study.data}, ["return"]))
    for width in (7.0, 3.0):
        save_page(page, tmp_path, PNG, look=Look(width=width))
    beside, below = ([*figure.axes] for figure in figures)
    assert len({round(axes.get_position().y0, 3) for axes in beside}) == 1
    assert [axes.get_ylabel() for axes in beside] == ["Return in training", ""]
    assert len({round(axes.get_position().x0, 3) for axes in below}) == 1
    assert [axes.get_ylabel() for axes in below] == ["Return in training"] * 2
    assert [axes.get_xlabel() for axes in below] == ["", "Environment steps"]
    assert figures[1].get_size_inches()[1] > 1.5 * figures[0].get_size_inches()[1]


def test_a_plain_figure_has_a_legend_and_no_other_words(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    save_page(study.page(), tmp_path, PNG, look=Look(plain=True))
    assert texts(figures[0]) == ["Environment steps"]
    assert legend(figures[0])


def test_a_style_sheet_colours_conditions(study: HandMade, tmp_path: Path) -> None:
    sheet = tmp_path / "mine.mplstyle"
    sheet.write_text("axes.prop_cycle: cycler('color', ['112233', '445566'])\n")
    (path,) = save_page(study.page(), tmp_path, ("svg",), look=Look(sheet=str(sheet)))
    assert "stroke: #112233" in (svg := path.read_text()) and "stroke: #445566" in svg


def test_a_style_sheets_size_of_text_is_that_of_all_texts(
    study: HandMade, tmp_path: Path, figures: list[Figure]
) -> None:
    """Ticks have five sixths of it, captions 0.78; what the sheet sets itself stays."""
    sheet = tmp_path / "mine.mplstyle"
    sheet.write_text("font.size: 12\naxes.labelsize: 7\n")
    save_page(study.page(), tmp_path, PNG, look=Look(height=6, sheet=str(sheet)))
    axes = figures[0].axes[0]
    assert axes._left_title.get_fontsize() == 12  # type: ignore[attr-defined]
    assert axes.yaxis.label.get_fontsize() == 7
    assert axes.get_xticklabels()[0].get_fontsize() == pytest.approx(12 / 1.2, rel=0.01)
    assert figures[0].legends[0].get_texts()[0].get_fontsize() == 12
    assert figures[0].texts[-1].get_fontsize() == pytest.approx(0.78 * 12)


@pytest.mark.parametrize(
    ("look", "said"),
    [
        (Look(sheet="no-such-sheet"), "style='no-such-sheet': "),
        (Look(height=0.5), r"height='0.5': at least \d\.\d inches for 2 panels; plain leaves out headline"),
    ],
)
def test_what_cannot_be_drawn_is_told(study: HandMade, tmp_path: Path, look: Look, said: str) -> None:
    with pytest.raises(UserError, match=said):
        save_page(study.page(), tmp_path, PNG, look=look)
