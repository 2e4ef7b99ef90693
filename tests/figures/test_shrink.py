"""Small pictures: they look the same, and the same picture gives the same bytes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from pneuma.figures.shrink import DOTS_PER_INCH, shrink, shrunk_svg
from pneuma.figures.style import COLOURS


def _save(path: Path, dots: int) -> bytes:
    """Store a red square within a white one, of one inch."""
    pixels = np.full((dots, dots, 3), 255, np.uint8)
    pixels[: dots // 2, : dots // 2] = (255, 0, 0)
    Image.fromarray(pixels).save(path, dpi=(dots, dots))
    shrink(path)
    return path.read_bytes()


def test_a_png_has_a_palette_and_as_many_dots_as_a_page_shows(tmp_path: Path) -> None:
    path = tmp_path / "square.png"
    path.with_suffix(".svg").touch()
    assert _save(path, 2 * DOTS_PER_INCH) == _save(path, 2 * DOTS_PER_INCH)
    with Image.open(path) as image:
        assert (image.size, image.mode) == ((DOTS_PER_INCH,) * 2, "P")
        assert round(image.info["dpi"][0]) == DOTS_PER_INCH
        shown = image.convert("RGB")
    assert (shown.getpixel((10, 10)), shown.getpixel((140, 140))) == ((255, 0, 0), (255, 255, 255))


def test_colours_of_few_dots_are_not_taken_for_others(tmp_path: Path) -> None:
    """A page of letters in all greys, and small marks of eight conditions, each faint, fainter and whole."""
    pixels = np.full((160, 480, 3), 255, np.uint8)
    pixels[:100] = np.random.default_rng(0).integers(0, 256, (100, 480, 1))
    colours = 255 * np.array([[to_rgb(colour) for colour in COLOURS]])
    for row, alpha in enumerate((0.3, 0.5, 0.8, 1.0)):
        marks = (255 - alpha * (255 - colours)).round().astype(np.uint8)
        pixels[110 + 10 * row : 113 + 10 * row, 10 : 10 + 3 * marks.shape[1]] = marks.repeat(3, axis=1)
    path = tmp_path / "marks.png"
    Image.fromarray(pixels).save(path, dpi=(DOTS_PER_INCH, DOTS_PER_INCH))
    shrink(path)
    with Image.open(path) as image:
        shown = np.asarray(image.convert("RGB"))
    assert np.abs(shown.astype(int) - pixels).max() <= 25  # of 255: a tenth, less than two neighbouring looks


@pytest.mark.parametrize("dots", [100, 300])
def test_a_png_of_few_dots_or_without_an_svg_keeps_them(tmp_path: Path, dots: int) -> None:
    path = tmp_path / "square.png"
    if dots < DOTS_PER_INCH:
        path.with_suffix(".svg").touch()
    _save(path, dots)
    with Image.open(path) as image:
        assert (image.size, image.mode) == ((dots, dots), "P")


def test_paths_of_an_svg_lie_on_hundredths_and_nothing_else_changes() -> None:
    drawing = b'<g id="d1.23456"><path id="m" d="M 1.23456 -0.001 \nL 100.5 7.999 "/><use x="1.23456"/></g>'
    assert shrunk_svg(drawing) == drawing.replace(b"M 1.23456 -0.001", b"M 1.23 -0").replace(b"7.999", b"8")


def test_other_files_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "words.txt"
    path.write_bytes(b' d="1.23456"')
    shrink(path)
    assert path.read_bytes() == b' d="1.23456"'
