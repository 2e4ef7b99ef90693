"""Figures of curves: a panel for each quantity, and a column for each world or environment.

    studies, quantities, options → a `Column` of curves for each study → a `Panel` for each quantity → Page

A line is the centre of runs, in a band that the legend describes. Each condition has its label, with the
number of its runs, in the legend.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pneuma.analysis import BAND_NAMES
from pneuma.analysis.curves import (
    BANDS,
    CENTER_WORDS,
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
from pneuma.analysis.environments import OUTCOME, Parts, environments, in_environment_of, profiles, references
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
"""Opacity of a band, and of the interval of the mean inside it."""
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
    WALL_CLOCK: "Over time, a run goes on at an even pace.",
}


class Quantity(NamedTuple):
    """What a panel of a quantity has.

    Attributes:
        kind: of its axis.
        bounds: the least and greatest possible value, at which bands end.
    """

    title: str
    label: str
    kind: str = VALUES
    bounds: tuple[float, float] = (-np.inf, np.inf)


SHARE: Any = {"kind": SHARES, "bounds": (0, 1)}
POSITIVE: Any = {"bounds": (0, np.inf)}
QUANTITIES = {
    "share_killed": Quantity("Monsters killed in evaluation", "Share killed", **SHARE),
    "argmax_share_killed": Quantity("Monsters killed, likeliest actions", "Share killed", **SHARE),
    "score": Quantity("Normalised score in evaluation", "0 random player, 1 all killed"),
    "success": Quantity("Successes in evaluation", "Share of episodes", **SHARE),
    "evaluated_return": Quantity("Return in evaluation", "Return of an episode"),
    "return": Quantity("Return in training", "Return of an episode"),
    "length": Quantity("Length of episodes in training", "Steps of an episode", **POSITIVE),
    "kills": Quantity("Monsters killed in training", "Kills of an episode", **POSITIVE),
    "hp": Quantity("HP left in training", "HP at the end of an episode", **POSITIVE),
    "entropy": Quantity("Entropy of the policy", "Entropy (nats)"),
    "grad_norm": Quantity("Gradient norm, unclipped", "L2 norm", POWERS),
    "grad_norm_actor": Quantity("Actor's gradient norm", "L2 norm", POWERS),
    "grad_norm_critic": Quantity("Critic's gradient norm", "L2 norm", POWERS),
    "approx_kl": Quantity("KL divergence", "KL divergence (nats)"),
    "explained_variance": Quantity("Variance of returns explained", "Explained variance"),
    "dead_units": Quantity("Dead hidden units", "Share of units", **SHARE),
}
for _number, _action in enumerate(ACTION_NAMES):
    QUANTITIES[f"action_{_number}"] = Quantity(f"Share of action: {_action}", "Share of actions", **SHARE)
RETURN_BOUNDS = {"CartPole-v1": (0.0, 500.0), "Acrobot-v1": (-500.0, 0.0), "MountainCar-v0": (-200.0, 0.0)}


@dataclass(frozen=True)
class Options:
    """How curves are drawn.

    Attributes:
        band: one of `BANDS`; None for the deviation of means, and inside it their interval, or for the
            interval of another centre.
        window: of the study's windows; None for the first.
        x: one of `X_AXES`.
        center: one of `CENTERS`.
        log: whether all axes of values are logarithmic, and not only those of quantities that go through
            powers of ten.
    """

    band: str | None = None
    window: str | None = None
    x: str = STEPS
    center: str = "mean"
    log: bool = False

    @property
    def bands(self) -> list[str]:
        """What is drawn around centres: in a deviation of means there is their interval."""
        default = DEFAULT_BAND if self.center == "mean" else INTERVAL
        band = checked_band(self.band or default)
        if band == DEFAULT_BAND and self.center == "mean":
            return [band, INTERVAL]
        return [band]


@dataclass(frozen=True)
class Column:
    """A study's curves of some quantities, and those of a study that is drawn with it."""

    data: StudyData
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
    how = Options(**options)
    by_title = {"": studies} if isinstance(studies, StudyData) else studies
    datas = [*by_title.values()]
    data = datas[0]
    if len(shown_conditions(datas)) > MOST_IN_A_PANEL:
        advice = f"pick {MOST_IN_A_PANEL} at most by --condition, or --figure summary"
        raise UserError(f"study {data.study.name}: its conditions do not fit one panel: {advice}")
    names = [quantities] if isinstance(quantities, str) else [*dict.fromkeys(quantities)]
    names = [*filter(None, names)] or default_quantities(data, beside)
    known = {title: curve_names(study) for title, study in by_title.items()}
    nowhere = {*names}.difference(*known.values())
    study_curves(data, sorted(nowhere))  # refuses what no study has
    columns: dict[str, Column] = {}
    for title, study in by_title.items():
        shown = [name for name in names if name in known[title]]
        if shown:
            columns[title] = _column(study, shown, beside, how)
    if beside and not any(column.beside for column in columns.values()):
        own, others = (" and ".join(environments(study)) for study in (data, beside))
        raise UserError(f"--beside {beside.study.name}: its runs are of {others}, and not of {own}")
    studies_beside = {column.beside: None for column in columns.values() if column.beside}
    looks, labels = looks_of(datas), labels_of(datas)
    panels: list[list[Panel | None]] = [[] for _ in names]
    entries: dict[str, Any] = {}
    for title, column in columns.items():
        entries |= _legend(column, how)
        for row, name in zip(panels, names, strict=True):
            if name not in column.curves:
                row.append(None)
                continue
            panel = _panel(column, name, how, looks, labels)
            if len(columns) > 1:
                panel = replace(panel, title=title, y=QUANTITIES[name].title)
            row.append(panel)
    notes = merge_notes({title: (column.data, _caption(column, how)) for title, column in columns.items()})
    if any("," in label.rpartition("(")[2] for label in labels.values()):
        notes.append("In brackets: runs in each column.")
    headline, inches, across = headline_of(data), PANEL_INCHES, 3
    stem = basename or data.basename(*_differences(data, how, names, beside))
    if len(columns) > 1:
        headline, inches, across = data.study.title, 0.95 * PANEL_INCHES, 4
        if after_thesis(stem):
            headline += f": {after_thesis(stem)}"
    else:
        panels = [[row[0] for row in panels]]
        if len(names) == 1:
            inches *= 1.2
    runs = lines_of_runs(*datas, *studies_beside)
    spare = len(columns) == 1 and not quantities
    return Page(stem, panels, inches, headline, runs, entries, notes, across, spare)


def plot_curves(data: StudyData, quantity: str = "", ax: Axes | None = None, **options: Any) -> Axes:
    """Draw a study's curves of one quantity into axes, by default the current ones: `pneuma.api.plot`."""
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.gca()
    how, name = Options(**options), quantity or default_quantities(data)[0]
    column = _column(data, [name], None, how)
    panel = _panel(column, name, how, looks_of([data]), labels_of([data]))
    grid.fill(ax, panel, ax.get_window_extent().width / ax.figure.dpi)
    ax.legend()
    return ax


def default_quantities(data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return the quantities of a study's default figure, or of that with another study beside.

    The return is that of evaluations, where both have it, in environments that are not Pneuma's, and where
    episodes are so long for the budget that a training curve has gaps.
    """
    known = curve_names(data)
    first, *others = DEFAULT_QUANTITIES
    evaluated = EVALUATED in known and (beside is None or EVALUATED in curve_names(beside))
    if not have_one_return(data):
        first = "length"
    elif evaluated and (is_foreign(data) or (first in known and _has_stubs(data, first))):
        first = EVALUATED
    return [name for name in (first, *others) if name in known] or known[:1] or ["return"]


def _has_stubs(data: StudyData, quantity: str) -> bool:
    """Return whether in some condition all runs together have values at too few points for a line."""
    for curve in study_curves(data, [quantity])[quantity]:
        whole = curve.runs.loc[:, np.logical_not(curve.diverged)].notna().all(axis=1)
        if whole.sum() < LEAST_POINTS:
            return True
    return False


def _differences(data: StudyData, how: Options, names: Sequence[str], beside: StudyData | None) -> list[str]:
    """Return how a figure differs from the study's default one, for the name of its files."""
    differences: list[str] = []
    if names != default_quantities(data):
        differences.append("all" if names == curve_names(data) else "-".join(names))
    if how.band is not None and how.bands[0] != DEFAULT_BAND:
        differences.append(how.bands[0])
    if how.center != "mean":
        differences.append(how.center)
    if how.log:
        differences.append("log")
    if how.x != STEPS:
        differences.append(f"over-{how.x}")
    if how.window and how.window != data.windows[0] and {*names} & {*EPISODE_QUANTITIES}:
        differences.append(how.window.removesuffix("%"))
    if beside:
        differences += ["beside", beside.study.name]
    return differences


# --- Columns and panels ------------------------------------------------------------------------------


def _column(data: StudyData, names: Sequence[str], beside: StudyData | None, how: Options) -> Column:
    """Return a study's curves; on a logarithmic axis, centres and bands are of logarithms."""
    curves = study_curves(data, names, how.window, how.x, how.center)
    for name, group in curves.items():
        if (how.log or QUANTITIES[name].kind == POWERS) and _reach(group)[1] > 0:
            curves[name] = [replace(curve, log=True) for curve in group]
    others = in_environment_of(data, beside) if beside else None
    if others is None:
        return Column(data, curves)
    window = how.window if how.window in others.windows else others.windows[0]
    known = [name for name in names if name in curve_names(others)]
    if not known:
        raise UserError(f"study {others.study.name} has no {' or '.join(names)} to draw beside")
    return Column(data, curves, others, study_curves(others, known, window, how.x))


def _panel(
    column: Column,
    name: str,
    how: Options,
    looks: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, str],
) -> Panel:
    quantity = QUANTITIES[name]
    title, label, kind = quantity.title, quantity.label, quantity.kind
    if column.data.averaged_over:  # in the log
        label = label.replace(" of an episode", f", {_window(column.data, how)}")
    if name.startswith("action_") and is_foreign(column.data):
        title = f"Share of action {name.removeprefix('action_')}"
    if any(curve.log for curve in column.curves[name]):
        kind = POWERS
    elif kind == POWERS:
        kind = VALUES
    draw = partial(_draw, column=column, name=name, how=how, looks=looks, labels=labels)
    return Panel(draw, title, X_LABELS[how.x], label, VALUES, kind)


def _draw(
    axes: Axes,
    column: Column,
    name: str,
    how: Options,
    looks: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, str],
) -> None:
    data, curves, others = column.data, column.curves[name], column.beside_curves.get(name, [])
    is_share = QUANTITIES[name].kind == SHARES
    bounds = QUANTITIES[name].bounds
    envs = environments(data)
    if name in ("return", EVALUATED) and len(envs) == 1:
        bounds = RETURN_BOUNDS.get(envs[0], bounds)
    lines = sum(curve.runs.shape[1] for curve in curves if _shows_runs(curve, how.bands[0]))
    for curve in curves:
        look = looks[curve.condition]
        _draw_bands(axes, curve, how.bands, bounds, look["color"])
        if _shows_runs(curve, how.bands[0]):
            width, opacity = 0.3 * mpl.rcParams["lines.linewidth"], 0.4 * min(1.0, MANY_RUNS / lines)
            axes.plot(curve.runs, color=look["color"], linewidth=width, alpha=opacity, zorder=1.4)
        _draw_centre(axes, curve, look, labels[curve.condition])
    if column.beside:
        _draw_beside(axes, others, column.beside, looks)
    low, high = _reach([*curves, *others])
    if is_share:
        grid.draw_random_player(axes, random_levels(data, name), (0.0, high), grid.per_cent)
    else:
        grid.draw_random_player(axes, random_levels(data, name), (low, high), grid.number)
    returns = random_returns(data) if name == "return" and how.x == STEPS else None
    if returns is not None:
        axes.plot(returns, label=grid.RANDOM_PLAYER, **grid.RANDOM_LOOK)
    ends = [float(curve.runs.index.max()) for curve in (*curves, *others)]
    if how.x == STEPS:
        ends.append(data.budget)
    axes.set_xlim(0, max(ends))
    if is_share and not how.log:
        top = min(max(axes.get_ylim()[1], 0.01), 1 + grid.BELOW_ZERO)
        axes.set_ylim(-grid.BELOW_ZERO * top, top)


def _draw_bands(
    axes: Axes, curve: Curve, bands: Sequence[str], bounds: tuple[float, float], colour: str
) -> None:
    """Draw the bands of a curve.

    An interval is left out where some runs have no value, because the remaining ones are no fair sample.
    """
    for band in bands:
        frame = curve.frame(band)
        if band == INTERVAL:
            frame[["low", "high"]] = frame[["low", "high"]].where(frame["count"] == curve.runs.shape[1])
        grid.draw_band(axes, frame, bounds, color=colour, alpha=_opacity(band, bands))


def _draw_centre(axes: Axes, curve: Curve, look: Mapping[str, Any], label: str) -> None:
    """Draw the centre of runs, faint where some have no value, and a cross where a run diverged."""
    frame, width = curve.frame(), mpl.rcParams["lines.linewidth"]
    every = max(len(frame) // MARKED_POINTS, 1)
    first = MARKERS.index(look["marker"]) * every // len(MARKERS) % every  # no two meet
    whole = frame["centre"].where(frame["count"] == curve.runs.shape[1])
    (line,) = axes.plot(
        frame["x"], whole, label=label, markersize=2.2 * width, markevery=(first, every), clip_on=False,
        zorder=2.2, **look,
    )  # fmt: skip
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(frame["x"], frame["centre"], color=look["color"], alpha=0.35, zorder=1.5)
    for step, value in curve.stops:
        axes.plot(step, value, "x", color=look["color"], markersize=4 * width)


def _draw_beside(
    axes: Axes, curves: Sequence[Curve], data: StudyData, looks: Mapping[str, Mapping[str, Any]]
) -> None:
    """Draw the runs of another study: in the colours of conditions that have their names, or else in grey."""
    unlike = sum(curve.runs.shape[1] for curve in curves if curve.condition not in looks)
    opacity = min(1.0, MANY_RUNS / len(data.runs))
    for curve in curves:
        colour, label = BESIDE_COLOUR, f"{data.full_title} ({unlike})"
        if curve.condition in looks:
            name = data.study.labels.get(curve.condition, curve.condition)
            colour = looks[curve.condition]["color"]
            label = f"{name}, {data.full_title} ({curve.runs.shape[1]})"
            opacity *= 0.6
        axes.plot(
            curve.runs, label=label, color=colour, alpha=opacity, linewidth=0.7, linestyle=(0, (3, 1)),
            zorder=1.3,
        )  # fmt: skip


def _reach(curves: Iterable[Curve]) -> tuple[float, float]:
    """Return the least and greatest value of any run; 0 if none has a value."""
    values = np.concatenate([curve.runs.to_numpy().ravel() for curve in curves])
    known = values[np.isfinite(values)]
    if not len(known):
        return 0.0, 0.0
    return float(known.min()), float(known.max())


def _shows_runs(curve: Curve, band: str) -> bool:
    """Return whether every run is drawn: if the band says so, runs are few, or it rarely covers the mean."""
    count = curve.runs.shape[1]
    if band in (NO_BAND, RUNS):
        return band == RUNS
    return 1 < count < LEAST_RUNS or count < BANDS[band].enough_runs


def _opacity(band: str, bands: Sequence[str]) -> float:
    return DARK if band != bands[0] or band == INTERVAL else PALE


# --- Words -------------------------------------------------------------------------------------------


def _legend(column: Column, how: Options) -> dict[str, Any]:
    """Return the artists of the legend that describe centre, bands and runs, by their words."""
    words = CENTER_WORDS[how.center]
    entries: dict[str, Any] = {f"{words} of (n) runs": Line2D([], [], color=style.INK, linewidth=1.6)}
    for band in how.bands:
        if any(curve.frame(band)["low"].notna().any() for curve in column.all_curves):
            opacity = _opacity(band, how.bands)
            if band != how.bands[0]:  # one lies in the other
                opacity += PALE
            label = BANDS[band].label.format(center=words)
            entries[label] = Patch(color=style.INK, alpha=opacity, linewidth=0)
    if any(_shows_runs(curve, how.bands[0]) for curve in column.all_curves):
        entries[BANDS[RUNS].label] = Line2D([], [], color=style.INK, linewidth=0.5, alpha=0.5)
    return entries


def _caption(column: Column, how: Options) -> list[str]:
    """Return the notes on a study and on what is drawn of it, the most important first."""
    data, curves = column.data, column.all_curves
    notes = notes_of(data, bool({"return", EVALUATED} & {*column.curves}), column.beside)
    if any(curve.stops for curve in curves):
        notes.append("×: a run diverged, and its curve ends there.")
    if any(_has_gaps(curve) for curve in curves):
        notes.append("Faint, without an interval: some run has no value there.")
    if any(curve.log for curve in curves):
        centres = f"{CENTER_WORDS[how.center]}s and bands"
        notes.append(f"On logarithmic axes {centres} are of logarithms, without values of 0 or below.")
    for name, group in column.curves.items():
        if how.log and not group[0].log:
            notes.append(f"{QUANTITIES[name].title}: no value is above 0, so the axis is linear.")
    notes.append(_missing_band(data, how))
    notes.append(_missing_values(curves))
    if {*column.curves} & {*EPISODE_QUANTITIES}:
        notes.append(f"Returns and lengths: {_window(data, how)}.")
    if {*column.curves} & {*UPDATE_QUANTITIES}:
        notes.append(f"Updates: {OF_BUDGET}.")
    if column.beside and column.beside.averaged_over is not None:
        name = column.beside.study.name
        notes.append(f"{name}: {_window(column.beside, how)}. The environment of {name} is not recorded.")
    return [*notes, X_NOTES[how.x]]


def _window(data: StudyData, how: Options) -> str:
    """Return what a point of a study's returns is the mean of."""
    if data.averaged_over == 1:
        return "as logged"
    if data.averaged_over or (how.window or data.windows[0]) == TRAILING_WINDOW:
        return f"mean of the last {data.averaged_over or 100} episodes"
    return OF_BUDGET


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run that did not diverge lacks a value after all had one."""
    whole = np.flatnonzero(curve.runs.notna().all(axis=1))
    return not curve.stops and len(whole) > 0 and len(whole) < len(curve.runs) - whole[0]


def _missing_band(data: StudyData, how: Options) -> str:
    """Return which conditions have too few runs for a band that was asked for."""
    if how.band is None:
        return ""
    least = BANDS[how.bands[0]].least_runs
    few: list[str] = []
    for name in shown_conditions([data]):
        runs = len(data.of_condition(name))
        if runs < least:
            few.append(f"{name} ({counted(runs, 'run')})")
    if not few:
        return ""
    return f"The band {how.band} needs {counted(least, 'run')}, and is not drawn for {', '.join(few)}."


def _missing_values(curves: Sequence[Curve]) -> str:
    """Return how many runs of which conditions have no value in some panel."""
    blank: dict[str, int] = {}
    for curve in curves:
        count = int(curve.values.isna().all().sum())
        if count:
            blank[curve.condition] = max(count, blank.get(curve.condition, 0))
    if not blank:
        return ""
    counts = [f"{count} of {name}" for name, count in blank.items()]
    if len(counts) > MOST_NAMED:
        counts = [f"of {len(blank)} conditions"]
    return f"Some runs have no value in a panel, and count in no mean there: {', '.join(counts)}."


# --- Scores over several environments ------------------------------------------------------------------


def profile_page(data: StudyData, parts: Parts, outcome: str = OUTCOME) -> Page:
    """Return performance profiles (Agarwal et al. 2021): the share of runs above each score.

    Scores are those of `pneuma.analysis.environments.scores`, over all environments together.
    """
    table, looks = profiles(parts, outcome), looks_of([*parts.values()])

    def draw(axes: Axes) -> None:
        for condition, frame in table.groupby("condition", sort=False):
            colour = looks[str(condition)]["color"]
            grid.draw_band(axes, frame, (0, 1), color=colour, alpha=PALE)
            label = f"{condition} ({frame['runs'].iloc[0]})"
            axes.plot(frame["x"], frame["centre"], color=colour, label=label)
        axes.set(xlim=(table["x"].min(), table["x"].max()), ylim=(0, 1 + grid.BELOW_ZERO))

    panel = Panel(draw, x="Score", y="Share of runs above it", y_kind=SHARES)
    scales: list[str] = []
    for env, (low, high) in references(parts, outcome).items():
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
