"""Figures of curves: a panel for each quantity, and a column for each world or environment.

    studies, quantities, options → a `Column` of curves for each study → a `Panel` for each quantity → Page

A line is the mean of runs, in a band that the legend describes. Each condition has its label, with the
number of its runs, in the legend.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pneuma.analysis import BAND_NAMES
from pneuma.analysis.curves import (
    BANDS,
    EPISODES,
    STEPS,
    WALL_CLOCK,
    Curve,
    checked_band,
    curve_names,
    random_levels,
    random_returns,
    study_curves,
)
from pneuma.analysis.environments import OUTCOME, Parts, in_environment_of, profiles, references
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import find_outcome, have_one_return, is_foreign
from pneuma.analysis.study_data import StudyData
from pneuma.env.fields import ACTION_NAMES
from pneuma.errors import UserError, counted
from pneuma.figures import grid, style
from pneuma.figures.grid import POWERS, SHARES, VALUES, Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.style import MARKERS, MOST_IN_A_PANEL, PANEL_INCHES
from pneuma.figures.words import (
    MOST_NAMED,
    after_thesis,
    headline_of,
    labels_of,
    looks_of,
    merge_notes,
    notes_of,
    shown_conditions,
)
from pneuma.store.quantities import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.store.series import GRID_POINTS

DEFAULT_QUANTITIES, EVALUATED = ("return", "share_killed", "success"), "evaluated_return"
TRAILING_WINDOW = WINDOWS[1]
DEFAULT_BAND, INTERVAL, RUNS, NO_BAND = BAND_NAMES[0], "ci", "runs", "none"
PALE, DARK = 0.13, 0.30
"""Opacity of a band, and of the interval of the centre."""
MARKED_POINTS = 8
"""Markers per line; they distinguish lines in grey."""
MANY_RUNS = 30
"""With this many runs in a panel, their lines are fainter, so that means stay in front."""
LEAST_POINTS = GRID_POINTS // 2
"""With a mean of all runs at fewer points, a curve of training is stubs."""
BESIDE_COLOUR = "#404040"
PROFILE_BAND = "95 % band, stratified bootstrap"
OF_BUDGET = "mean of the last 5 % of the budget at each point"

X_LABELS = {STEPS: "Environment steps", EPISODES: "Episodes", WALL_CLOCK: "Seconds of training"}
X_NOTES = {
    STEPS: "",
    EPISODES: "Episodes are counted by their mean length up to each point.",
    WALL_CLOCK: "Within a run, all steps are taken to last equally long.",
}


@dataclass(frozen=True)
class Quantity:
    """What a panel of a quantity has; see `quantities.toml`."""

    title: str
    label: str
    kind: str = VALUES
    bounds: tuple[float, float] = (-np.inf, np.inf)


def _read_quantities() -> dict[str, Quantity]:
    rows = tomllib.loads(Path(__file__).with_name("quantities.toml").read_text(encoding="utf-8"))
    action = rows.pop("action")
    for number, name in enumerate(ACTION_NAMES):
        rows[f"action_{number}"] = {**action, "title": action["title"].format(action=name)}
    return {name: Quantity(**row) for name, row in rows.items()}


QUANTITIES = _read_quantities()
RETURN_BOUNDS = {"CartPole-v1": (0.0, 500.0), "Acrobot-v1": (-500.0, 0.0), "MountainCar-v0": (-200.0, 0.0)}


@dataclass(frozen=True)
class Options:
    """How curves are drawn.

    Attributes:
        band: one of `BANDS`; None for the deviation, and inside it the interval of the mean.
        window: of the study's windows; None for the first.
        x: one of `X_AXES`.
        log: whether all axes of values are logarithmic, and not only those of quantities that go through
            powers of ten.
    """

    band: str | None = None
    window: str | None = None
    x: str = STEPS
    log: bool = False

    @property
    def bands(self) -> list[str]:
        """What is drawn around means: in the deviation there is their interval."""
        band = checked_band(self.band or DEFAULT_BAND)
        return [band, INTERVAL] if band == DEFAULT_BAND else [band]


@dataclass(frozen=True)
class Column:
    """A study's curves of some quantities, and those of a study that is drawn with it.

    Attributes:
        looks, labels: of conditions.
    """

    data: StudyData
    settings: Options
    looks: Mapping[str, Mapping[str, Any]]
    labels: Mapping[str, str]
    curves: Mapping[str, list[Curve]]
    beside: StudyData | None = None
    beside_curves: Mapping[str, list[Curve]] = field(default_factory=dict)

    @property
    def all_curves(self) -> list[Curve]:
        return [curve for curves in self.curves.values() for curve in curves]


def curves_page(
    studies: StudyData | Mapping[str, StudyData],
    quantities: str | Sequence[str] = (),
    basename: str = "",
    beside: StudyData | None = None,
    **options: Any,
) -> Page:
    """Return the figure of the curves of a study's finished runs.

    Args:
        studies: the study; or its runs in each world, by the title of a column. The quantities are the rows
            then.
        quantities: of `curve_names`; default: the return, in other environments than Pneuma's that of
            evaluations, and the share killed, as far as recorded. If returns are of different rewards, the
            length of episodes replaces them.
        basename: of the files; default: of a single study its figure, and how this one differs from the
            default.
        beside: another study, whose runs are drawn in the columns of their environment.
        options: as `Options` has them.

    Raises:
        UserError: for more conditions than a panel can show, a quantity that the study's data does not have,
            or runs beside that are all of other environments.
    """
    settings = Options(**options)
    by_title = {"": studies} if isinstance(studies, StudyData) else studies
    datas = [*by_title.values()]
    data = datas[0]
    if len(shown_conditions(datas)) > MOST_IN_A_PANEL:
        advice = f"pick {MOST_IN_A_PANEL} at most by --condition, or --figure summary"
        raise UserError(f"study {data.study.name}: has too many conditions for one panel: {advice}")
    default = default_quantities(data, beside)
    if isinstance(quantities, str):
        quantities = [quantities]
    names = [*filter(None, dict.fromkeys(quantities))] or default
    recorded = {title: curve_names(study) for title, study in by_title.items()}
    nowhere = {*names}.difference(*recorded.values())
    study_curves(data, sorted(nowhere))  # refuses what no study has
    looks, labels = looks_of(datas), labels_of(datas)
    columns: dict[str, Column] = {}
    for title, study in by_title.items():
        shared = [name for name in names if name in recorded[title]]
        if shared:
            columns[title] = _column(study, shared, beside, settings, looks, labels)
    studies_beside = dict.fromkeys(column.beside for column in columns.values() if column.beside)
    if beside and not studies_beside:
        environments_text = f"{' and '.join(beside.environments)}, not in {' and '.join(data.environments)}"
        raise UserError(f"--beside {beside.study.name}: its runs are in {environments_text}")
    rows: dict[str, list[Panel | None]] = {name: [] for name in names}
    entries: dict[str, Any] = {}
    for title, column in columns.items():
        entries |= _legend(column)
        for name, row in rows.items():
            if name not in column.curves:
                row.append(None)
            elif len(columns) > 1:
                row.append(replace(_panel(column, name), title=title, y=QUANTITIES[name].title))
            else:
                row.append(_panel(column, name))
    notes = merge_notes({title: (column.data, _caption(column)) for title, column in columns.items()})
    stem = basename or data.basename(*_differences(settings, names, default, beside))
    panels, headline, inches, across = [*rows.values()], headline_of(data), PANEL_INCHES, 3
    if len(columns) > 1:
        headline, across = ": ".join(filter(None, [data.study.title, after_thesis(stem)])), 4
        if any("," in label.rpartition("(")[2] for label in labels.values()):
            notes.append("In brackets: runs in each column.")
    else:
        panels = [[panel for row in panels for panel in row]]
        if len(names) == 1:
            inches *= 1.2
    return Page(
        basename=stem,
        grid=panels,
        inches=inches,
        headline=headline,
        runs=lines_of_runs(*datas, *studies_beside),
        entries=entries,
        caption=notes,
        across=across,
        spare=len(columns) == 1 and not any(quantities),
    )


def plot_curves(data: StudyData, quantity: str = "", ax: Axes | None = None, **options: Any) -> Axes:
    """Draw a study's curves of one quantity into axes, by default the current ones: `pneuma.api.plot`."""
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.gca()
    name = quantity or default_quantities(data)[0]
    column = _column(data, [name], None, Options(**options), looks_of([data]), labels_of([data]))
    grid.fill(ax, _panel(column, name), ax.get_window_extent().width / ax.figure.dpi)
    ax.legend()
    return ax


def default_quantities(data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return the quantities of a study's default figure, or of that with another study beside.

    The return is that of evaluations, where both have it, in environments that are not Pneuma's, and where
    episodes are so long for the budget that a training curve has gaps.
    """
    recorded = curve_names(data)
    first, *alternatives = DEFAULT_QUANTITIES
    evaluated = EVALUATED in recorded and (beside is None or EVALUATED in curve_names(beside))
    if not have_one_return(data):
        first = "length"
    elif evaluated and (is_foreign(data) or (first in recorded and _has_stubs(data, first))):
        first = EVALUATED
    return [name for name in (first, *alternatives) if name in recorded] or recorded[:1] or ["return"]


def _has_stubs(data: StudyData, quantity: str) -> bool:
    """Return whether in some condition all runs together have values at too few points for a line."""
    for curve in study_curves(data, [quantity])[quantity]:
        points = curve.runs.loc[:, np.logical_not(curve.diverged)].notna().all(axis=1)
        if points.sum() < LEAST_POINTS:
            return True
    return False


def _differences(
    settings: Options, names: Sequence[str], default: Sequence[str], beside: StudyData | None
) -> list[str]:
    """Return how a figure differs from the study's default one, for the name of its files."""
    suffixes: list[str] = []
    if names != default:
        suffixes += names if len(names) < MOST_NAMED else [f"{len(names)}-quantities"]
    if settings.bands[0] != DEFAULT_BAND:
        suffixes.append(settings.bands[0])
    if settings.log:
        suffixes.append("log")
    if settings.x != STEPS:
        suffixes.append(f"over-{settings.x}")
    if settings.window == TRAILING_WINDOW:
        suffixes.append(settings.window)
    if beside:
        suffixes += ["beside", beside.study.name]
    return suffixes


# --- Columns and panels ------------------------------------------------------------------------------


def _column(
    data: StudyData,
    names: Sequence[str],
    beside: StudyData | None,
    settings: Options,
    looks: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, str],
) -> Column:
    """Return a study's curves; on a logarithmic axis, means and bands are of logarithms."""
    curves = study_curves(data, names, settings.window, settings.x)
    for name, group in curves.items():
        if (settings.log or QUANTITIES[name].kind == POWERS) and _reach(group)[1] > 0:
            curves[name] = [replace(curve, log=True) for curve in group]
    column = Column(data, settings, looks, labels, curves)
    other_study = beside and in_environment_of(data, beside)
    if not other_study:
        return column
    window = settings.window
    if window not in other_study.windows:
        window = None
    recorded = curve_names(other_study)
    shared = [name for name in names if name in recorded]
    if not shared:
        raise UserError(f"study {other_study.study.name} has no {' or '.join(names)} to draw")
    return replace(
        column, beside=other_study, beside_curves=study_curves(other_study, shared, window, settings.x)
    )


def _panel(column: Column, name: str) -> Panel:
    quantity = QUANTITIES[name]
    title, label, scale = quantity.title, quantity.label, quantity.kind
    if column.data.averaged_over:  # in the log
        label = label.replace(" of an episode", f", {_window(column.data, column.settings)}")
    if name.startswith("action_") and is_foreign(column.data):
        title = f"Share of action {name.removeprefix('action_')}"
    if column.curves[name][0].log:
        scale = POWERS
    elif scale == POWERS:
        scale = VALUES
    return Panel(partial(_draw, column, name), title, X_LABELS[column.settings.x], label, y_kind=scale)


def _draw(column: Column, name: str, axes: Axes) -> None:
    data, settings, curves, beside_curves = (
        column.data,
        column.settings,
        column.curves[name],
        column.beside_curves.get(name, []),
    )
    quantity_kind, bounds = QUANTITIES[name].kind, QUANTITIES[name].bounds
    if name in ("return", EVALUATED):
        bounds = RETURN_BOUNDS.get(" ".join(data.environments), bounds)
    lines = sum(curve.run_count for curve in curves)
    for curve in curves:
        line_style = column.looks[curve.condition]
        for band in settings.bands:
            frame = curve.frame(band)
            if band == INTERVAL:  # where some runs have no value, the remaining ones are no fair sample
                frame[["low", "high"]] = frame[["low", "high"]].where(frame["count"] == curve.run_count)
            grid.draw_band(
                axes, frame, bounds, color=line_style["color"], alpha=DARK if band == INTERVAL else PALE
            )
        if _shows_runs(curve, settings.bands[0]):
            width, opacity = 0.3 * mpl.rcParams["lines.linewidth"], 0.4 * min(1.0, MANY_RUNS / lines)
            axes.plot(curve.runs, color=line_style["color"], linewidth=width, alpha=opacity, zorder=1.4)
        _draw_centre(axes, curve, line_style, column.labels[curve.condition])
    if column.beside:
        _draw_beside(axes, beside_curves, column)
    low, high = _reach([*curves, *beside_curves])
    if quantity_kind == SHARES:
        low = 0.0
    grid.draw_random_player(axes.axhline, random_levels(data, name).values(), (low, high), quantity_kind)
    end = max(float(curve.runs.index.max()) for curve in (*curves, *beside_curves))
    if settings.x == STEPS:
        end = max(end, data.budget)
        returns = random_returns(data, end)
        if name == "return" and returns is not None:
            axes.plot(returns, label=grid.RANDOM_PLAYER, **grid.RANDOM_LOOK)
    axes.set_xlim(0, end)
    if quantity_kind == SHARES and not settings.log:
        top = min(max(axes.get_ylim()[1], 0.01), 1 + grid.BELOW_ZERO)
        axes.set_ylim(-grid.BELOW_ZERO * top, top)


def _draw_centre(axes: Axes, curve: Curve, line_style: Mapping[str, Any], label: str) -> None:
    """Draw the centre of runs, faint where some have no value, and a cross where a run diverged."""
    frame, width = curve.frame(), mpl.rcParams["lines.linewidth"]
    marker_spacing = max(len(frame) // MARKED_POINTS, 1)
    first = (
        MARKERS.index(line_style["marker"]) * marker_spacing // len(MARKERS) % marker_spacing
    )  # no two meet
    centre = frame["centre"].where(frame["count"] == curve.run_count)
    (line,) = axes.plot(
        frame["x"], centre, label=label, markersize=2.2 * width, clip_on=False,
        markevery=(first, marker_spacing), zorder=2.2, **line_style,
    )  # fmt: skip
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(frame["x"], frame["centre"], color=line_style["color"], alpha=0.35, zorder=1.5)
    for step, value in curve.stops:
        axes.plot(step, value, "x", color=line_style["color"], markersize=4 * width)


def _draw_beside(axes: Axes, curves: Sequence[Curve], column: Column) -> None:
    """Draw the runs of another study: in the colours of conditions that have their names, or else in grey."""
    assert column.beside
    data, looks = column.beside, column.looks
    title = data.full_title
    if data.study.name == column.data.study.name and data.plan:
        title = f"preset {data.plan.preset}"  # what tells runs of one study apart
    unlike = sum(curve.run_count for curve in curves if curve.condition not in looks)
    opacity = min(1.0, MANY_RUNS / len(data.runs))
    for curve in curves:
        colour, label, fading = BESIDE_COLOUR, f"{title} ({unlike})", 1.0
        if curve.condition in looks:
            name = data.study.labels.get(curve.condition, curve.condition)
            colour, fading = looks[curve.condition]["color"], 0.6
            label = f"{name}, {title} ({curve.run_count})"
        axes.plot(
            curve.runs, label=label, color=colour, alpha=fading * opacity, linewidth=0.7,
            linestyle=(0, (3, 1)), zorder=1.3,
        )  # fmt: skip


def _reach(curves: Iterable[Curve]) -> tuple[float, float]:
    """Return the least and greatest value of any run; 0 if none has a value."""
    low, high = np.inf, -np.inf
    for curve in curves:
        values = curve.runs.to_numpy()
        finite = values[np.isfinite(values)]
        low, high = finite.min(initial=low), finite.max(initial=high)
    return (0.0, 0.0) if low > high else (float(low), float(high))


def _shows_runs(curve: Curve, band: str) -> bool:
    """Return whether every run is drawn: if the band says so, runs are few, or it rarely covers the mean."""
    count = curve.run_count
    if band in (NO_BAND, RUNS):
        return band == RUNS
    return 1 < count < LEAST_RUNS or count < BANDS[band].enough_runs


# --- Words -------------------------------------------------------------------------------------------


def _legend(column: Column) -> dict[str, Any]:
    """Return the artists of the legend that describe means, bands and runs, by their words."""
    bands = column.settings.bands
    largest_group = max(curve.run_count for curve in column.all_curves)
    entries: dict[str, Any] = {"mean of (n) runs": Line2D([], [], color=style.INK, linewidth=1.6)}
    for band in bands:
        if BANDS[band].label and largest_group >= BANDS[band].least_runs:
            opacity = PALE
            if band == INTERVAL:
                opacity = DARK + PALE * (len(bands) - 1)  # one lies in the other
            entries[BANDS[band].label] = Patch(color=style.INK, alpha=opacity, linewidth=0)
    if any(_shows_runs(curve, bands[0]) for curve in column.all_curves):
        entries[BANDS[RUNS].label] = Line2D([], [], color=style.INK, linewidth=0.5, alpha=0.5)
    return entries


def _caption(column: Column) -> list[str]:
    """Return the notes on a study and on what is drawn of it, the most important first."""
    data, settings, curves = column.data, column.settings, column.all_curves
    notes = notes_of(data, bool({"return", EVALUATED} & {*column.curves}), column.beside)
    for name, group in column.curves.items():
        if settings.log and not group[0].log:
            notes.append(f"{QUANTITIES[name].title}: no value is above 0, so the axis is linear.")
    least_runs = BANDS[settings.bands[0]].least_runs
    for curve in curves:
        runs = f"{curve.condition} ({counted(curve.run_count, 'run')})"
        if curve.stops:
            notes.append("×: a run diverged, and its curve ends there.")
        if _has_gaps(curve):
            notes.append("Faint parts have no interval, because some run has no value there.")
        if curve.log:
            notes.append(
                "On logarithmic axes, means and bands are of logarithms and leave out values of 0 or below."
            )
        if settings.band and curve.run_count < least_runs:
            notes.append(
                f"The band {settings.band} needs {counted(least_runs, 'run')}: not drawn for {runs}."
            )
        if curve.values.isna().all().any():
            notes.append(f"Some of {runs} have no value in a panel and are left out of its means.")
    if {*column.curves} & {*EPISODE_QUANTITIES}:
        notes.append(f"Returns and lengths: {_window(data, settings)}.")
    if {*column.curves} & {*UPDATE_QUANTITIES}:
        notes.append(f"Updates: {OF_BUDGET}.")
    if column.beside and column.beside.averaged_over is not None:
        name = column.beside.study.name
        notes.append(
            f"{name}: {_window(column.beside, settings)}. The environment of {name} is not recorded."
        )
    return [*notes, X_NOTES[settings.x]]


def _window(data: StudyData, settings: Options) -> str:
    """Return what a point of a study's returns is the mean of."""
    if data.averaged_over == 1:
        return "as logged"
    if data.averaged_over or (settings.window or data.windows[0]) == TRAILING_WINDOW:
        return f"mean of the last {data.averaged_over or 100} episodes"
    return OF_BUDGET


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run that did not diverge lacks a value after all had one."""
    complete_points = np.flatnonzero(curve.runs.notna().all(axis=1))
    return (
        not curve.stops
        and len(complete_points) > 0
        and len(complete_points) < len(curve.runs) - complete_points[0]
    )


# --- Scores over several environments ------------------------------------------------------------------


def profile_page(data: StudyData, data_by_env: Parts, outcome: str = OUTCOME) -> Page:
    """Return performance profiles (Agarwal et al. 2021): the share of runs above each score.

    Scores are those of `pneuma.analysis.environments.scores`, over all environments together.
    """
    table, looks = profiles(data_by_env, outcome), looks_of([*data_by_env.values()])

    def draw(axes: Axes) -> None:
        for condition, frame in table.groupby("condition", sort=False):
            colour = looks[str(condition)]["color"]
            grid.draw_band(axes, frame, (0, 1), color=colour, alpha=PALE)
            label = f"{condition} ({frame['runs'].iloc[0]})"
            axes.plot(frame["x"], frame["centre"], color=colour, label=label)
        axes.set(xlim=(table["x"].min(), table["x"].max()), ylim=(0, 1 + grid.BELOW_ZERO))

    panel = Panel(draw, x="Score", y="Share of runs above it", y_kind=SHARES)
    scales: list[str] = []
    for env, (low, high) in references(data_by_env, outcome).items():
        scale = f"{grid.number(low)} and {grid.number(high)} in {env}"
        if env not in data.study.scores:
            scale += " (random player, best condition)"
        scales.append(scale)
    notes = [f"Score: {find_outcome(outcome).words}; 0 and 1 are {', '.join(scales)}.", data.ends]
    return Page(
        basename=data.basename("profile"),
        grid=[[panel]],
        inches=1.2 * PANEL_INCHES,
        headline=headline_of(data, "performance profiles"),
        runs=lines_of_runs(data),
        entries={PROFILE_BAND: Patch(color=style.INK, alpha=PALE, linewidth=0)},
        caption=notes,
    )
