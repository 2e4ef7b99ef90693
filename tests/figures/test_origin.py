"""A figure's origin: the text that every format of its file has."""

from __future__ import annotations

from pathlib import Path
from xml.dom.minidom import parse

import pytest
from matplotlib.figure import Figure
from PIL import Image

from pneuma.cli.options import seeds
from pneuma.figures import FIGURE_FORMATS
from pneuma.figures.origin import line_of_runs, origin_text
from pneuma.figures.style import house_style, save_figure
from pneuma.seeds import format_seeds

AWKWARD = 'a)(\\b"<&amp;>]]>\u00e4\x1b\ud800\n'
FEW = line_of_runs("mine", "tanh", ["b" * 16, "a" * 16], [3, 1, 2])
MANY = line_of_runs("mine", AWKWARD, [f"{k:016x}" for k in range(50)], [*range(100, 150), 7])


def test_a_line_has_seeds_as_ranges_and_many_ids_as_a_checksum() -> None:
    assert f"mine, tanh, seeds 1..3, ids {'a' * 16}, {'b' * 16}" == FEW
    awkward = AWKWARD.replace("\x1b", "\\u001b").replace("\ud800", "\\ud800").replace("\n", "\\u000a")
    assert MANY.startswith(f"mine, {awkward}, seeds 7,100..149, ids 50 with SHA-256 ")
    assert line_of_runs("mine", "", ["a" * 16], ()) == f"mine, ids {'a' * 16}"


def test_every_format_has_what_is_shown_and_the_runs(tmp_path: Path) -> None:
    text = origin_text("Two\nlearners", [FEW, MANY])
    assert text == f"Pneuma: Two\\u000alearners\n{FEW}\n{MANY}"
    with house_style():
        figure = Figure()
        figure.subplots().plot([0, 1])
        png, svg, pdf = save_figure(figure, tmp_path, "figure", FIGURE_FORMATS, text)
        (plain_pdf,) = save_figure(figure, tmp_path, "plain", ("pdf",), origin_text("Learners", [FEW]))
    with Image.open(png) as image:
        assert image.info["Description"] == text
    (description,) = parse(str(svg)).getElementsByTagName("dc:description")
    assert description.firstChild and description.firstChild.nodeValue == text
    assert text.encode("utf-16-be").partition(b"\\")[0] in pdf.read_bytes()
    assert b"seeds 1..3, ids " + b"a" * 16 in plain_pdf.read_bytes()


def test_other_ids_give_another_line_in_any_number_and_their_order_does_not() -> None:
    for count in (3, 50):
        names = [f"{k:016x}" for k in range(count)]
        one, turned = line_of_runs("s", "c", names, [0]), line_of_runs("s", "c", names[::-1], [0])
        assert one == turned != line_of_runs("s", "c", ["f" * 16, *names[1:]], [0])


@pytest.mark.parametrize("given", [(5,), (0, 1, 2), (1, 2, 9), (3, 5, 8), (100, 101, 7)])
def test_seeds_are_told_as_the_option_reads_them(given: tuple[int, ...]) -> None:
    text = format_seeds(given)
    read = seeds("").parser(text if len(given) > 1 else f"{text},")
    assert sorted(read) == sorted(given)
