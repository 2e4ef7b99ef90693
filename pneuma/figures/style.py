"""One look for all figures: fonts, colours that also read in grey, and files of fixed bytes."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8C3B7A", "#E69F00", "#56B4E9", "#7A5230")
"""After Okabe and Ito: told apart by colour-blind readers, and from the greys that all are held against."""

DASHES: tuple[tuple[float, tuple[float, ...]] | str, ...] = (
    "-",
    (0, (5, 1.6)),
    (0, (1.2, 1.4)),
    (0, (6, 1.5, 1.2, 1.5)),
    (0, (3, 1, 1, 1, 1, 1)),
    (0, (8, 3)),
    (0, (1, 3)),
)
"""One to a colour, so that lines can be told apart in grey."""

MARKERS = ("o", "s", "^", "D", "v", "P", "X")

TYPE_POINTS = 8.0
CAPTION_POINTS = 6.2
"""Of `put_caption`."""
HOUSE_FONT = "DejaVu Sans"
"""It comes with matplotlib, so that words are as wide everywhere."""

_RC: Any = {
    "font.family": HOUSE_FONT,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "figure.dpi": 300,
    "savefig.dpi": "figure",
    "svg.hashsalt": "pneuma",
    "svg.fonttype": "path",
    "text.parse_math": False,  # a condition may be called $x$
    "pdf.fonttype": 42,
    "pdf.compression": 6,
}

_RELATIVE_TYPE: Any = {
    "font.size": 1.0,
    "axes.titlesize": 1.125,
    "axes.labelsize": 1.0,
    "legend.fontsize": 1.0,
    "legend.title_fontsize": 0.9,
    "xtick.labelsize": 0.9375,
    "ytick.labelsize": 0.9375,
    "lines.linewidth": 0.2,
}
"""In units of the text's size; so that lines grow with it."""

_NO_DATES = {
    "png": {"Software": None},
    "svg": {"Date": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
}


def condition_look(place: int) -> dict[str, Any]:
    """Return colour, dashes and marker of a study's condition by its place.

    Past the last colour they start again with other dashes and markers.
    """
    round_, colour = divmod(place, len(COLOURS))
    return {
        "color": COLOURS[colour],
        "linestyle": DASHES[(colour + round_) % len(DASHES)],
        "marker": MARKERS[(colour + 2 * round_) % len(MARKERS)],
    }


@contextmanager
def house_style(type_points: float = TYPE_POINTS) -> Iterator[None]:
    """Draw in Pneuma's look, whatever the user's own settings are, with text of a size in points."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.use("agg")
        mpl.rcParams.update(_RC)
        mpl.rcParams.update({key: type_points * share for key, share in _RELATIVE_TYPE.items()})
        yield


def put_caption(figure: Figure, caption: str) -> None:
    """Put small print below the panels of a figure with constrained layout, in as many lines as it takes."""
    width, height = figure.get_size_inches()
    lines = textwrap.wrap(caption, int(width * 72 / (0.56 * CAPTION_POINTS)))
    bottom = (0.18 + 0.12 * len(lines)) / height
    figure.get_layout_engine().set(rect=(0, bottom, 1, 1 - bottom))  # type: ignore[union-attr, call-arg]
    place = 0.01, 0.09 / height
    figure.text(*place, "\n".join(lines), fontsize=CAPTION_POINTS, color="#444444", va="bottom")


def save_figure(
    figure: Figure, folder: Path, stem: str, formats: tuple[str, ...], dots_per_inch: float | None = None
) -> list[Path]:
    """Write a figure in every format; the same figure gives the same bytes."""
    folder.mkdir(parents=True, exist_ok=True)
    _fix_places(figure)
    paths = []
    for name in formats:
        path = folder / f"{stem}.{name}"
        figure.savefig(path, format=name, metadata=_NO_DATES[name], dpi=dots_per_inch or "figure")
        paths.append(path)
    return paths


def _fix_places(figure: Figure) -> None:
    """Lay a figure out once, for all formats, and round where its panels came to lie.

    What the layout's solver gives differs in its last bits from call to call, and names of clip paths in
    an SVG are hashes of these places.
    """
    if figure.get_layout_engine() is None:
        return
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.set_position([round(float(value), 5) for value in axes.get_position().bounds])  # type: ignore[arg-type]
