"""One panel of curves: means over runs in their bands, and what is said of them.

StudyData, quantities, band → Column → a Panel for each quantity, legend, notes
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pneuma.analysis import BAND_NAMES
from pneuma.analysis.curves import BANDS, Curve, curve_names, random_levels, study_curves
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import without_monsters
from pneuma.analysis.study_data import StudyData
from pneuma.env.fields import ACTION_NAMES
from pneuma.errors import UserError
from pneuma.figures import grid, style
from pneuma.figures.grid import Panel
from pneuma.figures.words import label_of, notes_of, styles_of
from pneuma.study.quantities import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.study.series import SLACK

_, TRAILING_WINDOW = WINDOWS
USUAL_BAND, INTERVAL, RUNS, NO_BAND = BAND_NAMES[0], "ci", "runs", "none"
PALE, DARK = 0.13, 0.30
"""Opacity of a band, and of the interval of the mean inside it."""
MOST_AT_ENDS, LONGEST_AT_END = 5, 16
"""Most lines of a panel whose names are at their ends, and most letters in a line of such a name."""
MARKED_POINTS = 8
"""Markers per line, so that lines can be told apart in grey where their names are in the legend."""
MANY_RUNS = 30
"""With this many runs in a panel, their lines are fainter, so that means stay in front."""
MOST_NAMED = 3
"""Most conditions that the caption names."""
BESIDE_COLOUR, MOST_BESIDE = "#404040", 12
"""Of the runs of another study, and most of its conditions that are named at their ends."""


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
    "evaluated_return": Quantity("Return in evaluation", "Return of an episode"),
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


@dataclass(frozen=True)
class Column:
    """A study's curves, and how they are drawn.

    Attributes:
        window: of the study's windows; None for the first.
        beside: a study whose runs are drawn as dashed lines.
        log: whether all axes of values are logarithmic, and not only those of quantities that go through
            powers of ten.
        labels: names of conditions in the legend, if not with the number of their runs.
    """

    data: StudyData
    quantities: Sequence[str]
    band: str = USUAL_BAND
    window: str | None = None
    beside: StudyData | None = None
    labels: Mapping[str, str] | None = None
    log: bool = False

    def is_log(self, name: str) -> bool:
        return self.log or QUANTITIES[name].log

    @cached_property
    def curves(self) -> dict[str, list[Curve]]:
        """The curves of each quantity; on a logarithmic axis, means and bands are of logarithms."""
        found = study_curves(self.data, self.quantities, self.window)
        return {
            name: [replace(curve, log=self.is_log(name)) for curve in group] for name, group in found.items()
        }

    @cached_property
    def others(self) -> dict[str, list[Curve]]:
        if self.beside is None:
            return {}
        window = self.window if self.window in self.beside.windows else self.beside.windows[0]
        known = [name for name in self.quantities if name in curve_names(self.beside)]
        if not known:
            names = " or ".join(self.quantities)
            raise UserError(f"study {self.beside.study.name} has no {names} to draw beside")
        return study_curves(self.beside, known, window)

    @cached_property
    def styles(self) -> dict[str, dict[str, Any]]:
        return styles_of(self.data)

    @cached_property
    def at_ends(self) -> bool:
        """Whether the names of lines are at their ends, and not in the legend."""
        names = [name for name in self.data.conditions if self.data.of_condition(name)]
        longest = max(len(word) for name in names for word in name.split())
        few = len(names) <= MOST_AT_ENDS and longest <= LONGEST_AT_END
        return few and not self.beside and self.labels is None

    def panel(self, name: str) -> Panel:
        of, label = QUANTITIES[name], QUANTITIES[name].label
        if self.data.averaged_over:  # in the log
            label = label.replace(" of an episode", f", mean of {self.data.averaged_over} episodes")
        title = of.title
        if name.startswith("action_") and without_monsters(self.data):
            title = f"Share of action {name.removeprefix('action_')}"
        numbers: grid.Ticks = grid.shares if of.percent else grid.numbers
        if self.is_log(name) and self._highest(name) > 0:
            numbers = grid.powers
        return Panel(
            partial(_draw, column=self, name=name), title, "Environment steps", label, grid.steps, numbers
        )

    def _highest(self, name: str) -> float:
        drawn = [*self.curves[name], *self.others.get(name, ())]
        values = np.concatenate([curve.runs.ravel() for curve in drawn])
        return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0

    @property
    def meanings(self) -> dict[str, Any]:
        drawn = [*chain.from_iterable(self.curves.values())]
        bands = [band for band in self.bands if any(_shows_band(curve, band) for curve in drawn)]
        found: dict[str, Any] = {"mean of (n) runs": Line2D([], [], color=style.INK, linewidth=1.6)}
        for band in bands:
            shade = PALE + DARK if band == INTERVAL else PALE  # an interval lies in a band
            found[BANDS[band].label] = Patch(color=style.INK, alpha=shade, linewidth=0)
        if any(_shows_runs(curve, self.band) for curve in drawn):
            found[BANDS[RUNS].label] = Line2D([], [], color=style.INK, linewidth=0.5, alpha=0.5)
        return found

    @property
    def bands(self) -> list[str]:
        """What is drawn around means: in a deviation there is the interval of the mean."""
        return [self.band, INTERVAL] if self.band == USUAL_BAND else [self.band]

    @property
    def notes(self) -> list[str]:
        returns, window = "return" in self.curves, self.window or self.data.windows[0]
        log = any(self.is_log(name) and self._highest(name) > 0 for name in self.curves)
        return [*notes_of(self.data, returns, self.beside), *_caption(self.data, self.curves, window, log)]


# --- What is drawn -----------------------------------------------------------------------------------


def _draw(axes: Axes, column: Column, name: str) -> None:
    data, curves, percent = column.data, column.curves[name], QUANTITIES[name].percent
    lines = sum(len(curve.runs) for curve in curves if _shows_runs(curve, column.band))
    for curve in curves:
        _draw_bands(axes, curve, column, percent, min(1.0, MANY_RUNS / max(lines, 1)))
        _draw_mean(axes, curve, column)
    if column.beside:
        alpha = min(1.0, MANY_RUNS / len(column.beside.runs))
        look: Any = {"color": BESIDE_COLOUR, "linewidth": 0.7, "linestyle": (0, (3, 1)), "zorder": 1.3}
        for curve in column.others.get(name, ()):
            label = f"{column.beside.full_title} ({len(column.beside.runs)})"
            axes.plot(curve.step, curve.runs.T, label=label, alpha=alpha, **look)
            if len(column.beside.conditions) <= MOST_BESIDE:
                _name_end(axes, curve, curve.condition, BESIDE_COLOUR)
    colours = {condition: look["color"] for condition, look in column.styles.items()}
    grid.draw_random_player(axes, random_levels(data, name), column._highest(name), colours)
    axes.set_xlim(0, max(data.budget, column.beside.budget if column.beside else 0))
    if percent and not column.log:
        top = min(max(axes.get_ylim()[1], 0.01), 1 + grid.BELOW_ZERO)
        axes.set_ylim(-grid.BELOW_ZERO * top, top)


def _shows_runs(curve: Curve, band: str) -> bool:
    """Return whether every run is drawn: if the band says so, runs are few, or it rarely covers the mean."""
    count = len(curve.runs)
    if band == NO_BAND:
        return False
    return band == RUNS or 1 < count < LEAST_RUNS or count < BANDS[band].enough_runs


def _shows_band(curve: Curve, band: str) -> bool:
    return band not in (RUNS, NO_BAND) and len(curve.runs) >= BANDS[band].least_runs


def _draw_bands(axes: Axes, curve: Curve, column: Column, percent: bool, alpha: float) -> None:
    """Draw the bands, shares within 0 and 1, and runs as thin lines if they are shown.

    An interval is left out where some runs have no value, as the remaining ones are no fair sample.
    """
    colour, whole = column.styles[curve.condition]["color"], curve.count == len(curve.runs)
    for band in column.bands:
        if _shows_band(curve, band):
            low, high = curve.band(band)
            if percent:
                low, high = np.clip(low, 0, 1), np.clip(high, 0, 1)
            low = np.where(whole, low, np.nan) if band == INTERVAL else low
            shade = DARK if band == INTERVAL else PALE
            axes.fill_between(curve.step, low, high, color=colour, alpha=shade, linewidth=0)
    if _shows_runs(curve, column.band):
        width = 0.3 * mpl.rcParams["lines.linewidth"]
        axes.plot(curve.step, curve.runs.T, color=colour, linewidth=width, alpha=0.4 * alpha, zorder=1.4)


def _draw_mean(axes: Axes, curve: Curve, column: Column) -> None:
    """Draw the mean over runs, faint where some have no value, and a cross where a run diverged."""
    name, look, width = curve.condition, column.styles[curve.condition], mpl.rcParams["lines.linewidth"]
    in_legend = not column.at_ends
    every = max(len(curve.step) // MARKED_POINTS, 1)
    first = style.MARKERS.index(look["marker"]) * every // len(style.MARKERS) % every  # no two meet
    label = (column.labels or {}).get(name) or label_of(column.data, name)
    whole = np.where(curve.count == len(curve.runs), curve.mean, np.nan)
    (line,) = axes.plot(
        curve.step, whole, label=label if in_legend else "", color=look["color"], clip_on=False,
        marker=look["marker"] if in_legend else "", markersize=2.2 * width, markevery=(first, every),
        zorder=2.2,
    )  # fmt: skip
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(curve.step, curve.mean, color=look["color"], alpha=0.35, zorder=1.5)
    for step, value in curve.stops:
        axes.plot(step, value, "x", color=look["color"], markersize=4 * width)
    if column.at_ends:
        _name_end(axes, curve, label, look["color"], column.data.budget)


def _name_end(axes: Axes, curve: Curve, name: str, colour: str, budget: int = 0) -> None:
    """Write a name at the end of a mean: at the panel's edge, or where it ends before the budget."""
    if not (known := np.isfinite(curve.mean)).any():
        return
    step, value = curve.step[known][-1], curve.mean[known][-1]
    early = step < (1 - SLACK) * budget
    axes.annotate(
        fill(name, LONGEST_AT_END, break_long_words=False), (step if early else 1, value), (3, 0),
        "data" if early else ("axes fraction", "data"), "offset points", color=colour,
        fontsize=0.85 * style.TYPE_POINTS, va="center", gid=style.END, annotation_clip=False,
    )  # fmt: skip


# --- Words -------------------------------------------------------------------------------------------


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run that did not diverge lacks a value after all had one."""
    whole = np.flatnonzero(curve.count == len(curve.runs))
    return not curve.stops and len(whole) > 0 and len(whole) < len(curve.count) - whole[0]


def _caption(data: StudyData, curves: Mapping[str, Sequence[Curve]], window: str, log: bool) -> list[str]:
    every = [*chain.from_iterable(curves.values())]
    notes = ["×: a run diverged, and its curve ends there."] * any(curve.stops for curve in every)
    notes += ["Faint, without an interval: some run has no value there."] * any(map(_has_gaps, every))
    if log:
        notes.append("On logarithmic axes means and bands are of logarithms, without values of 0.")
    blank: dict[str, int] = {}
    for curve in every:
        if count := int((~np.isfinite(curve.runs)).all(axis=1).sum()):
            blank[curve.condition] = max(count, blank.get(curve.condition, 0))
    if blank:
        of = ", ".join(f"{count} of {name}" for name, count in blank.items())
        whose = of if len(blank) <= MOST_NAMED else f"of {len(blank)} conditions"
        notes.append(f"Some runs have no value in a panel, and count in no mean there: {whose}.")
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
