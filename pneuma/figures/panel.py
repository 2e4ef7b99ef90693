"""One panel of curves: lines, bands, runs, where runs diverged, and what players of known skill do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, FuncFormatter, MaxNLocator, NullLocator

from pneuma.analysis.bands import BANDS
from pneuma.analysis.coverage import is_trusted
from pneuma.analysis.curves import Curve, LogCurve
from pneuma.analysis.tables import StudyData
from pneuma.figures.quantities import Look
from pneuma.figures.style import MARKERS

MARKED_POINTS = 8
"""About so many markers a line, so that lines are told apart in grey."""
FAR = 3.0
"""How many times as high as the highest point a level is for its line to be left out."""
RUN_WIDTH, RUN_ALPHA = 0.2, 0.4
"""Of a single run's line, in widths of a mean's: there may be thirty behind one mean."""
MANY_RUNS = 30
"""From which number of runs in a panel on their lines are fainter, so that means stay in front."""
MOST_LOG_TICKS = 4
BELOW_ZERO = 0.02
"""How far an axis of shares reaches below 0, in parts of what it reaches above."""
ABOVE_ALL = 1 + BELOW_ZERO
"""How far it reaches at most: there is no more than all."""
LONG_AXIS = 5000
"""From which length on an axis' numbers are written with a k."""
REFERENCE_DASHES = {"random player": (0, (1, 2)), "scripted hunter": (0, (4, 2, 1, 2))}


def draw_curve(
    axes: Axes,
    curve: Curve,
    band: str,
    look: Mapping[str, Any],
    label: str = "",
    shade: float = 0.16,
    runs_alpha: float = RUN_ALPHA,
) -> None:
    """Draw a condition's mean and band, faint where not all of its runs have a value.

    Args:
        axes: where.
        curve: what; runs that diverged end in a cross.
        band: one of `BANDS`; where it covers the mean too rarely, the runs are drawn as well.
        look: of the condition, as `condition_looks` gives it.
        label: for the legend; '' for none.
        shade: of the band, 0 to 1: lighter where many overlap.
        runs_alpha: of single runs' lines, 0 to 1, as `alpha_of_runs` gives it.
    """
    colour, width = look["color"], mpl.rcParams["lines.linewidth"]
    marks = {"markersize": 1.7 * width, "markevery": _marked(len(curve.step), look["marker"])}
    low, high = curve.band(band)
    if BANDS[band].about_mean:  # those that are left where others diverged are no sample
        low = np.where(curve.count == len(curve.runs), low, np.nan)
    axes.fill_between(curve.step, low, high, color=colour, alpha=shade, linewidth=0)
    if shows_runs(curve, band):
        for run in curve.runs:
            thin = {"linewidth": RUN_WIDTH * width, "alpha": runs_alpha, "zorder": 1.4}
            axes.plot(curve.step, run, color=colour, **thin)
    of_all = np.where(curve.count == len(curve.runs), curve.mean, np.nan)
    (line,) = axes.plot(curve.step, of_all, label=label, clip_on=False, **marks, **look)
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(curve.step, curve.mean, alpha=0.35, zorder=1.5, **marks, **look)
    for step, value in curve.stops:
        axes.plot(step, value, "x", color=colour, markersize=3.4 * width, markeredgewidth=0.8 * width)


def as_drawn(look: Look, curves: Sequence[Curve]) -> list[Curve]:
    """Return curves as their axis has them: on a logarithmic one with means and bands of logarithms."""
    if not is_log(look, curves):
        return list(curves)
    return [LogCurve(curve.condition, curve.step, curve.runs, curve.diverged) for curve in curves]


def alpha_of_runs(curves: Sequence[Curve], band: str) -> float:
    """Return how faint single runs' lines are where so many share a panel."""
    lines = sum(len(curve.runs) for curve in curves if shows_runs(curve, band))
    return RUN_ALPHA * min(1.0, MANY_RUNS / max(lines, 1))


def shows_runs(curve: Curve, band: str) -> bool:
    """Tell whether every run is drawn: where that is the band, or it covers the mean too rarely."""
    return BANDS[band].edges is None or (len(curve.runs) > 1 and not is_trusted(band, len(curve.runs)))


def label_of(data: StudyData, curve: Curve) -> str:
    """Return a condition's words in the legend: its name, and of how many runs."""
    runs = data.of_condition(curve.condition)
    longest = max(run.budget for run in runs)  # other conditions may go further
    at_end = sum(run.status == "done" and run.end >= longest for run in runs)
    fewer = f", {at_end} at the end" if at_end < len(runs) else ""
    return f"{curve.condition} (n = {len(runs)}{fewer})"


def draw_references(axes: Axes, levels: Mapping[str, float], top: float, upright: bool = False) -> None:
    """Draw the levels of players of known skill as grey lines.

    One that is so far above the highest point that its line would flatten it is the caption's to tell.

    Args:
        axes: where.
        levels: of each player.
        top: the highest point that is drawn.
        upright: whether levels are on the horizontal axis.
    """
    far = far_references(levels, top)
    draw = axes.axvline if upright else axes.axhline
    for name, level in levels.items():
        if name not in far:
            dashes = REFERENCE_DASHES[name]
            draw(level, color="#666666", linestyle=dashes, linewidth=0.9, label=name, zorder=1.2)


def far_references(levels: Mapping[str, float], top: float) -> dict[str, float]:
    """Return the levels so far above the highest point drawn that their lines would flatten it."""
    if not np.isfinite(top):
        return {}
    return {name: level for name, level in levels.items() if level > FAR * max(top, 0.01)}


def highest_point(curves: Sequence[Curve]) -> float:
    """Return the highest point of any run, which no panel's axis ends below; -inf where there is none."""
    values = np.concatenate([[-np.inf], *(curve.runs.ravel() for curve in curves)])
    return float(np.nanmax(values))


def draw_common_step(axes: Axes, step: float | None) -> None:
    """Draw the step at which conditions of different budgets are compared; nothing where all are the same."""
    if step is not None:
        axes.axvline(step, color="#666666", linewidth=0.9, zorder=1.2)


def set_axes(axes: Axes, look: Look, budget: int, curves: Sequence[Curve]) -> None:
    """Set what both axes run over and how their ticks read; titles and labels are the caller's."""
    axes.set_xlim(0, budget)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if is_log(look, curves):
        axes.set_yscale("log", nonpositive="clip")
        axes.set_ylim(_positive(curves).min() / 1.5, None)
        axes.yaxis.set_major_formatter(FuncFormatter(_power_of_ten))
        axes.yaxis.set_minor_locator(NullLocator())
    elif look.percent:
        top = min(max(axes.get_ylim()[1], 0.01), ABOVE_ALL)  # a band of two runs may reach far beyond all
        axes.set_ylim(-BELOW_ZERO * top, top)  # what is 0 throughout is still seen
        axes.yaxis.set_major_locator(whole_ticks(6))
        axes.yaxis.set_major_formatter(FuncFormatter(per_cent))
    else:
        shorten_thousands(axes)


def shorten_thousands(axes: Axes) -> None:
    """Write 5k for 5000 on an upright axis that is long."""
    if np.ptp(axes.get_ylim()) > LONG_AXIS:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))


def whole_ticks(most: int) -> MaxNLocator:
    """Return what places few ticks at round numbers, whose labels do not meet."""
    return MaxNLocator(most, steps=[1, 2, 5, 10])


def log_ticks(low: float, high: float) -> list[float]:
    """Return few round numbers between two positive ones for a logarithmic axis, or these two."""
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    powers = [float(f"1e{power}") for power in range(first, last + 1)]
    steps = [float(f"{digit}e{power}") for power in range(first, last + 1) for digit in (1, 2, 5)]
    for candidates in (powers, steps):
        within = [value for value in candidates if low <= value <= high]
        if len(within) > 1:
            return within[:: -(-len(within) // MOST_LOG_TICKS)]
    return [low, high]


def is_log(look: Look, curves: Sequence[Curve]) -> bool:
    """Tell whether a vertical axis is logarithmic: where a quantity asks for it and spans a power of ten."""
    values = _positive(curves)
    return look.log and len(values) > 0 and bool(values.max() >= 10 * values.min())


def _positive(curves: Sequence[Curve]) -> np.ndarray:
    values = np.concatenate([[], *(curve.runs.ravel() for curve in curves)])
    return values[np.isfinite(values) & (values > 0)]


def _power_of_ten(value: float, _: Any) -> str:
    return "10" + str(round(np.log10(value))).translate(_RAISED)


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def per_cent(share: float, _: Any) -> str:
    """Return a share in per cent without idle decimals, for an axis; below 0 there is none."""
    return f"{100 * share:.3g} %" if share >= 0 else ""


def _marked(points: int, marker: str) -> tuple[int, int]:
    """Return the first marked point and the distance to the next; no two kinds of marker fall together."""
    every = max(points // MARKED_POINTS, 1)
    place = MARKERS.index(marker) if marker in MARKERS else 0
    return (place * every // 5) % every + every // 2, every
