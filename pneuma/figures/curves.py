"""The curves of a study: one panel per quantity, or per condition if there are many.

A line is the mean over runs; the legend describes its band. With more conditions than `MOST_IN_A_PANEL`, each
has a small panel with the other means behind it.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter, MaxNLocator, NullFormatter, NullLocator

from pneuma.analysis import BAND_NAMES
from pneuma.analysis.curves import BANDS, Curve, curve_names, random_level, study_curves
from pneuma.analysis.frames import StudyData, common_step, figure_basename, step_words
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import have_one_return, without_monsters
from pneuma.env_fields import ACTION_NAMES
from pneuma.errors import UserError, counted, unknown_name
from pneuma.figures import panels, style
from pneuma.figures.origin import origin_of
from pneuma.study.quantities import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS

_, TRAILING_WINDOW = WINDOWS
AS_IN_THESIS: dict[str, Any] = {"quantities": ("return",), "band": "minmax", "window": TRAILING_WINDOW}
"""As the author's script drew: the least and the greatest run."""
USUAL_QUANTITIES = ("share_killed", "success", "return")
MOST_CURVES = 40
"""Most conditions whose curves fit a page; with more, a summary is drawn."""
MOST_OTHERS = 24
"""With at most this many panels, each shows the other means in grey."""
LONGEST_INCHES = 7.6
"""Most inches of small panels, so that a figure fits a page, unless there are too many."""
MARKED_POINTS = 8
"""Markers per line, so that lines can be told apart in grey."""
MANY_RUNS = 30
"""With this many runs in a panel, their lines are fainter, so that means stay in front."""
FEW_POINTS = 0.05
"""Up to this share of a curve's points may lack some runs before the caption says so."""
LONG_AXIS = 5000
"""An axis longer than this has numbers with a k."""
OTHERS_COLOUR, BESIDE_COLOUR = "#C4C4C4", "#404040"

Curves = Mapping[str, Sequence[Curve]]


@dataclass(frozen=True)
class Drawing:
    """How a figure of curves is drawn, with all choices made."""

    quantities: tuple[str, ...]
    band: str
    window: str


def draw_study(
    data: StudyData,
    folder: Path,
    drawing: Drawing | None = None,
    formats: tuple[str, ...] = ("png", "svg"),
    *,
    shown: str = "",
    beside: StudyData | None = None,
    command: str = "",
) -> list[Path]:
    """Draw the curves of a study's finished runs and return the files written.

    `shown` is the end of the headline. Runs of `beside` are drawn as dashed lines. `command` draws the figure
    again.

    Raises:
        UserError: for a quantity that the study's data does not have; and, if each condition has a panel, for
            several quantities or another study beside it.
    """
    drawing = drawing or settle(data)
    many = len(data.conditions) > style.MOST_IN_A_PANEL
    if many and (beside or len(drawing.quantities) > 1):
        reason = f"each of the {len(data.conditions)} conditions has a panel"
        raise UserError(f"study {data.study}: {reason}, so draw one --quantity, and nothing beside it")
    curves = study_curves(data, drawing.quantities, drawing.window)
    with style.house_style():
        figure = Figure(layout="constrained")
        if many:
            inches, named = _draw_conditions(figure, data, curves, drawing.band)
        else:
            inches, named = _draw_quantities(figure, data, curves, drawing, beside), ""
        caption = [
            *panels.notes_of(data, "return" in curves, beside),
            *_caption(data, curves, drawing.window),
            named,
        ]
        meaning = _meaning([curve for group in curves.values() for curve in group], drawing.band)
        panels.put_texts(
            figure,
            inches,
            panels.headline_of(data, shown),
            panels.legend_entries(figure.axes),
            caption,
            meaning,
        )
        stem = file_stem(data, drawing, beside.study if beside else None)
        origin = origin_of(command, *filter(None, (data, beside)))
        return style.save_figure(figure, folder, stem, formats, origin)


def settle(
    data: StudyData, band: str | None = None, window: str | None = None, quantities: str | Sequence[str] = ()
) -> Drawing:
    """Return how to draw a study, given the user's choices.

    Args:
        data: the study.
        band: one of `BANDS`; default: Student's interval.
        window: one of the study's windows; default: the first.
        quantities: of `curve_names`; default: the share killed and the return, as far as recorded, and only
            the first of them if each condition has a panel. If returns are of different rewards, the length
            of episodes replaces them.
    """
    window = data.checked_window(window)
    if band is not None:
        _check_band(data, band)
    names = tuple(dict.fromkeys([quantities] if isinstance(quantities, str) else quantities))
    if not names:
        known = curve_names(data)
        wanted = USUAL_QUANTITIES if have_one_return(data) else ("share_killed", "success", "length")
        names = tuple(name for name in wanted if name in known) or (*known[:1],) or ("return",)
        names = names[:1] if len(data.conditions) > style.MOST_IN_A_PANEL else names
    if not set(names) & set(EPISODE_QUANTITIES):
        window = data.windows[0]  # no drawn quantity depends on the window
    return Drawing(names, band or BAND_NAMES[0], window)


def _check_band(data: StudyData, band: str) -> None:
    """Refuse a band that could not be drawn, as runs are too few."""
    if band not in BANDS:
        raise unknown_name("band", band, BANDS)
    for name in data.conditions:
        if 0 < (count := len(data.of_condition(name))) < BANDS[band].least_runs:
            runs, least = counted(count, "run"), BANDS[band].least_runs
            raise UserError(f"--band {band}: {name} has {runs}, and it needs {least}; try --band std or runs")


def file_stem(data: StudyData, drawing: Drawing, beside: str | None = None) -> str:
    """Return the name of a figure's files: the study's figure, and how this one differs from the usual."""
    usual, differs = settle(data), []
    if drawing.quantities != usual.quantities:
        every = list(drawing.quantities) == curve_names(data)
        differs.append("all" if every else "-".join(drawing.quantities))
    differs += [drawing.band] * (drawing.band != usual.band)
    differs += [drawing.window.removesuffix("%")] * (drawing.window != data.windows[0])
    return figure_basename(data, *differs, *(["beside", beside] if beside else []))


# --- Panels ------------------------------------------------------------------------------------------


def _draw_quantities(
    figure: Figure, data: StudyData, curves: Curves, drawing: Drawing, beside: StudyData | None
) -> float:
    """Draw one panel with all conditions for each quantity; return the total height in inches."""
    rows = -(-len(curves) // style.COLUMNS)
    columns = -(-len(curves) // rows)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    width = style.characters(1.2 * style.TYPE_POINTS, style.WIDTH / columns)  # bold letters are wider
    labels = {name: panels.label_of(data, name) for name in data.conditions if data.of_condition(name)}
    looks = panels.looks_of(data)
    others: Curves = {}
    if beside:
        window = drawing.window if drawing.window in beside.windows else beside.windows[0]
        named = [name for name in drawing.quantities if name in curve_names(beside)]
        if not named:
            raise UserError(f"study {beside.study} has no {' or '.join(drawing.quantities)} to draw beside")
        others = study_curves(beside, named, window)
    faint = min(1.0, MANY_RUNS / max(len(beside.runs) if beside else 1, 1))
    for axes, (name, group) in zip(grid, curves.items(), strict=False):
        _draw_means(axes, name, group, drawing.band, looks, labels)
        for curve in others.get(name, ()):
            look: Any = {"color": BESIDE_COLOUR, "linewidth": 0.7, "linestyle": (0, (3, 1)), "zorder": 1.3}
            axes.plot(
                curve.step, curve.runs.T, label=beside.full_title if beside else "", alpha=faint, **look
            )
        _draw_around(axes, data, name, [*group, *others.get(name, ())])
        if beside:
            axes.set_xlim(0, max(data.budget, beside.budget))
        label, title = QUANTITIES[name].label, QUANTITIES[name].title
        if name.startswith("action_") and without_monsters(data):
            title = f"Share of action {name.removeprefix('action_')}"
        if data.averaged_over:  # in the log
            label = label.replace(" of an episode", f", mean of {data.averaged_over} episodes")
        axes.set(title=textwrap.fill(title, width), ylabel=label, xlabel="Environment steps")
    for axes in grid[len(curves) :]:
        axes.remove()
    return rows * style.PANEL_INCHES * (1.2 if columns == 1 else 1)


def _draw_conditions(figure: Figure, data: StudyData, curves: Curves, band: str) -> tuple[float, str]:
    """Draw a small panel for each condition; return the total height, and what their names consist of."""
    ((name, group),) = curves.items()
    names, parts = style.short_names([curve.condition for curve in group])
    widths = {
        each: style.characters(0.83 * style.TYPE_POINTS, 0.9 * style.WIDTH / each)
        for each in range(2 * style.COLUMNS, style.COLUMNS - 1, -1)
    }
    longest = max(len(word) for name in names.values() for word in name.split())
    fitting = [each for each, width in widths.items() if width >= longest] or [style.COLUMNS]
    columns = min(fitting, key=lambda each: -len(group) % each)
    rows, width = -(-len(group) // columns), widths[columns]
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).ravel()
    looks = {condition: {**look, "marker": ""} for condition, look in panels.looks_of(data).items()}
    behind: Any = {"color": OTHERS_COLOUR, "linewidth": 0.08 * style.TYPE_POINTS, "zorder": 1.1}
    title_lines = 1
    for place, (axes, curve) in enumerate(zip(grid, group, strict=False)):
        for other in group if len(group) <= MOST_OTHERS else ():
            axes.plot(other.step, other.mean, label="all others", **behind)
        _draw_means(axes, name, [curve], band, looks, {})
        _draw_around(axes, data, name, group)
        label = panels.label_of(data, curve.condition, names[curve.condition]).replace(" = ", "=")
        title = textwrap.wrap(label, width)
        title_lines = max(title_lines, len(title))
        axes.set_title("\n".join(title), fontsize="small", weight="normal", pad=2)
        lowest, leftmost = place + columns >= len(group), place % columns == 0
        axes.tick_params(labelbottom=lowest, labelsize="small")
        axes.set_xlabel("Steps" if lowest else "", fontsize="small")
        axes.set_ylabel(QUANTITIES[name].label if leftmost else "", fontsize="small")
    for axes in grid[len(group) :]:
        axes.set_axis_off()
    grid[0].xaxis.set_major_locator(panels.round_ticks(3))
    title_inches = 0.85 * style.LINE_INCHES * title_lines
    panel_inches = max(0.3, min(1.1, LONGEST_INCHES / rows - title_inches))
    return rows * (panel_inches + title_inches) + 0.4, parts and f"Panels: {parts}."


# --- One panel ---------------------------------------------------------------------------------------


class Quantity(NamedTuple):
    title: str
    label: str
    percent: bool = False
    log: bool = False


QUANTITIES = {
    "share_killed": Quantity("Monsters killed in evaluation", "Share killed", percent=True),
    "argmax_share_killed": Quantity("Monsters killed, likeliest actions", "Share killed", percent=True),
    "score": Quantity("Normalised score in evaluation", "0 random player, 1 all killed"),
    "success": Quantity("Successes in evaluation", "Share of episodes", percent=True),
    "return": Quantity("Return in training", "Return of an episode"),
    "length": Quantity("Length of episodes in training", "Steps of an episode"),
    "kills": Quantity("Monsters killed in training", "Kills of an episode"),
    "hp": Quantity("HP left in training", "HP at the end of an episode"),
    "entropy": Quantity("Entropy of the policy", "Entropy (nats)"),
    "grad_norm": Quantity("Gradient norm, unclipped", "L2 norm", log=True),
    "grad_norm_actor": Quantity("Actor's gradient norm", "L2 norm", log=True),
    "grad_norm_critic": Quantity("Critic's gradient norm", "L2 norm", log=True),
    "approx_kl": Quantity("KL divergence", "KL divergence (nats)"),
    "explained_variance": Quantity("Variance of returns explained", "Explained variance"),
    "dead_units": Quantity("Dead hidden units", "Share of units", percent=True),
    **{
        f"action_{number}": Quantity(f"Share of action: {name}", "Share of actions", percent=True)
        for number, name in enumerate(ACTION_NAMES)
    },
}


def _shows_runs(curve: Curve, band: str) -> bool:
    """Return whether every run is drawn: if the band says so, runs are few, or it rarely covers the mean."""
    count = len(curve.runs)
    return BANDS[band].edges is None or 1 < count < LEAST_RUNS or count < BANDS[band].enough_runs


def _shows_band(curve: Curve, band: str) -> bool:
    return BANDS[band].edges is not None and len(curve.runs) >= BANDS[band].least_runs


def _draw_means(
    axes: Axes,
    name: str,
    curves: Sequence[Curve],
    band: str,
    looks: Mapping[str, Mapping[str, Any]],
    labels: Mapping[str, str],
) -> None:
    """Draw means and bands of a quantity, faint where some runs have no value.

    On a logarithmic axis the means are of logarithms. Conditions without a label are not in the legend.
    """
    if QUANTITIES[name].log:
        curves = [replace(curve, log=True) for curve in curves]
    lines = sum(len(curve.runs) for curve in curves if _shows_runs(curve, band))
    alpha = 0.4 * min(1.0, MANY_RUNS / max(lines, 1))
    shade, width = 0.16, mpl.rcParams["lines.linewidth"]
    for curve in curves:
        colour, marker = looks[curve.condition]["color"], looks[curve.condition]["marker"]
        whole = curve.count == len(curve.runs)
        if _shows_band(curve, band):
            low, high = curve.band(band)
            if BANDS[band].enough_runs:  # the remaining runs are no fair sample
                low = np.where(whole, low, np.nan)
            axes.fill_between(curve.step, low, high, color=colour, alpha=shade, linewidth=0)
        if _shows_runs(curve, band):
            axes.plot(curve.step, curve.runs.T, color=colour, linewidth=0.3 * width, alpha=alpha, zorder=1.4)
        every = max(len(curve.step) // MARKED_POINTS, 1)
        first = (
            style.MARKERS.index(marker) * every // len(style.MARKERS) % every if marker else 0
        )  # no two meet
        (line,) = axes.plot(
            curve.step, np.where(whole, curve.mean, np.nan), label=labels.get(curve.condition, ""),
            color=colour, clip_on=False, markersize=2.2 * width, marker=marker, markevery=(first, every),
        )  # fmt: skip
        line.set_in_layout(False)  # it may reach over the edge, and may be empty
        axes.plot(curve.step, curve.mean, color=colour, alpha=0.35, zorder=1.5)
        for step, value in curve.stops:
            axes.plot(step, value, "x", color=colour, markersize=4 * width)


def _draw_around(axes: Axes, data: StudyData, name: str, curves: Sequence[Curve]) -> None:
    """Draw everything but the curves in a panel, and set the limits of its axes."""
    values = np.concatenate([curve.runs.ravel() for curve in curves])
    highest = float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
    panels.draw_random_player(axes, random_level(data, name), highest)
    if (step := common_step(data)) is not None:  # at which conditions of unlike budgets are compared
        axes.axvline(step, color=style.GREY, linewidth=0.9, zorder=1.2)
    axes.set_xlim(0, data.budget)
    panels.set_steps(axes, 5)
    if QUANTITIES[name].log and highest > 0:
        axes.set_yscale("log", nonpositive="clip")
        low, high = axes.get_ylim()
        if high < 10 * low:  # within a decade, powers of ten would label one tick or none
            axes.yaxis.set_major_locator(MaxNLocator(4))
            axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    elif QUANTITIES[name].percent:
        top = min(max(axes.get_ylim()[1], 0.01), 1 + panels.BELOW_ZERO)
        axes.set_ylim(-panels.BELOW_ZERO * top, top)
        panels.set_shares(axes)
    elif np.ptp(axes.get_ylim()) > LONG_AXIS:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))


# --- Words -------------------------------------------------------------------------------------------


def _meaning(drawn: Sequence[Curve], band: str) -> str:
    """Return the legend's words for lines and bands."""
    meanings = ["Mean over n runs"]
    if any(_shows_band(curve, band) for curve in drawn):
        meanings.append(f"band: {BANDS[band].label}")
    if any(_shows_runs(curve, band) for curve in drawn):
        meanings.append("thin lines: runs")
    return "; ".join(meanings)


def _caption(data: StudyData, curves: Curves, window: str) -> list[str]:
    """Return the notes in the caption, the most important first."""
    notes = []
    if any(curve.stops for group in curves.values() for curve in group):
        notes.append("×: a run diverged, and its curve ends there.")
    if step := common_step(data):
        notes.append(f"Upright line: {step:,} steps, {step_words(data)}: compare there.")
    logarithmic = [curve for name, group in curves.items() if QUANTITIES[name].log for curve in group]
    if logarithmic:
        notes.append("On logarithmic axes means and bands are of logarithms.")
    if at_zero := sum(int((curve.runs <= 0).any(axis=1).sum()) for curve in logarithmic):
        notes.append(f"{at_zero} curves of runs reach 0, which this axis cannot show: means lack them.")
    partly = ((c.count > 0) & (c.count < len(c.runs)) for group in curves.values() for c in group)
    if any(points.mean() > FEW_POINTS for points in partly):
        notes.append("Pale: means of those runs that have a value there.")
    lacking: dict[str, list[str]] = {}
    for name, group in curves.items():
        for curve in group:
            if blank := int((~np.isfinite(curve.runs)).all(axis=1).sum()):
                of = f"{blank} of {len(curve.runs)} runs of {curve.condition}"
                lacking.setdefault(of, []).append(name.replace("_", " "))
    for of, names in lacking.items():
        what = f"{names[0]} and {len(names) - 1} more" if len(names) > 2 else " and ".join(names)
        notes.append(f"{of} have no {what}, and count in no mean of it.")
    averaged, of_budget = [], "in the 5 % of the budget before each point"
    if {*curves} & {*EPISODE_QUANTITIES}:
        last = f"the last {data.averaged_over or 100} episodes"
        trailing = last if window == TRAILING_WINDOW else f"the episodes {of_budget}"
        averaged.append(f"{last}, as Stable-Baselines3 logs them" if data.averaged_over else trailing)
    if {*curves} & {*UPDATE_QUANTITIES}:
        averaged.append(f"the updates {of_budget}")
    if averaged:
        notes.append(f"Training curves average {', or '.join(averaged)}.")
    return notes
