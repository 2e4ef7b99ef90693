"""The figure of a study's curves: the share of monsters killed and the return, or whatever is asked for.

Few conditions share a panel; more than `MOST_IN_A_PANEL` get a small panel each, with the others' means
behind it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pneuma.analysis import BAND_NAMES, EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.bands import BANDS
from pneuma.analysis.curves import Curve, curve_names, shared_levels, study_curves
from pneuma.analysis.frames import StudyData
from pneuma.analysis.outcomes import have_one_return
from pneuma.analysis.run_view import common_step, step_words
from pneuma.errors import UserError
from pneuma.figures.panels import (
    PLAYER_DASHES,
    QUANTITIES,
    draw_panel,
    draw_players,
    headline_of,
    highest_point,
    label_of,
    notes_of,
    put_texts,
    round_ticks,
    set_axes,
    shows_band,
    shows_runs,
    stem_of,
)
from pneuma.figures.style import (
    COLUMNS,
    GREY,
    INK,
    LINE_INCHES,
    MOST_IN_A_PANEL,
    PANEL_INCHES,
    TYPE_POINTS,
    WIDTH,
    characters,
    condition_looks,
    house_style,
    save_figure,
    short_names,
)

_, TRAILING_WINDOW = WINDOWS
AS_IN_THESIS: dict[str, Any] = {"quantities": ("return",), "band": "minmax", "window": TRAILING_WINDOW}
"""How the author's own script drew: the least and the greatest."""
USUAL_QUANTITIES = ("share_killed", "return")
MOST_CURVES = 40
"""Conditions of which curves still fit a page; of more there is shown what they came to."""
MOST_OTHERS = 24
"""Panels up to which all other means stand behind each; of more they would be a grey blur."""
LONGEST_INCHES = 7.6
"""Of small panels: with the texts around them a figure fits a page, unless they are too many."""
OF_BUDGET = "of the last 5 % of the budget"
OTHERS_COLOUR, BESIDE_COLOUR = "#C4C4C4", "#404040"


@dataclass(frozen=True)
class Drawing:
    """How a figure of curves is drawn, with nothing left open: what an index tells of it."""

    quantities: tuple[str, ...]
    band: str
    window: str


def draw_study(
    data: StudyData,
    folder: Path,
    band: str | None = None,
    window: str | None = None,
    formats: tuple[str, ...] = ("png", "svg"),
    *,
    quantities: Sequence[str] = (),
    shown: str = "",
    beside: StudyData | None = None,
) -> list[Path]:
    """Draw a study's curves from its finished runs; return the files written.

    Args:
        data: the study.
        folder: where to write.
        band: one of `BANDS`; Student's interval when left out.
        window: one of the study's windows; its first when left out.
        formats: of `FIGURE_FORMATS`.
        quantities: of `curve_names`; when left out, the share killed and the return, or of these what there
            is, and the first of them alone where each condition has a panel. Where returns are of unlike
            rewards, the length of episodes stands in their place.
        shown: what the headline says that is shown; when left out, the thesis's figure if it has one.
        beside: another study, or imported logs, whose runs are drawn as dashed lines, each its own.

    Raises:
        UserError: for a quantity or window that the study's data does not have, data without curves, or
            another study beside a panel for each condition.
    """
    many = len(data.conditions) > MOST_IN_A_PANEL
    if beside and many:
        raise UserError(f"{beside.study} cannot be drawn beside {data.study}: each condition has a panel")
    drawing = settle(data, band, window, quantities=quantities)
    curves = study_curves(data, drawing.quantities, drawing.window)
    with house_style():
        if many:
            figure, inches, entries, named = _draw_small_panels(data, curves, drawing)
        else:
            figure, inches, entries, named = _draw_panels(data, curves, drawing, beside)
        caption = [*notes_of(data), *_caption(data, curves, drawing), named]
        drawn = [curve for group in curves.values() for curve in group]
        put_texts(figure, inches, headline_of(data, shown), entries, caption, _meaning(drawn, drawing.band))
        stem = file_stem(data, drawing, beside.study if beside else None)
        return save_figure(figure, folder, stem, formats)


def settle(
    data: StudyData, band: str | None = None, window: str | None = None, quantities: Sequence[str] = ()
) -> Drawing:
    """Return how `draw_study` draws, given the same."""
    wanted = data.checked_window(window)
    names = tuple(dict.fromkeys(quantities)) or _usual(data)
    if not set(names) & set(EPISODE_QUANTITIES):
        wanted = data.windows[0]  # nothing that is drawn is read in a window of one's choice
    return Drawing(names, band or BAND_NAMES[0], wanted)


def _usual(data: StudyData) -> tuple[str, ...]:
    """Return what is drawn where nothing is asked for."""
    known = curve_names(data)
    wanted = USUAL_QUANTITIES if have_one_return(data) else ("share_killed", "length")
    names = tuple(name for name in wanted if name in known) or (*known[:1],) or ("return",)
    return names[:1] if len(data.conditions) > MOST_IN_A_PANEL else names


def file_stem(data: StudyData, drawing: Drawing, beside: str | None = None) -> str:
    """Return the name of a figure's files: that of the study's, and in what it differs from the usual."""
    usual, differs = settle(data), []
    if drawing.quantities != usual.quantities:
        every = list(drawing.quantities) == curve_names(data)
        differs.append("all" if every else "-".join(drawing.quantities))
    differs += [drawing.band] * (drawing.band != usual.band)
    differs += [drawing.window.removesuffix("%")] * (drawing.window != data.windows[0])
    return stem_of(data, *differs, *(["beside", beside] if beside else []))


# --- Panels ------------------------------------------------------------------------------------------

Curves = Mapping[str, Sequence[Curve]]
Drawn = tuple[Figure, float, dict[str, Any], str]
"""A figure, the height of its panels in inches, its legend's entries, and what names in it consist of."""


def _draw_panels(data: StudyData, curves: Curves, drawing: Drawing, beside: StudyData | None) -> Drawn:
    """Draw a panel of all conditions for each quantity, and each run of other curves beside them."""
    rows = -(-len(curves) // COLUMNS)
    columns = -(-len(curves) // rows)
    figure = Figure(layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    labels = {name: label_of(data, name) for name in data.conditions if data.of_condition(name)}
    looks = condition_looks(data.conditions)
    entries: dict[str, Any] = {}
    others: Curves = {}
    if beside:
        window = drawing.window if drawing.window in beside.windows else beside.windows[0]
        named = [name for name in drawing.quantities if name in beside.quantities]
        others = study_curves(beside, named, window)
    for axes, (name, group) in zip(panels, curves.items(), strict=False):
        quantity = QUANTITIES[name]
        draw_panel(axes, group, drawing.band, looks, labels, quantity)
        _draw_around(axes, data, name, group)
        for curve in others.get(name, ()):
            lines = axes.plot(
                curve.step, curve.runs.T, color=BESIDE_COLOUR, linewidth=0.7, linestyle=(0, (3, 1))
            )
            lines[0].set_label(beside.title if beside else "")
        label = quantity.label
        if data.averaged_over:  # in the log
            label = label.replace(" of an episode", f", mean of {data.averaged_over} episodes")
        axes.set(title=quantity.title, ylabel=label, xlabel="Environment steps")
        handles, names = axes.get_legend_handles_labels()
        entries |= dict(zip(names, handles, strict=True))
    for axes in panels[len(curves) :]:
        axes.remove()
    players_last = dict(sorted(entries.items(), key=lambda entry: entry[0].startswith((*PLAYER_DASHES,))))
    return figure, rows * PANEL_INCHES * (1.2 if columns == 1 else 1), players_last, ""


def _draw_around(axes: Axes, data: StudyData, name: str, curves: Sequence[Curve]) -> None:
    """Draw what any panel of a quantity has beside its curves."""
    draw_players(axes, shared_levels(data, name), highest_point(curves))
    if (step := common_step(data)) is not None:  # at which conditions of unlike budgets are compared
        axes.axvline(step, color=GREY, linewidth=0.9, zorder=1.2)
    set_axes(axes, QUANTITIES[name], data.budget, curves)


def _draw_small_panels(data: StudyData, curves: Curves, drawing: Drawing) -> Drawn:
    """Draw a panel for each condition and quantity, those of a quantity below each other."""
    conditions = [curve.condition for curve in next(iter(curves.values()))]
    columns = min(range(2 * COLUMNS, COLUMNS - 1, -1), key=lambda each: -len(conditions) % each)
    rows = -(-len(conditions) // columns)
    names, parts = short_names(conditions)
    width = characters(0.83 * TYPE_POINTS, 0.9 * WIDTH / columns)
    titles = [
        "\n".join(textwrap.wrap(label_of(data, name, names[name]).replace(" = ", "="), width))
        for name in conditions
    ]
    figure = Figure(layout="constrained")
    panels = figure.subplots(rows * len(curves), columns, squeeze=False, sharex=True)
    looks = {name: {**look, "marker": ""} for name, look in condition_looks(data.conditions).items()}
    for place, (name, group) in enumerate(curves.items()):
        quantity = QUANTITIES[name]  # the caption says what was averaged before
        block = panels[place * rows : (place + 1) * rows].ravel()
        for axes, curve, title in zip(block, group, titles, strict=False):
            _draw_others(axes, group, curve, data.record.get("baseline"))
            draw_panel(axes, [curve], drawing.band, looks, {}, quantity)
            _draw_around(axes, data, name, group)
            axes.set_title(title, fontsize="small", weight="normal", pad=2)
        _align([*block], len(conditions), columns, quantity.label)
    title_inches = 0.85 * LINE_INCHES * (1 + max(title.count("\n") for title in titles))
    panel_inches = max(0.3, min(0.75, LONGEST_INCHES / rows - title_inches))
    inches = rows * len(curves) * (panel_inches + title_inches) + 0.4
    entries: dict[str, Any] = {}
    if len(conditions) <= MOST_OTHERS:
        entries["the others"] = Line2D([], [], color=OTHERS_COLOUR)
    if data.record.get("baseline") in names:
        label = f"{names[data.record['baseline']]} (baseline)"
        entries[label] = Line2D([], [], color=INK, linestyle="--", linewidth=1)
    handles, labels = panels.flat[0].get_legend_handles_labels()
    entries |= dict(zip(labels, handles, strict=True))
    return figure, inches, entries, parts and f"Panels: {parts}."


def _draw_others(axes: Axes, curves: Sequence[Curve], own: Curve, baseline: str | None) -> None:
    """Draw the other conditions' means behind, and the baseline's in front of them."""
    thin = 0.4 * mpl.rcParams["lines.linewidth"]
    for curve in curves:
        if curve.condition == baseline != own.condition:
            axes.plot(curve.step, curve.mean, color=INK, linewidth=2 * thin, linestyle="--", zorder=1.3)
        elif curve is not own and len(curves) <= MOST_OTHERS:
            axes.plot(curve.step, curve.mean, color=OTHERS_COLOUR, linewidth=thin, zorder=1.1)


def _align(block: Sequence[Axes], count: int, columns: int, label: str) -> None:
    """Give panels of one quantity the same axes, with labels at the left and below alone."""
    used, holes = block[:count], block[count:]
    low, high = min(axes.get_ylim()[0] for axes in used), max(axes.get_ylim()[1] for axes in used)
    for place, axes in enumerate(used):
        axes.set_ylim(low, high)
        lowest = place + columns >= count
        axes.tick_params(labelleft=place % columns == 0, labelbottom=lowest, labelsize="small")
        axes.set_xlabel("Steps" if lowest else "", fontsize="small")
        axes.xaxis.set_major_locator(round_ticks(3))
        if axes.get_yscale() == "linear":
            axes.yaxis.set_major_locator(round_ticks(4))
        if place % columns == 0:
            axes.set_ylabel(label, fontsize="small")
    for axes in holes:
        axes.set_axis_off()


# --- Words -------------------------------------------------------------------------------------------


def _meaning(drawn: Sequence[Curve], band: str) -> str:
    """Return what lines and bands are, for the legend."""
    told = ["Mean over n runs"]
    if any(shows_band(curve, band) for curve in drawn):
        told.append(f"band: {BANDS[band].label}")
    if any(shows_runs(curve, band) for curve in drawn):
        told.append("thin lines: runs")
    return "; ".join(told)


def _caption(data: StudyData, curves: Curves, drawing: Drawing) -> list[str]:
    """Return what to mind in these curves: sentences, the gravest first."""
    drawn = [curve for group in curves.values() for curve in group]
    told = []
    if "return" in curves and not have_one_return(data):
        told.append("Returns of unlike rewards, or of more players, cannot be compared.")
    for name, group in curves.items():
        for curve in group:
            blank = int((~np.isfinite(curve.runs)).all(axis=1).sum())
            if blank:
                of = f"{blank} of {len(curve.runs)} runs of {curve.condition}"
                told.append(f"{of} have no {name.replace('_', ' ')}, and count in no mean of it.")
    if any(curve.stops for curve in drawn):
        told.append("×: a run diverged, and its curve ends there.")
    step = common_step(data)
    if step is not None:
        told.append(f"Upright line: {step:,} steps, {step_words(data)}: compare there.")
    if any(shows_band(curve, drawing.band) and shows_runs(curve, drawing.band) for curve in drawn):
        told.append("Intervals of few runs cover less often than they say, so the runs are drawn too.")
    if any(curve.count[-1] < len(curve.runs) for curve in drawn):
        told.append("Faint: not all runs have a value.")
    told.append(_averages(data, curves, drawing.window))
    if any(QUANTITIES[name].log for name in curves):
        told.append("On logarithmic axes means and bands are of logarithms.")
    return told


def _averages(data: StudyData, curves: Curves, window: str) -> str:
    """Say what each point of a training curve averages; '' where there is none."""
    told = []
    if {*curves} & {*EPISODE_QUANTITIES}:
        trailing = "the last 100 episodes" if window == TRAILING_WINDOW else f"the episodes {OF_BUDGET}"
        logged = f"the last {data.averaged_over} episodes, as Stable-Baselines3 logs them"
        told.append(logged if data.averaged_over else trailing)
    if {*curves} & {*UPDATE_QUANTITIES}:
        told.append(f"the updates {OF_BUDGET}")
    return f"Training curves average {', or '.join(told)}." if told else ""
