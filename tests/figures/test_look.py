"""What a user asks of a figure's look: its size, title, style sheet, and no caption."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from pneuma.errors import UserError
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import save_page
from pneuma.figures.style import Look

from .hand_made import HandMade, legend

PNG = ("png",)


@pytest.fixture
def study(tmp_path: Path) -> HandMade:
    made = HandMade(tmp_path)
    for condition in ("one", "two"):
        for seed in range(5):
            made.add(condition, seed)
    return made


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.texts if text.get_text()]


def test_a_figure_has_the_size_and_title_that_are_asked_for(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    page = curves_page(study.data, ["return", "share_killed"])
    save_page(page, tmp_path, PNG, look=Look(width=3.25, height=5, title="Mine"))
    (figure,) = drawn
    assert figure.get_size_inches().tolist() == [3.25, 5]
    assert texts(figure)[0] == "Mine"
    across = {round(axes.get_position().x0, 3) for axes in figure.axes}
    assert len(across) == 1  # one below the other, where a page has both in a row
    for text in figure.texts:
        assert text.get_window_extent().x1 <= figure.bbox.x1


def test_a_plain_figure_has_a_legend_and_no_other_words(
    study: HandMade, tmp_path: Path, drawn: list[Figure]
) -> None:
    save_page(curves_page(study.data), tmp_path, PNG, look=Look(plain=True))
    assert texts(drawn[0]) == []
    assert legend(drawn[0])


def test_a_style_sheet_colours_conditions(study: HandMade, tmp_path: Path) -> None:
    sheet = tmp_path / "mine.mplstyle"
    sheet.write_text("axes.prop_cycle: cycler('color', ['112233', '445566'])\n")
    (path,) = save_page(curves_page(study.data), tmp_path, ("svg",), look=Look(sheet=str(sheet)))
    assert "stroke: #112233" in (svg := path.read_text()) and "stroke: #445566" in svg


@pytest.mark.parametrize(
    ("look", "said"),
    [
        (Look(sheet="no-such-sheet"), "--style no-such-sheet: "),
        (Look(height=0.5), "--height 0.5: at least "),
    ],
)
def test_what_cannot_be_drawn_is_told(study: HandMade, tmp_path: Path, look: Look, said: str) -> None:
    with pytest.raises(UserError, match=said):
        save_page(curves_page(study.data), tmp_path, PNG, look=look)
