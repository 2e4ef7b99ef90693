"""The figure of a study's curves: the share of monsters killed and the return, or whatever is asked for.

Few conditions share a panel; more than `MOST_IN_A_PANEL` get a panel each, with the others' means behind it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.analysis import EPISODE_QUANTITIES
from pneuma.analysis.curves import Curve, curve_names, study_curves
from pneuma.analysis.references import PLAYERS, have_one_return, shared_levels
from pneuma.analysis.run_view import common_step
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.figures.captions import caption_of, headline_of, legend_title_of
from pneuma.figures.looks import MOST_IN_A_PANEL, condition_looks
from pneuma.figures.multiples import draw_multiples
from pneuma.figures.panel import (
    alpha_of_runs,
    as_drawn,
    draw_common_step,
    draw_curve,
    draw_references,
    highest_point,
    label_of,
    set_axes,
)
from pneuma.figures.quantities import look_of
from pneuma.figures.sizes import SIZES, Size
from pneuma.figures.style import house_style, save_figure
from pneuma.figures.words import Words

USUAL_BAND = {"pneuma": "ci", "thesis": "minmax"}
"""Of each layout; the author's own script drew the least and the greatest."""
USUAL_QUANTITIES = ("share_killed", "return")
IN_PLACE_OF_RETURN = "length"
"""Where conditions have unlike rewards."""
MOST_CURVES = 40
"""Conditions of which curves still fit a page; of more there is shown what they came to."""
ALONE = 1.3
"""How much higher a panel is that stands alone."""
THESIS_WINDOW = "trailing-100"
BESIDE = "0.25"
DASHES = (0, (3, 1))
"""The looks of another study's runs."""
LONGEST_STEM = 100


@dataclass(frozen=True)
class Drawing:
    """How a figure of curves is drawn, with nothing left open: what an index tells of it."""

    quantities: tuple[str, ...]
    band: str
    window: str
    layout: str
    size: str


def draw_study(
    data: StudyData,
    folder: Path,
    band: str | None = None,
    window: str | None = None,
    formats: tuple[str, ...] = ("png", "svg"),
    *,
    quantities: Sequence[str] = (),
    layout: str = "pneuma",
    size: str = "page",
    shown: str = "",
    beside: StudyData | None = None,
) -> list[Path]:
    """Draw a study's curves from its finished runs; return the files written.

    Args:
        data: the study.
        folder: where to write.
        band: one of `BANDS`; the layout's usual one when left out.
        window: one of the study's windows; the layout's usual one when left out.
        formats: of `FIGURE_FORMATS`.
        quantities: of `curve_names`; when left out, the share killed and the return, or of these what there
            is, and the first of them alone where each condition has a panel. Where returns are of unlike
            rewards, the length of episodes stands in their place.
        layout: 'pneuma', or 'thesis' for one panel of the return as in the thesis's figures.
        size: one of `SIZES`.
        beside: another study, or imported logs, whose runs are drawn as dashed lines, each its own.
        shown: what the headline says that is shown; when left out, the thesis's figure if it has one.

    Raises:
        UserError: for a quantity or window that the study's data does not have, data without curves, or
            more panels than a slide has room for, or another study beside a panel for each condition.
    """
    if beside and len(data.conditions) > MOST_IN_A_PANEL:
        raise UserError(f"{beside.study} cannot be drawn beside {data.study}: each condition has a panel")
    drawing = settle(data, band, window, quantities=quantities, layout=layout, size=size)
    curves = study_curves(data, drawing.quantities, drawing.window)
    caption = caption_of(data, curves, drawing.band, drawing.window)
    words = Words(headline_of(data, shown), legend_title_of(drawing.band), caption)
    how = SIZES[size]
    with house_style(how.type_points):
        if len(data.conditions) > MOST_IN_A_PANEL:
            figure = draw_multiples(data, curves, drawing.band, how, words)
        else:
            others = _curves_beside(beside, drawing) if beside else {}
            figure = draw_panels(data, curves, drawing.band, how, words, others)
        stem = file_stem(data, drawing, beside.study if beside else None)
        return save_figure(figure, folder, stem, formats, how.dots_per_inch)


def settle(
    data: StudyData,
    band: str | None = None,
    window: str | None = None,
    *,
    quantities: Sequence[str] = (),
    layout: str = "pneuma",
    size: str = "page",
) -> Drawing:
    """Return how `draw_study` draws, given the same.

    Raises:
        UserError: as it does.
    """
    wanted = data.checked_window(window or _usual_window(layout))
    names = tuple(dict.fromkeys(quantities)) or _usual(data, layout)
    if not _has_episodes(names):
        wanted = data.windows[0]  # nothing that is drawn is read in a window of one's choice
    return Drawing(names, band or USUAL_BAND[layout], wanted, layout, size)


def _usual_window(layout: str) -> str | None:
    """Return the usual window of a layout; None: the study's first."""
    return THESIS_WINDOW if layout == "thesis" else None


def file_stem(data: StudyData, drawing: Drawing, beside: str | None = None) -> str:
    """Return the name of a figure's files: that of the study's, and in what it differs from the usual."""
    differs = [name for name in (drawing.layout, drawing.size) if name not in ("pneuma", "page")]
    if drawing.band != USUAL_BAND[drawing.layout]:
        differs.append(drawing.band)
    if _has_episodes(drawing.quantities) and drawing.window != (
        _usual_window(drawing.layout) or data.windows[0]
    ):
        differs.append(drawing.window.removesuffix("%"))
    if drawing.quantities != _usual(data, drawing.layout):
        every = list(drawing.quantities) == curve_names(data)
        differs = ["all" if every else _shortened(drawing.quantities), *differs]
    return "-".join([data.figure, *differs, *(["beside", beside] if beside else [])])


def _has_episodes(quantities: Sequence[str]) -> bool:
    return any(name in EPISODE_QUANTITIES for name in quantities)


def _shortened(names: Sequence[str]) -> str:
    """Return names in a row; where these are many, the first and a count of the others."""
    whole = "-".join(names)
    return whole if len(whole) <= LONGEST_STEM else f"{names[0]}-and-{len(names) - 1}-more"


def draw_panels(
    data: StudyData,
    curves: dict[str, list[Curve]],
    band: str,
    size: Size,
    words: Words,
    beside: Mapping[str, list[Curve]] | None = None,
) -> Figure:
    """Draw a panel of all conditions for each quantity, and each run of other curves beside them."""
    figure = Figure(figsize=(size.width, size.height or size.width), layout="constrained")
    rows, columns = size.grid(len(curves))
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    room = size.characters(1.3 * size.type_points) // columns  # titles are larger, and bold
    entries: dict[str, Artist] = {}
    for place, (axes, (name, group)) in enumerate(zip(panels, curves.items(), strict=False)):
        draw_panel(axes, data, name, group, band)
        for curve in (beside or {}).get(name, ()):
            lines = axes.plot(curve.step, curve.runs.T, color=BESIDE, linewidth=0.7, linestyle=DASHES)
            lines[0].set_label(curve.condition)
        axes.set_title("\n".join(textwrap.wrap(axes.get_title(loc="left"), room)))
        lowest = place + columns >= len(curves)
        axes.set_xlabel("Environment steps" if lowest else "")
        handles, labels = axes.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    for axes in panels[len(curves) :]:
        axes.remove()
    players_last = dict(sorted(entries.items(), key=lambda entry: entry[0] in PLAYERS))
    wanted = rows * size.panel_height * (ALONE if rows == columns == 1 else 1)
    low, high = words.put(figure, size, wanted, players_last)
    size.check_room(rows, high - low)
    return figure


def draw_panel(axes: Axes, data: StudyData, name: str, curves: Sequence[Curve], band: str) -> None:
    """Draw one quantity of all conditions, with its reference lines and title."""
    look, looks = look_of(name, data.averaged_over), condition_looks(data.conditions)
    curves, shade = as_drawn(look, curves), 0.16 if len(curves) < 5 else 0.09
    alpha = alpha_of_runs(curves, band)
    for curve in curves:
        draw_curve(axes, curve, band, looks[curve.condition], label_of(data, curve), shade, alpha)
    draw_references(axes, shared_levels(data, name), highest_point(curves))
    draw_common_step(axes, common_step(data))
    axes.set(title=look.title, ylabel=look.label)
    set_axes(axes, look, data.budget, curves)


def _curves_beside(beside: StudyData, drawing: Drawing) -> dict[str, list[Curve]]:
    """Return the curves of another study, all under its title, for each quantity that it has."""
    window = drawing.window if drawing.window in beside.windows else beside.windows[0]
    names = [name for name in drawing.quantities if name in beside.quantities]
    return {
        name: [Curve(beside.title, curve.step, curve.runs) for curve in group]
        for name, group in study_curves(beside, names, window).items()
    }


def _usual(data: StudyData, layout: str) -> tuple[str, ...]:
    """Return what is drawn where nothing is asked for."""
    wanted: tuple[str, ...] = USUAL_QUANTITIES if layout == "pneuma" else ("return",)
    if layout == "pneuma" and not have_one_return(data):
        wanted = tuple(IN_PLACE_OF_RETURN if name == "return" else name for name in wanted)
    known = curve_names(data)
    other = known[:1] if layout == "pneuma" else ()
    names = tuple(name for name in wanted if name in known) or tuple(other) or ("return",)
    return names[:1] if len(data.conditions) > MOST_IN_A_PANEL else names
