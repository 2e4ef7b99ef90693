"""Make pictures small without a difference that is seen: they are committed, and sent as parts of a page."""

from __future__ import annotations

import math
import re
from pathlib import Path

from PIL import Image

DOTS_PER_INCH = 150
"""Of a PNG beside which there is an SVG, to be printed: as a page shows it."""
COLOURS = 256

_PATH = re.compile(rb'(?<= d=")[^"]+')
_LONG_NUMBER = re.compile(rb"-?\d+\.\d{3,}")


def shrink(path: Path) -> None:
    """Write a picture anew, smaller; what is neither a PNG nor an SVG stays as it is."""
    if path.suffix == ".png":
        _shrink_png(path, DOTS_PER_INCH if path.with_suffix(".svg").exists() else math.inf)
    elif path.suffix == ".svg":
        path.write_bytes(shrunk_svg(path.read_bytes()))


def _shrink_png(path: Path, most_dots: float) -> None:
    """Give it a palette, and no more dots an inch than are asked for."""
    with Image.open(path) as image:
        dots = image.info["dpi"][0]
        share = min(1.0, most_dots / dots)
        size = (round(image.width * share), round(image.height * share))
        small = image.convert("RGB")
        if share < 1:
            small = small.resize(size, Image.Resampling.LANCZOS)
    _with_palette(small).save(path, "PNG", optimize=True, dpi=(dots * share, dots * share))


def _with_palette(image: Image.Image) -> Image.Image:
    """Return an RGB picture with a palette in place of full colours, which takes a third of the space.

    The palette covers all colours that there are, however few dots have them. One made by their number
    (Pillow's default, the median cut) spends itself on the greys of letters, and gives the marks of one
    condition the colour of another's.
    """
    return image.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)


def shrunk_svg(drawing: bytes) -> bytes:
    """Return an SVG whose paths lie on hundredths of a point: a tenth of what a printer can place."""
    return _PATH.sub(lambda path: _LONG_NUMBER.sub(_rounded, path[0]), drawing)


def _rounded(number: re.Match[bytes]) -> bytes:
    return f"{float(number[0]):.2f}".rstrip("0").rstrip(".").encode()
