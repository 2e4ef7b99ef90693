"""Figures of curves: a panel for each quantity, and a column for each world or environment.

    the answer of `find_curves` → a `Panel` for each quantity and column → Page

A line is the mean of runs, in a band that the legend describes. Each condition has its label, with the
number of its runs, in the legend.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import matplotlib as mpl
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import BANDS, EPISODES, INTERVAL, STEPS, WALL_CLOCK, drawn_bands
from pneuma.errors import Hint, UserError
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.style import MARKERS, MOST_IN_A_PANEL, PANEL_INCHES
from pneuma.figures.words import after_thesis, headline_of, looks_of
from pneuma.store.quantities import QUANTITIES, SHARES

PALE, DARK = 0.13, 0.30
"""Opacity of a band, and of the interval of the mean."""
MARKED_POINTS = 8
"""Markers per line; they distinguish lines in grey."""
MANY_RUNS = 30
"""With this many runs in a panel, their lines are fainter, so that means stay in front."""
BESIDE_LOOK = {"color": "#404040"}
X_LABELS = {STEPS: "Environment steps", EPISODES: "Episodes", WALL_CLOCK: "Seconds of training"}


@dataclass(frozen=True)
class Curve:
    """The rows of the answer's tables that one curve is drawn of.

    Attributes:
        points: of the table `curves` or `beside`, with each band.
        lines: of `lines`: single runs, (points, runs).
    """

    condition: str
    run_count: int
    points: pd.DataFrame
    lines: pd.DataFrame

    def frame(self, band: str) -> pd.DataFrame:
        return self.points[self.points["band"] == band]

    @property
    def means(self) -> pd.DataFrame:
        """The points with their means, once and not for each band."""
        return self.frame(self.points["band"].iloc[0])


def curves_page(answer: Answer, basename: str = "") -> Page:
    """Return the figure of a study's curves, with quantities in rows if there are several columns.

    Args:
        answer: of `find_curves`.
        basename: of the files; default: the study's figure, and how this one differs from the default.

    Raises:
        UserError: for more conditions than a panel can show.
    """
    drawing, quantities = answer.drawing, answer.about["quantities"]
    labels = [label for label in drawing["conditions"]["label"] if label]
    if drawing["runs"].groupby("environment")["condition"].nunique().max() > MOST_IN_A_PANEL:
        problem = f"study {answer.about['study']}: has too many conditions for one panel: pick"
        remedies = [Hint("conditions"), ", or ", Hint("figure", "summary")]
        raise UserError(f"{problem} {MOST_IN_A_PANEL} at most by ", *remedies)
    columns = list(drawing["panels"]["environment"].unique())
    panel_rows: list[list[Panel | None]] = []
    for quantity_name in quantities:
        panel_row: list[Panel | None] = []
        for title in columns:
            panel = _panel(answer, title, quantity_name)
            if panel and len(columns) > 1:
                panel = replace(panel, title=title, y=QUANTITIES[quantity_name].title_with_unit)
            panel_row.append(panel)
        panel_rows.append(panel_row)
    entries: dict[str, Any] = {}
    for title in columns:
        entries |= _legend(answer, title)
    notes = list(answer.notes)
    basename = basename or drawing["basename"]
    headline, inches, across = headline_of(answer), PANEL_INCHES, 3
    if len(columns) > 1:
        headline, across = ": ".join(filter(None, [drawing["title"], after_thesis(basename)])), 4
        if any("," in label.rpartition("(")[2] for label in labels):
            notes.append("In brackets: runs in each column.")
    else:
        panel_rows = [[panel for panel_row in panel_rows for panel in panel_row]]
        if len(quantities) == 1:
            inches *= 1.2
    runs = lines_of_runs(drawing["runs"], drawing["beside_runs"])
    return Page(basename, panel_rows, inches, headline, runs, entries, notes, across, answer)


def plot_curves(answer: Answer, axes: Axes | None = None) -> Axes:
    """Draw a study's curves of one quantity into axes, by default the current ones: `pneuma.api.plot`."""
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.gca()
    panel = _panel(answer, "", answer.about["quantities"][0])
    assert panel
    grid.fill(axes, panel, axes.get_window_extent().width / axes.figure.dpi)
    axes.legend()
    return axes


# --- Panels -----------------------------------------------------------------------------------------


def _panel(answer: Answer, environment: str, quantity: str) -> Panel | None:
    """Return the panel of a quantity in a column; None if it has no such curves."""
    rows = _rows_of(answer.drawing["panels"], environment, quantity).to_dict("records")
    if not rows:
        return None
    (panel,) = rows
    draw = partial(_draw, answer, panel)
    return Panel(draw, panel["title"], X_LABELS[answer.about["x"]], panel["label"], y_kind=panel["kind"])


def _rows_of(table: pd.DataFrame, environment: str, quantity: str = "") -> pd.DataFrame:
    """Return the rows of a table for a panel, or a column; tables of one column may not name it."""
    if "environment" in table:
        table = table[table["environment"] == environment]
    return table[table["quantity"] == quantity] if quantity else table


def _curves_of(answer: Answer, environment: str, quantity: str, is_beside: bool) -> list[Curve]:
    """Return the curves of a panel, the study's or those of the other study beside it."""
    drawing = answer.drawing
    table, run_table = answer.table, drawing["runs"]
    if is_beside:
        table, run_table = drawing["beside"], drawing["beside_runs"]
    run_counts = _rows_of(run_table, environment)["condition"].value_counts()
    all_lines = _rows_of(drawing["lines"], environment, quantity)
    all_lines = all_lines[all_lines["beside"] == is_beside]
    curves: list[Curve] = []
    for condition, points in _rows_of(table, environment, quantity).groupby("condition", sort=False):
        lines = all_lines[all_lines["condition"] == condition].pivot(index="x", columns="run", values="value")
        curves.append(Curve(str(condition), int(run_counts[condition]), points, lines))
    return curves


def _draw(answer: Answer, panel: Mapping[Any, Any], axes: Axes) -> None:
    """Draw bands, single runs and means of a quantity, the other study's runs, and the random player."""
    looks, place = looks_of(answer.drawing), (panel["environment"], panel["quantity"])
    curves, beside_curves = (_curves_of(answer, *place, is_beside) for is_beside in (False, True))
    run_count = sum(curve.run_count for curve in (*curves, *beside_curves))
    draw_spread = partial(
        _draw_spread,
        axes,
        bands=answer.about["bands"],
        bounds=(panel["least"], panel["greatest"]),
        run_count=run_count,
    )
    stops = _rows_of(answer.drawing["stops"], *place)
    for curve in curves:
        look = looks[curve.condition]
        draw_spread(curve, look["color"])
        _draw_mean(axes, curve, look)
        for x, value in stops[stops["condition"] == curve.condition][["x", "value"]].to_numpy():
            axes.plot(x, value, "x", color=look["color"], markersize=4 * mpl.rcParams["lines.linewidth"])
    limits = axes.get_ylim()
    for curve in beside_curves:
        draw_spread(curve, looks.get(curve.condition, BESIDE_LOOK)["color"])
    _draw_beside(axes, beside_curves, looks)
    if panel["own_limits"]:
        axes.set_ylim(limits)
    # by its kind a share, whatever the axis
    unit, low = QUANTITIES[panel["quantity"]].kind, panel["low"]
    if unit == SHARES:
        low = 0.0
    reference = _rows_of(answer.tables["reference"], *place)
    levels = reference["value"][reference["x"].isna()]
    grid.draw_random_player(axes.axhline, set(levels), (low, panel["high"]), unit)
    returns = reference.dropna(subset="x")
    if len(returns):
        axes.plot(returns["x"], returns["value"], label=grid.RANDOM_PLAYER, **grid.RANDOM_LOOK)
    axes.set_xlim(0, panel["end"])
    if panel["kind"] == SHARES:
        upper_limit = min(max(axes.get_ylim()[1], 0.01), 1 + grid.BELOW_ZERO)
        axes.set_ylim(-grid.BELOW_ZERO * upper_limit, upper_limit)


def _draw_spread(
    axes: Axes, curve: Curve, colour: str, bands: Sequence[str], bounds: tuple[float, float], run_count: int
) -> None:
    """Draw the bands of a curve, and its single runs where they are shown, fainter among many in a panel."""
    for band in drawn_bands(bands, curve.run_count):
        frame, opacity = curve.frame(band), PALE
        if band == INTERVAL:  # where some runs have no value, the remaining ones are no fair sample
            edges = frame[["low", "high"]].where(frame["runs"] == curve.run_count)
            frame, opacity = edges.assign(x=frame["x"]), DARK
        grid.draw_band(axes, frame, bounds, color=colour, alpha=opacity)
    if len(curve.lines):
        line_width, opacity = 0.3 * mpl.rcParams["lines.linewidth"], 0.4 * min(1.0, MANY_RUNS / run_count)
        axes.plot(
            curve.lines, color=colour, linewidth=line_width, alpha=opacity, zorder=1.4,
            marker=_single_marker(curve), markersize=3 * line_width,
        )  # fmt: skip


def _draw_mean(axes: Axes, curve: Curve, look: Mapping[str, Any]) -> None:
    """Draw the mean of runs, faint where some have no value."""
    frame, line_width = curve.means, mpl.rcParams["lines.linewidth"]
    spacing = max(len(frame) // MARKED_POINTS, 1)
    first_marker = MARKERS.index(look["marker"]) * spacing // len(MARKERS) % spacing  # no two meet
    (line,) = axes.plot(
        frame["x"], frame["mean"].where(frame["runs"] == curve.run_count), markersize=2.2 * line_width,
        clip_on=False, markevery=(first_marker, spacing), zorder=2.2, **look,
    )  # fmt: skip
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(frame["x"], frame["mean"], color=look["color"], alpha=0.35, zorder=1.5)


def _draw_beside(axes: Axes, curves: Sequence[Curve], looks: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw the means of another study: in the colours of conditions with their names, or else in grey."""
    grey_count = sum(curve.run_count for curve in curves if curve.condition not in looks)
    for curve in curves:
        frame = curve.means
        title, condition_label = frame[["title", "label"]].iloc[0]
        label = f"{title} ({grey_count})"
        if curve.condition in looks:
            label = f"{condition_label}, {title} ({curve.run_count})"
        axes.plot(
            frame["x"], frame["mean"], label=label, color=looks.get(curve.condition, BESIDE_LOOK)["color"],
            linewidth=0.8 * mpl.rcParams["lines.linewidth"], linestyle=(0, (3, 1)), zorder=2.1,
            marker=_single_marker(curve), markersize=4,
        )  # fmt: skip


def _single_marker(curve: Curve) -> str:
    """Return a marker for runs with one point, which a line cannot show."""
    return "o" if curve.means["mean"].notna().sum() == 1 else ""


def _legend(answer: Answer, environment: str) -> dict[str, Any]:
    """Return the artists of the legend that describe means, bands and runs of a column, by their words."""
    largest_group = _rows_of(answer.drawing["runs"], environment)["condition"].value_counts().max()
    entries: dict[str, Any] = {"mean of (n) runs": Line2D([], [], color=style.INK, linewidth=1.6)}
    bands = drawn_bands(answer.about["bands"], largest_group)
    for band in bands:
        if BANDS[band].label and largest_group >= BANDS[band].least_runs:
            opacity = PALE
            if band == INTERVAL:
                opacity = DARK + PALE * (len(bands) - 1)  # one lies in the other
            entries[BANDS[band].label] = Patch(color=style.INK, alpha=opacity, linewidth=0)
    lines = _rows_of(answer.drawing["lines"], environment)
    if not lines["beside"].all():
        entries[BANDS["runs"].label] = Line2D([], [], color=style.INK, linewidth=0.5, alpha=0.5)
    return entries
