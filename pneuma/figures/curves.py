"""Figures of curves: a panel for each quantity, and a column for each world or environment.

    CurvesAnswer → a `Panel` for each quantity and column → Page

A line is the mean of runs, in a band that the legend describes. Each condition has its label, with the
number of its runs, in the legend.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pneuma.analysis.curves import (
    BANDS,
    DEFAULT_BAND,
    EPISODES,
    EVALUATED,
    INTERVAL,
    STEPS,
    WALL_CLOCK,
    Column,
    Curve,
    CurveOptions,
    CurvesAnswer,
    reach,
)
from pneuma.analysis.notes import TRAILING_WINDOW, averaging
from pneuma.analysis.outcomes import is_foreign
from pneuma.errors import Hint, UserError
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.style import MARKERS, MOST_IN_A_PANEL, PANEL_INCHES
from pneuma.figures.words import after_thesis, fits_panel, headline_of, looks_of
from pneuma.store.quantities import POWERS, QUANTITIES, SHARES, VALUES

RUNS, NO_BAND = "runs", "none"
PALE, DARK = 0.13, 0.30
"""Opacity of a band, and of the interval of the mean."""
MARKED_POINTS = 8
"""Markers per line; they distinguish lines in grey."""
MANY_RUNS = 30
"""With this many runs in a panel, their lines are fainter, so that means stay in front."""
MOST_IN_A_NAME = 3
"""With more quantities, the name of a figure's files has their number."""
BESIDE_LOOK = {"color": "#404040"}
RETURN_BOUNDS = {"CartPole-v1": (0.0, 500.0), "Acrobot-v1": (-500.0, 0.0), "MountainCar-v0": (-200.0, 0.0)}
X_LABELS = {STEPS: "Environment steps", EPISODES: "Episodes", WALL_CLOCK: "Seconds of training"}
Looks = Mapping[str, Mapping[str, Any]]


def curves_page(answer: CurvesAnswer, basename: str = "") -> Page:
    """Return the figure of a study's curves, with quantities in rows if there are several columns.

    Args:
        answer: the curves.
        basename: of the files; default: the study's figure, and how this one differs from the default.

    Raises:
        UserError: for more conditions than a panel can show.
    """
    columns = answer.columns
    studies = [column.data for column in columns.values()]
    first_data, looks = studies[0], looks_of(studies)
    labels = [look["label"] for look in looks.values() if look["label"]]
    if not all(map(fits_panel, studies)):
        problem = f"study {first_data.study.name}: has too many conditions for one panel: pick"
        remedies = [Hint("conditions"), ", or ", Hint("figure", "summary")]
        raise UserError(f"{problem} {MOST_IN_A_PANEL} at most by ", *remedies)
    panel_rows: list[list[Panel | None]] = []
    for quantity_name in answer.quantities:
        panel_row: list[Panel | None] = []
        for title, column in columns.items():
            panel = _panel(answer, column, quantity_name, looks) if quantity_name in column.curves else None
            if panel and len(columns) > 1:
                panel = replace(panel, title=title, y=QUANTITIES[quantity_name].title_with_unit)
            panel_row.append(panel)
        panel_rows.append(panel_row)
    entries: dict[str, Any] = {}
    for column in columns.values():
        entries |= _legend(column, answer.options)
    beside = dict.fromkeys(column.beside for column in columns.values() if column.beside)
    notes = list(answer.notes)
    basename = basename or first_data.basename(*_differences(answer))
    headline, inches, across = headline_of(first_data), PANEL_INCHES, 3
    if len(columns) > 1:
        headline, across = ": ".join(filter(None, [first_data.study.title, after_thesis(basename)])), 4
        if any("," in label.rpartition("(")[2] for label in labels):
            notes.append("In brackets: runs in each column.")
    else:
        panel_rows = [[panel for panel_row in panel_rows for panel in panel_row]]
        if len(answer.quantities) == 1:
            inches *= 1.2
    runs = lines_of_runs(*studies, *beside)
    return Page(basename, panel_rows, inches, headline, runs, entries, notes, across, answer)


def plot_curves(answer: CurvesAnswer, axes: Axes | None = None) -> Axes:
    """Draw a study's curves of one quantity into axes, by default the current ones: `pneuma.api.plot`."""
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.gca()
    (column,) = answer.columns.values()
    panel = _panel(answer, column, answer.quantities[0], looks_of([column.data]))
    grid.fill(axes, panel, axes.get_window_extent().width / axes.figure.dpi)
    axes.legend()
    return axes


def _differences(answer: CurvesAnswer) -> list[str]:
    """Return how a figure differs from the study's default one, for the name of its files."""
    options, quantities = answer.options, answer.quantities
    suffixes: list[str] = []
    if not answer.is_default:
        suffixes += quantities if len(quantities) < MOST_IN_A_NAME else [f"{len(quantities)}-quantities"]
    if options.bands[0] != DEFAULT_BAND:
        suffixes.append(options.bands[0])
    if options.log:
        suffixes.append("log")
    if options.x != STEPS:
        suffixes.append(f"over-{options.x}")
    if options.window == TRAILING_WINDOW:
        suffixes.append(options.window)
    names_beside = {column.beside.study.name for column in answer.columns.values() if column.beside}
    if names_beside:
        suffixes += ["beside", *names_beside]
    return suffixes


# --- Panels -----------------------------------------------------------------------------------------


def _panel(answer: CurvesAnswer, column: Column, quantity_name: str, looks: Looks) -> Panel:
    quantity, study_data = QUANTITIES[quantity_name], column.data
    title, axis_label, axis_kind = quantity.title, quantity.label, quantity.kind
    if study_data.averaged_over:  # in the log
        axis_label = axis_label.replace(" of an episode", f", {averaging(study_data, answer.options.window)}")
    if quantity_name.startswith("action_") and is_foreign(study_data):
        title = f"Share of action {quantity_name.removeprefix('action_')}"
    if column.curves[quantity_name][0].log:
        axis_kind = POWERS
    elif axis_kind == POWERS:
        axis_kind = VALUES
    draw = partial(_draw, answer, column, quantity_name, looks)
    return Panel(draw, title, X_LABELS[answer.options.x], axis_label, y_kind=axis_kind)


def _draw(answer: CurvesAnswer, column: Column, quantity_name: str, looks: Looks, axes: Axes) -> None:
    """Draw bands, single runs and means of a quantity, the other study's runs, and the random player."""
    options, study_data, curves = answer.options, column.data, column.curves[quantity_name]
    beside_curves = column.beside_curves.get(quantity_name, [])
    axis_kind, bounds = QUANTITIES[quantity_name].kind, QUANTITIES[quantity_name].bounds
    if quantity_name in ("return", EVALUATED):
        bounds = RETURN_BOUNDS.get(" ".join(study_data.environments), bounds)
    run_count = sum(curve.run_count for curve in (*curves, *beside_curves))
    draw_spread = partial(_draw_spread, axes, options=options, bounds=bounds, run_count=run_count)
    for curve in curves:
        draw_spread(curve, looks[curve.condition]["color"])
        _draw_mean(axes, curve, looks[curve.condition])
    if column.beside:
        # Logs do not contain their environment, and may be of another panel's.
        is_foreign_there = len(answer.columns) > 1 and column.beside.averaged_over is not None
        limits = axes.get_ylim()
        for curve in beside_curves:
            draw_spread(curve, looks.get(curve.condition, BESIDE_LOOK)["color"])
        _draw_beside(axes, beside_curves, column, looks)
        if is_foreign_there:
            axes.set_ylim(limits)
            beside_curves = []
    low, high = reach([*curves, *beside_curves])
    if axis_kind == SHARES:
        low = 0.0
    reference = column.reference[column.reference["quantity"] == quantity_name]
    levels = reference["value"][reference["x"].isna()]
    grid.draw_random_player(axes.axhline, set(levels), (low, high), axis_kind)
    last_step = max(float(curve.runs.index.max()) for curve in (*curves, *beside_curves))
    if options.x == STEPS:
        last_step = max(last_step, study_data.budget)
    returns = reference.dropna(subset="x")
    if len(returns):
        axes.plot(returns["x"], returns["value"], label=grid.RANDOM_PLAYER, **grid.RANDOM_LOOK)
    axes.set_xlim(0, last_step)
    if axis_kind == SHARES and not options.log:
        upper_limit = min(max(axes.get_ylim()[1], 0.01), 1 + grid.BELOW_ZERO)
        axes.set_ylim(-grid.BELOW_ZERO * upper_limit, upper_limit)


def _draw_spread(
    axes: Axes, curve: Curve, colour: str, options: CurveOptions, bounds: tuple[float, float], run_count: int
) -> None:
    """Draw the bands of a curve, and its single runs where they are shown, fainter among many in a panel."""
    for band in options.drawn_bands(curve.run_count):
        frame, opacity = curve.frame(band), PALE
        if band == INTERVAL:  # where some runs have no value, the remaining ones are no fair sample
            edges = frame[["low", "high"]].where(frame["runs"] == curve.run_count)
            frame, opacity = edges.assign(x=frame["x"]), DARK
        grid.draw_band(axes, frame, bounds, color=colour, alpha=opacity)
    if _shows_runs(curve, options.bands[0]):
        line_width, opacity = 0.3 * mpl.rcParams["lines.linewidth"], 0.4 * min(1.0, MANY_RUNS / run_count)
        axes.plot(
            curve.runs, color=colour, linewidth=line_width, alpha=opacity, zorder=1.4,
            marker=_single_marker(curve), markersize=3 * line_width,
        )  # fmt: skip


def _draw_mean(axes: Axes, curve: Curve, look: Mapping[str, Any]) -> None:
    """Draw the mean of runs, faint where some have no value, and a cross where a run diverged."""
    frame, line_width = curve.frame(), mpl.rcParams["lines.linewidth"]
    spacing = max(len(frame) // MARKED_POINTS, 1)
    first_marker = MARKERS.index(look["marker"]) * spacing // len(MARKERS) % spacing  # no two meet
    (line,) = axes.plot(
        frame["x"], frame["mean"].where(frame["runs"] == curve.run_count), markersize=2.2 * line_width,
        clip_on=False, markevery=(first_marker, spacing), zorder=2.2, **look,
    )  # fmt: skip
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(frame["x"], frame["mean"], color=look["color"], alpha=0.35, zorder=1.5)
    for step, value in curve.stops:
        axes.plot(step, value, "x", color=look["color"], markersize=4 * line_width)


def _draw_beside(axes: Axes, curves: Sequence[Curve], column: Column, looks: Looks) -> None:
    """Draw the means of another study: in the colours of conditions with their names, or else in grey."""
    assert column.beside
    beside_data = column.beside
    title = beside_data.full_title
    if beside_data.study.name == column.data.study.name and beside_data.plan:
        title = f"preset {beside_data.plan.preset}"  # the difference between runs of one study
    grey_count = sum(curve.run_count for curve in curves if curve.condition not in looks)
    for curve in curves:
        label = f"{title} ({grey_count})"
        if curve.condition in looks:
            label_text = beside_data.study.labels.get(curve.condition, curve.condition)
            label = f"{label_text}, {title} ({curve.run_count})"
        frame = curve.frame()
        axes.plot(
            frame["x"], frame["mean"], label=label, color=looks.get(curve.condition, BESIDE_LOOK)["color"],
            linewidth=0.8 * mpl.rcParams["lines.linewidth"], linestyle=(0, (3, 1)), zorder=2.1,
            marker=_single_marker(curve), markersize=4,
        )  # fmt: skip


def _single_marker(curve: Curve) -> str:
    """Return a marker for runs with one point, which a line cannot show."""
    return "o" if len(curve.runs.dropna(how="all")) == 1 else ""


def _shows_runs(curve: Curve, band: str) -> bool:
    """Return whether every run is drawn: with the band `runs`, and where runs are too few for a band."""
    run_count = curve.run_count
    if band in (NO_BAND, RUNS):
        return band == RUNS
    return 1 < run_count < BANDS[band].enough_runs


def _legend(column: Column, options: CurveOptions) -> dict[str, Any]:
    """Return the artists of the legend that describe means, bands and runs, by their words."""
    curves = column.all_curves
    largest_group = max(curve.run_count for curve in curves)
    entries: dict[str, Any] = {"mean of (n) runs": Line2D([], [], color=style.INK, linewidth=1.6)}
    bands = options.drawn_bands(largest_group)
    for band in bands:
        if BANDS[band].label and largest_group >= BANDS[band].least_runs:
            opacity = PALE
            if band == INTERVAL:
                opacity = DARK + PALE * (len(bands) - 1)  # one lies in the other
            entries[BANDS[band].label] = Patch(color=style.INK, alpha=opacity, linewidth=0)
    if any(_shows_runs(curve, bands[0]) for curve in curves):
        entries[BANDS[RUNS].label] = Line2D([], [], color=style.INK, linewidth=0.5, alpha=0.5)
    return entries
