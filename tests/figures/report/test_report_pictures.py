"""The report's pictures: the smaller form of each, small images that still show what they showed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from pneuma.figures import report_pictures


def _png(pixels: np.ndarray) -> bytes:
    sink = io.BytesIO()
    Image.fromarray(pixels).save(sink, "PNG")
    return sink.getvalue()


def _draw(svg: bytes, png: bytes) -> report_pictures.Draw:
    def draw(folder: Path, forms: tuple[str, ...]) -> list[Path]:
        for name, data in {"svg": svg, "png": png}.items():
            (folder / f"figure.{name}").write_bytes(data)
        return [folder / f"figure.{name}" for name in forms]

    return draw


PLAIN = _png(np.full((20, 40, 3), 255, np.uint8))


def test_a_small_svg_stays_one() -> None:
    assert report_pictures._smaller(_draw(b"<svg/>", PLAIN)) == (b"<svg/>", "svg")


def test_a_large_svg_gives_way_to_a_smaller_png() -> None:
    data, form = report_pictures._smaller(_draw(b" " * 200_000, PLAIN))
    assert form == "png" and data.startswith(b"\x89PNG")


def test_a_large_svg_stays_where_the_png_is_larger() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (500, 500, 3), np.uint8)
    assert report_pictures._smaller(_draw(b" " * 120_001, _png(noise)))[1] == "svg"


def test_a_wide_image_is_made_as_wide_as_a_dense_screen_shows_it() -> None:
    with Image.open(
        io.BytesIO(report_pictures._small_image(_png(np.zeros((300, 3200, 3), np.uint8))))
    ) as image:
        assert image.size == (1600, 150)
    with Image.open(io.BytesIO(report_pictures._small_image(PLAIN))) as image:
        assert image.size == (40, 20)


def test_a_small_image_keeps_its_colours_however_few_dots_have_them() -> None:
    """A page of letters in all greys, and small marks of four conditions."""
    colours = np.array([[255, 255, 255], [0, 114, 178], [213, 94, 0], [0, 158, 115]], np.uint8)
    pixels = np.random.default_rng(0).integers(0, 256, (160, 480, 1), np.uint8).repeat(3, axis=2)
    pixels[100:103, :12] = colours.repeat(3, axis=0)
    with Image.open(io.BytesIO(report_pictures._small_image(_png(pixels)))) as image:
        np.testing.assert_allclose(np.asarray(image.convert("RGB"), int), pixels, atol=25)
