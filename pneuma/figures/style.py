"""The look of all figures: sizes, fonts, colours that can be told apart in grey, and reproducible files."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import style as sheets
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import findfont, get_font
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from pneuma.errors import Hint, UserError, print_aside, printable, unknown_name
from pneuma.figures.origin import KEYS
from pneuma.files import read_regular

WIDTH = 7.0
"""Width in inches of a figure that spans a page."""
PANEL_INCHES = 2.3
"""Height of a panel with its axes."""
TYPE_POINTS = 8.0
"""Size of the text in points; titles are larger, ticks and captions smaller."""
CAPTION = 0.78
"""Size of small print, relative to the text."""
LINE_INCHES = 1.5 / 72
"""Height of a line of text in inches for each of its points."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X")
"""They distinguish lines in grey too."""
MOST_IN_A_PANEL = len(MARKERS)
"""Most conditions in one panel of curves; a summary shows those of larger studies in rows."""

INK, GREY = "#222222", "#777777"

FORMULA = re.compile(r"\$[^$]*[\\^_][^$]*\$")
LONGEST_FORMULA = 300
"""Most letters of a text that is tried as mathematics."""
LARGEST_SHEET = 2**20
"""Most bytes of a style sheet."""
SHEET, FONT = Path(__file__).with_name("pneuma.mplstyle"), "DejaVu Sans"

METADATA: dict[str, dict[str, Any]] = {
    "png": {},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}
"""What each format leaves out, so that a file's bytes depend on no date and on no version of matplotlib."""


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
def house_style(sheet: str | dict[str, Any] = "") -> Iterator[None]:
    """Draw in Pneuma's style, whatever the user's settings, with a style sheet of matplotlib over it.

    Raises:
        UserError: when there is no such style sheet.
    """
    with mpl.rc_context(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # the font lacks a letter, which is drawn as a box
        mpl.rcdefaults()
        mpl.use("agg")
        try:
            if isinstance(sheet, str) and os.path.lexists(os.path.expanduser(sheet)):
                sheet = os.path.expanduser(sheet)
                _check_sheet(sheet)
            sheets.use([SHEET, sheet or {}])
        except (OSError, UnicodeDecodeError):
            problem = ": is neither a matplotlib style sheet nor a file"
            raise UserError(Hint("style", sheet), problem) from None
        yield


def _check_sheet(sheet: str) -> None:
    try:
        read_regular(Path(sheet), LARGEST_SHEET)
    except OSError as error:
        raise UserError(Hint("style", sheet), f": {error.strerror}") from None


def text_points() -> float:
    """Return the size of the text in points, which a style sheet may set."""
    return float(mpl.rcParams["font.size"])


# --- Files -------------------------------------------------------------------------------------------

MOST_COLOURS = 256
X_LABEL = "x label"
"""The gid of the text that is the label of all horizontal axes together."""


def save_figure(
    figure: Figure,
    folder: Path,
    basename: str,
    formats: Sequence[str],
    origin: str,
    colours: int = MOST_COLOURS,
) -> list[Path]:
    """Write a figure in each format; the same figure gives the same bytes.

    Args:
        figure: it is laid out once for all formats.
        folder: it is made if it is missing.
        basename: of the files, without an ending.
        formats: some of `FIGURE_FORMATS`.
        origin: the text that the files contain as their description.
        colours: of a PNG's palette, without a visible difference; 0 keeps all colours.

    Returns:
        The files.
    """
    for file_format in formats:
        if file_format not in METADATA:
            raise unknown_name("format", file_format, METADATA)
    folder.mkdir(parents=True, exist_ok=True)
    for label in figure.findobj(Text):  # labels of ticks are cleaned where they are set
        label.set_text(clean(label.get_text()))
    _lay_out(figure)
    _draw_mathematics(figure)
    paths: list[Path] = []
    for file_format in formats:
        path = folder / f"{basename}.{file_format}"
        if file_format == "png":
            _save_png(figure, path, origin, colours)
        else:
            figure.savefig(
                path, format=file_format, metadata={**METADATA[file_format], KEYS[file_format]: origin}
            )
        paths.append(path)
    _note_missing_letters(figure)
    return paths


def _save_png(figure: Figure, path: Path, origin: str, colours: int) -> None:
    """Draw a figure once, and write it; `savefig` would draw it twice."""
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    image, png_texts = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"), PngInfo()
    png_texts.add_text(KEYS["png"], origin)
    if colours:
        image = image.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    image.save(path, "PNG", dpi=(figure.dpi, figure.dpi), pnginfo=png_texts)


def _note_missing_letters(figure: Figure) -> None:
    letters = {"\n"}.union(*(label.get_text() for label in figure.findobj(Text)))
    in_font = get_font(findfont(FONT)).get_charmap()
    missing = sorted(letter for letter in letters if letter != "\n" and ord(letter) not in in_font)
    if missing:
        glyphs = " ".join(missing[:10])
        print_aside(
            f"Figures' font lacks {glyphs}, drawn as boxes; rename conditions in the study's [labels]."
        )


def _draw_mathematics(figure: Figure) -> None:
    """Let texts with formulas, as the label $x_2$, be drawn as such where all their lines parse.

    A formula has a command, an index or a power: the condition $x$ and prices stay as they are.
    """
    parser = MathTextParser("path")
    for label in figure.findobj(Text):
        lines = label.get_text().split("\n")
        if len(label.get_text()) <= LONGEST_FORMULA and any(map(FORMULA.search, lines)):
            with suppress(Exception):  # what is no formula raises different errors
                for line in lines:
                    parser.parse(line)
                label.set_parse_math(True)


def clean(text: str) -> str:
    """Return text with control characters as codes, as names may be untrusted and an SVG is XML."""
    return "\n".join(map(printable, text.split("\n")))


def _lay_out(figure: Figure) -> None:
    """Lay out a figure once for all formats, and round the positions of its panels.

    The results of the layout solver differ in their last bits from call to call, and the names of clip paths
    in an SVG are hashes of these positions.
    """
    engine = figure.get_layout_engine()
    if engine is None:
        return
    engine.execute(figure)
    figure.set_layout_engine("none")
    for axes in figure.axes:
        left_edge, bottom, width, height = np.round(axes.get_position().bounds, 5).tolist()
        axes.set_position((left_edge, bottom, width, height))
    for label in figure.texts:
        if label.get_gid() == X_LABEL:
            boxes = [axes.get_position() for axes in figure.axes]
            label.set_x((min(box.x0 for box in boxes) + max(box.x1 for box in boxes)) / 2)
