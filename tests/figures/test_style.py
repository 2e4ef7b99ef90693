"""The look of all figures: colours of conditions, safe texts, small files."""

from __future__ import annotations

import xml.dom.minidom
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from pneuma.analysis.drawing import drawing_of
from pneuma.errors import printable
from pneuma.figures.grid import label_rows
from pneuma.figures.style import house_style, save_figure
from pneuma.figures.words import looks_of

from .hand_made import HandMade


def test_colours_are_in_the_files_order_but_for_those_that_it_names(study: HandMade) -> None:
    def colours(**named: str) -> dict[str, str]:
        data = study.data
        own = replace(data, study=data.study.model_copy(update={"colors": named}))
        return {name: look["color"] for name, look in looks_of(drawing_of({"": own})).items()}

    assert colours() == {"tanh": "C0", "relu": "C1"}
    assert colours(relu="C0") == {"tanh": "C1", "relu": "C0"}
    assert colours(tanh="#123456") == {"tanh": "#123456", "relu": "C0"}
    part = study.data.of_conditions(["relu"])
    assert (
        len(part.runs) == 2
        and looks_of(drawing_of({"": part}))["relu"] == looks_of(drawing_of({"": study.data}))["relu"]
    )


def test_what_cannot_be_seen_is_written_as_its_code_in_an_svg_that_is_xml(tmp_path: Path) -> None:
    wild = "a\x1b\u202eb\ud800"
    assert printable(wild) == r"a\u001b\u202eb\ud800"
    with house_style():
        figure = Figure()
        axes = figure.subplots()
        axes.set_title(wild)
        label_rows(axes, [wild], 1.0)
        (path,) = save_figure(figure, tmp_path, "wild", ("svg",), "")
    document = path.read_text(encoding="utf-8")
    xml.dom.minidom.parseString(document)
    assert document.count(r"a\u001b\u202eb\ud800") == 2


def test_letters_that_figures_cannot_show_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with house_style():
        for title in ("größer β₁", "大きい β₁"):
            figure = Figure()
            figure.subplots().set_title(title)
            save_figure(figure, tmp_path, "names", ("png",), "")
            assert ("lacks い き 大" in capsys.readouterr().err) == title.startswith("大")
