"""The look of all figures: sizes, fonts, colours that can be told apart in grey, and reproducible files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib import style as sheets
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.text import Text
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from scipy.optimize import isotonic_regression

from pneuma.errors import UserError, plain, print_aside, unknown_name
from pneuma.figures.origin import KEYS

WIDTH = 7.0
"""Width in inches of a figure that spans a page."""
COLUMNS, PANEL_INCHES = 3, 2.3
"""Most panels in a row, and their height with the axis."""
TYPE_POINTS = 8.0
"""Size of the text in points; titles are larger, ticks and captions smaller."""
CAPTION = 0.78
"""Size of small print, relative to the text."""
LINE_INCHES = 1.5 / 72
"""Height of a line of text in inches for each of its points."""

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8C3B7A", "#E69F00", "#56B4E9", "#7A5230", "#4D4D4D")
"""After Okabe and Ito, for colour-blind readers; distinct from the greys of references."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""So that lines can be told apart in grey."""

INK, GREY = "#222222", "#777777"

_RC: Any = {
    "font.family": "DejaVu Sans",  # comes with matplotlib, so that text has the same width everywhere
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.prop_cycle": cycler(color=COLOURS),
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "figure.dpi": 200,
    "savefig.dpi": "figure",
    "svg.hashsalt": "pneuma",
    "svg.fonttype": "path",
    "text.parse_math": False,  # a condition may be called $x$
    "pdf.fonttype": 42,
    "pdf.compression": 6,
}

_RELATIVE_TYPE: Any = {
    "font.size": 1.0,
    "axes.titlesize": 1.0,
    "axes.labelsize": 1.0,
    "legend.fontsize": 1.0,
    "legend.title_fontsize": 0.9,
    "xtick.labelsize": 0.9,
    "ytick.labelsize": 0.9,
    "lines.linewidth": 0.2,
    "lines.markersize": 0.5,
}
"""Relative to the text's size."""

_NO_DATES = {
    "png": {},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}


def characters(points: float = TYPE_POINTS, width: float = WIDTH) -> int:
    """Return how many characters of a size fit a width, for DejaVu's mean width of 0.54."""
    return int((width - 0.15) * 72 / (0.54 * points))


@dataclass(frozen=True)
class Look:
    """What a user asks of a figure, beside what is in it.

    Attributes:
        width: in inches.
        height: in inches, with headline, legend and caption; None for what its panels need.
        title: the headline, in place of the study's.
        sheet: a style sheet of matplotlib, by name or file, over Pneuma's style.
        plain: whether to leave headline and caption out, as a paper has its own.
    """

    width: float = WIDTH
    height: float | None = None
    title: str | None = None
    sheet: str = ""
    plain: bool = False


@contextmanager
def house_style(type_points: float = TYPE_POINTS, sheet: str = "") -> Iterator[None]:
    """Draw in Pneuma's style, whatever the user's settings; `type_points` is the text's size.

    Raises:
        UserError: when there is no such style sheet of matplotlib.
    """
    with mpl.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # the font lacks a letter, which is drawn as a box
        mpl.rcdefaults()
        mpl.use("agg")
        mpl.rcParams.update(_RC)
        mpl.rcParams.update({key: type_points * share for key, share in _RELATIVE_TYPE.items()})
        if sheet:
            try:
                sheets.use(sheet)
            except (OSError, UnicodeDecodeError):
                raise UserError(
                    f"--style {sheet}: is neither a style sheet of matplotlib nor a file"
                ) from None
            for key, share in _RELATIVE_TYPE.items():  # what the sheet leaves follows its size of text
                if mpl.rcParams[key] == type_points * share and key.endswith("size"):
                    mpl.rcParams[key] = text_points() * share
        yield


def text_points() -> float:
    """Return the size of the text in points, which a style sheet may set."""
    return float(mpl.rcParams["font.size"])


# --- Conditions --------------------------------------------------------------------------------------

MOST_IN_A_PANEL = len(MARKERS)
"""Most conditions in one panel of curves; of a study with more, a summary shows them in rows."""


# --- Files -------------------------------------------------------------------------------------------

MOST_COLOURS = 256
END = "end"
"""The gid of a label at the end of a line, which is moved so that none overlap."""


def save_figure(
    figure: Figure,
    folder: Path,
    basename: str,
    formats: Sequence[str],
    origin: str,
    colours: int = MOST_COLOURS,
) -> list[Path]:
    """Write a figure in each format, with its origin as metadata; the same figure gives the same bytes.

    A PNG has a palette of so many `colours`, without a visible difference; with 0 it has all its colours.
    """
    for name in formats:
        if name not in _NO_DATES:
            raise unknown_name("format", name, _NO_DATES)
    folder.mkdir(parents=True, exist_ok=True)
    for text in figure.findobj(Text):  # labels of ticks are cleaned where they are set
        text.set_text(clean(text.get_text()))
    paths = [folder / f"{basename}.{name}" for name in formats]
    _lay_out(figure)
    for path, name in zip(paths, formats, strict=True):
        if name == "png":
            _save_png(figure, path, origin, colours)
        else:
            figure.savefig(path, format=name, metadata={**_NO_DATES[name], KEYS[name]: origin})
    known = {"\n", *map(chr, get_font(findfont(_RC["font.family"])).get_charmap())}
    if lacking := {letter for text in figure.findobj(Text) for letter in text.get_text()} - known:
        shown = " ".join(sorted(lacking)[:10])
        print_aside(
            f"Figures' font lacks {shown}, drawn as boxes; [labels] in a study's file renames conditions."
        )
    return paths


def _save_png(figure: Figure, path: Path, origin: str, colours: int) -> None:
    """Draw a figure once, and write it; `savefig` would draw it twice."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    image, texts = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"), PngInfo()
    texts.add_text(KEYS["png"], origin)
    if colours:
        image = image.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    image.save(path, "PNG", dpi=(figure.dpi, figure.dpi), pnginfo=texts)


def clean(text: str) -> str:
    """Return text with control characters as codes, as names may be untrusted and an SVG is XML."""
    return "\n".join(map(plain, text.split("\n")))


def _lay_out(figure: Figure) -> None:
    """Lay out a figure once for all formats, and round the positions of its panels.

    The results of the layout solver differ in their last bits from call to call, and the names of clip paths
    in an SVG are hashes of these positions.
    """
    if (engine := figure.get_layout_engine()) is None:
        return
    engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.set_position([round(float(value), 5) for value in axes.get_position().bounds])  # type: ignore[arg-type]
        _spread_ends(axes, figure.dpi / 72)


def _spread_ends(axes: Axes, dots_per_point: float) -> None:
    """Move labels at the ends of lines up or down, as little as keeps them apart and within the panel."""
    ends: Any = [text for text in axes.texts if text.get_gid() == END]
    if not ends:
        return
    wanted = np.array([axes.transData.transform((0, text.xy[1]))[1] for text in ends]) / dots_per_point
    order = np.argsort(wanted, kind="stable")
    lines = np.array([text.get_text().count("\n") + 1 for text in ends])
    heights = (1.15 * np.array([text.get_fontsize() for text in ends]) * lines)[order]
    middles = np.cumsum(heights) - heights / 2  # of labels upon each other
    bottom, top = (edge / dots_per_point for edge in (axes.bbox.y0, axes.bbox.y1))
    places = isotonic_regression(wanted[order] - middles).x
    places = np.clip(places, bottom, max(bottom, top - heights.sum())) + middles
    for number, place in zip(order, places, strict=True):
        ends[number].xyann = (ends[number].xyann[0], place - wanted[number])
