"""One study's curves: a centre of its runs in a band for each condition, and what is said of them.

StudyData, quantities, band → Column → a Panel for each quantity, legend, notes
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain
from textwrap import fill
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pandas as pd
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
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import have_one_return, is_foreign
from pneuma.analysis.study_data import StudyData
from pneuma.env.fields import ACTION_NAMES
from pneuma.errors import UserError, counted
from pneuma.figures import grid, style
from pneuma.figures.grid import Panel
from pneuma.figures.words import MOST_NAMED, label_of, notes_of, styles_of
from pneuma.store.quantities import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.store.series import GRID_POINTS, SLACK

USUAL_QUANTITIES, EVALUATED = ("return", "share_killed", "success"), "evaluated_return"
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
LEAST_POINTS = GRID_POINTS // 2
"""With a mean of all runs at fewer points, a curve of training is stubs."""
BESIDE_COLOUR, MOST_BESIDE = "#404040", 12
"""Of the runs of another study, and most of its conditions that are named at their ends."""


X_LABELS = {STEPS: "Environment steps", EPISODES: "Episodes", WALL_CLOCK: "Seconds of training"}
X_NOTES = {
    EPISODES: "Episodes are counted by their mean length up to each point.",
    WALL_CLOCK: "Over time, a run goes on at an even pace.",
}


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
        band: one of `BANDS`; None for the deviation of means, and inside it their interval, or for the
            interval of another centre.
        window: of the study's windows; None for the first.
        beside: a study whose runs are drawn as dashed lines, with the colours of conditions of their names.
        log: whether all axes of values are logarithmic, and not only those of quantities that go through
            powers of ten.
        x: one of `X_AXES`.
        center: one of `CENTERS`.
        labels: names of conditions in the legend, if not with the number of their runs.
        ends: whether names may be at the ends of lines, and not in the legend.
    """

    data: StudyData
    quantities: Sequence[str]
    band: str | None = None
    window: str | None = None
    beside: StudyData | None = None
    log: bool = False
    x: str = STEPS
    center: str = "mean"
    labels: Mapping[str, str] = field(default_factory=dict)
    ends: bool = True

    @cached_property
    def bands(self) -> list[str]:
        """What is drawn around centres: in a deviation of means there is their interval."""
        band = checked_band(self.band or (USUAL_BAND if self.center == "mean" else INTERVAL))
        return [band, INTERVAL] if (band, self.center) == (USUAL_BAND, "mean") else [band]

    @cached_property
    def curves(self) -> dict[str, list[Curve]]:
        """The curves of each quantity; on a logarithmic axis, centres and bands are of logarithms."""
        found = study_curves(self.data, self.quantities, self.window, self.x, self.center)
        return {
            name: [replace(curve, log=self._is_log(name, group)) for curve in group]
            for name, group in found.items()
        }

    def _is_log(self, name: str, curves: Sequence[Curve]) -> bool:
        """Return whether an axis is logarithmic, as it is asked for, or usual, and some value is above 0."""
        return (self.log or QUANTITIES[name].log) and _highest(curves) > 0

    @cached_property
    def others(self) -> dict[str, list[Curve]]:
        if self.beside is None:
            return {}
        window = self.window if self.window in self.beside.windows else self.beside.windows[0]
        known = [name for name in self.quantities if name in curve_names(self.beside)]
        if not known:
            names = " or ".join(self.quantities)
            raise UserError(f"study {self.beside.study.name} has no {names} to draw beside")
        return study_curves(self.beside, known, window, self.x)

    @cached_property
    def styles(self) -> dict[str, dict[str, Any]]:
        return styles_of(self.data)

    @cached_property
    def at_ends(self) -> bool:
        """Whether the names of lines are at their ends, and not in the legend."""
        names = [name for name in self.data.conditions if self.data.of_condition(name)]
        longest = max(len(word) for name in names for word in name.split())
        few = len(names) <= MOST_AT_ENDS and longest <= LONGEST_AT_END
        # over other axes lines end apart, and a name would lie on another line
        return self.ends and few and not self.beside and self.x == STEPS

    def panel(self, name: str) -> Panel:
        of, label = QUANTITIES[name], QUANTITIES[name].label
        if self.data.averaged_over:  # in the log
            episodes = self.data.averaged_over
            words = "as logged" if episodes == 1 else f"mean of {episodes} episodes"
            label = label.replace(" of an episode", f", {words}")
        title = of.title
        if name.startswith("action_") and is_foreign(self.data):
            title = f"Share of action {name.removeprefix('action_')}"
        ticks: grid.Ticks = grid.shares if of.percent else grid.numbers
        if any(curve.log for curve in self.curves[name]):
            ticks = grid.powers
        draw = partial(_draw, column=self, name=name)
        return Panel(draw, title, X_LABELS[self.x], label, grid.steps, ticks)

    @property
    def meanings(self) -> dict[str, Any]:
        drawn = [*chain.from_iterable(self.curves.values())]
        words = CENTER_WORDS[self.center]
        found: dict[str, Any] = {f"{words} of (n) runs": Line2D([], [], color=style.INK, linewidth=1.6)}
        for band in self.bands:
            if any(curve.frame(band)["low"].notna().any() for curve in drawn):
                shade = _shade(band, self.bands) + PALE * (band != self.bands[0])  # one lies in the other
                patch = Patch(color=style.INK, alpha=shade, linewidth=0)
                found[BANDS[band].label.format(center=words)] = patch
        if any(_shows_runs(curve, self.bands[0]) for curve in drawn):
            found[BANDS[RUNS].label] = Line2D([], [], color=style.INK, linewidth=0.5, alpha=0.5)
        return found

    @property
    def notes(self) -> list[str]:
        returns = bool({"return", EVALUATED} & {*self.curves})
        return [*notes_of(self.data, returns, self.beside), *_caption(self)]


def usual_quantities(data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return the quantities of a study's usual figure, or of that with another study beside.

    The return is that of evaluations, where both have it, in environments that are not Pneuma's, and where
    episodes are so long for the budget that a training curve has gaps.
    """
    known = curve_names(data)
    first, *others = USUAL_QUANTITIES
    evaluated = all(EVALUATED in curve_names(study) for study in (data, beside or data))
    if not have_one_return(data):
        first = "length"
    elif evaluated and (is_foreign(data) or _has_stubs(data, first)):
        first = EVALUATED
    return [name for name in (first, *others) if name in known] or known[:1] or ["return"]


def _has_stubs(data: StudyData, quantity: str) -> bool:
    """Return whether in some condition all runs together have values at too few points for a line."""
    if quantity not in curve_names(data):
        return False
    for curve in study_curves(data, [quantity])[quantity]:
        ended = [not diverged for diverged in curve.diverged]
        whole = curve.runs.loc[:, ended].notna().all(axis=1)
        if whole.sum() < LEAST_POINTS:
            return True
    return False


# --- What is drawn -----------------------------------------------------------------------------------


def _draw(axes: Axes, column: Column, name: str) -> None:
    data, curves, percent = column.data, column.curves[name], QUANTITIES[name].percent
    lines = sum(curve.runs.shape[1] for curve in curves if _shows_runs(curve, column.bands[0]))
    others = column.others.get(name, [])
    end = max(float(curve.runs.index.max()) for curve in (*curves, *others))
    end = max(data.budget, end) if column.x == STEPS else end
    for curve in curves:
        _draw_bands(axes, curve, column, percent, min(1.0, MANY_RUNS / max(lines, 1)))
        _draw_centre(axes, curve, column, end)
    colours = {condition: look["color"] for condition, look in column.styles.items()}
    if column.beside:
        _draw_beside(axes, others, column.beside, colours)
    words = grid.per_cent if percent else grid.number
    grid.draw_random_player(
        axes, random_levels(data, name), _highest([*curves, *others]), colours, words=words
    )
    returns = random_returns(data) if name == "return" and column.x == STEPS else None
    if returns is not None:
        axes.plot(returns, label=grid.RANDOM_PLAYER, **grid.RANDOM_LOOK)
    axes.set_xlim(0, end)
    if percent and not column.log:
        top = min(max(axes.get_ylim()[1], 0.01), 1 + grid.BELOW_ZERO)
        axes.set_ylim(-grid.BELOW_ZERO * top, top)


def _draw_beside(axes: Axes, curves: Sequence[Curve], data: StudyData, colours: Mapping[str, str]) -> None:
    """Draw the runs of another study: in the colours of conditions that have their names, or else in grey."""
    look: Any = {"linewidth": 0.7, "linestyle": (0, (3, 1)), "zorder": 1.3}
    alpha = min(1.0, MANY_RUNS / len(data.runs))
    unlike = [curve for curve in curves if curve.condition not in colours]
    for curve in curves:
        if colour := colours.get(curve.condition):
            name = data.study.labels.get(curve.condition, curve.condition)
            label = f"{name}, {data.full_title} ({curve.runs.shape[1]})"
            axes.plot(curve.runs, label=label, color=colour, alpha=0.6 * alpha, **look)
            continue
        label = f"{data.full_title} ({sum(each.runs.shape[1] for each in unlike)})"
        axes.plot(curve.runs, label=label, color=BESIDE_COLOUR, alpha=alpha, **look)
        if len(unlike) <= MOST_BESIDE:
            _name_end(axes, curve.frame(), curve.condition, BESIDE_COLOUR)


def _highest(curves: Sequence[Curve]) -> float:
    """Return the highest value of any run; 0 if none has a value."""
    values = np.concatenate([curve.runs.to_numpy().ravel() for curve in curves])
    return float(np.nanmax(values)) if np.isfinite(values).any() else 0.0


def _shows_runs(curve: Curve, band: str) -> bool:
    """Return whether every run is drawn: if the band says so, runs are few, or it rarely covers the mean."""
    count = curve.runs.shape[1]
    if band == NO_BAND:
        return False
    return band == RUNS or 1 < count < LEAST_RUNS or count < BANDS[band].enough_runs


def _shade(band: str, bands: Sequence[str]) -> float:
    return DARK if band != bands[0] or band == INTERVAL else PALE


def _draw_bands(axes: Axes, curve: Curve, column: Column, percent: bool, alpha: float) -> None:
    """Draw the bands, shares within 0 and 1, and runs as thin lines if they are shown.

    An interval is left out where some runs have no value, as the remaining ones are no fair sample.
    """
    colour = column.styles[curve.condition]["color"]
    for band in column.bands:
        frame = curve.frame(band)
        if band == INTERVAL:
            frame[["low", "high"]] = frame[["low", "high"]].where(frame["count"] == curve.runs.shape[1])
        grid.draw_band(
            axes, frame, (0, 1) if percent else None, color=colour, alpha=_shade(band, column.bands)
        )
    if _shows_runs(curve, column.bands[0]):
        width = 0.3 * mpl.rcParams["lines.linewidth"]
        axes.plot(curve.runs, color=colour, linewidth=width, alpha=0.4 * alpha, zorder=1.4)


def _draw_centre(axes: Axes, curve: Curve, column: Column, end: float) -> None:
    """Draw the centre of runs, faint where some have no value, and a cross where a run diverged."""
    name, look, width = curve.condition, column.styles[curve.condition], mpl.rcParams["lines.linewidth"]
    frame, in_legend = curve.frame(), not column.at_ends
    every = max(len(frame) // MARKED_POINTS, 1)
    first = style.MARKERS.index(look["marker"]) * every // len(style.MARKERS) % every  # no two meet
    label = column.labels.get(name) or label_of(column.data, name)
    whole = frame["centre"].where(frame["count"] == curve.runs.shape[1])
    marked = in_legend or whole.count() == 1  # a single point has no line
    (line,) = axes.plot(
        frame["x"], whole, label=label if in_legend else "", color=look["color"], clip_on=False,
        marker=look["marker"] if marked else "", markersize=2.2 * width, markevery=(first, every),
        zorder=2.2,
    )  # fmt: skip
    line.set_in_layout(False)  # it may reach over the edge, and may be empty
    axes.plot(frame["x"], frame["centre"], color=look["color"], alpha=0.35, zorder=1.5)
    for step, value in curve.stops:
        axes.plot(step, value, "x", color=look["color"], markersize=4 * width)
    if column.at_ends:
        _name_end(axes, frame, label, look["color"], end)


def _name_end(axes: Axes, frame: pd.DataFrame, name: str, colour: str, end: float = 0) -> None:
    """Write a name at the end of a line: at the panel's edge, or where it ends before it."""
    known = frame.dropna(subset="centre")
    if known.empty:
        return
    step, value = known.iloc[-1][["x", "centre"]]
    early = step < (1 - SLACK) * end
    axes.annotate(
        fill(name, LONGEST_AT_END, break_long_words=False), (step if early else 1, value), (3, 0),
        "data" if early else ("axes fraction", "data"), "offset points", color=colour,
        fontsize=0.85 * style.text_points(), va="center", gid=style.END, annotation_clip=False,
    )  # fmt: skip


# --- Words -------------------------------------------------------------------------------------------


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run that did not diverge lacks a value after all had one."""
    whole = np.flatnonzero(curve.frame()["count"] == curve.runs.shape[1])
    return not curve.stops and len(whole) > 0 and len(whole) < len(curve.runs) - whole[0]


def _without_band(column: Column) -> list[str]:
    """Return which conditions have too few runs for a band that was asked for."""
    if column.band is None:
        return []
    least = BANDS[checked_band(column.band)].least_runs
    counts = column.data.runs["condition"].value_counts()
    few = [f"{name} ({counted(runs, 'run')})" for name, runs in counts.items() if runs < least]
    if not few:
        return []
    return [f"The band {column.band} needs {counted(least, 'run')}, and is not drawn for {', '.join(few)}."]


def _caption(column: Column) -> list[str]:
    data, names = column.data, {*column.curves}
    every = [*chain.from_iterable(column.curves.values())]
    notes = ["×: a run diverged, and its curve ends there."] * any(curve.stops for curve in every)
    notes += ["Faint, without an interval: some run has no value there."] * any(map(_has_gaps, every))
    if any(curve.log for curve in every):
        of = f"{CENTER_WORDS[column.center]}s and bands are of logarithms, without values of 0 or below."
        notes.append(f"On logarithmic axes {of}")
    for name, curves in column.curves.items():
        if column.log and not any(curve.log for curve in curves):
            notes.append(f"{QUANTITIES[name].title}: no value is above 0, so the axis is linear.")
    notes += _without_band(column)
    blank: dict[str, int] = {}
    for curve in every:
        if count := int(curve.values.isna().all().sum()):
            blank[curve.condition] = max(count, blank.get(curve.condition, 0))
    if blank:
        of = ", ".join(f"{count} of {name}" for name, count in blank.items())
        whose = of if len(blank) <= MOST_NAMED else f"of {len(blank)} conditions"
        notes.append(f"Some runs have no value in a panel, and count in no mean there: {whose}.")
    averaged, of_budget = [], "in the 5 % of the budget before each point"
    if names & {*EPISODE_QUANTITIES} and data.averaged_over == 1:
        notes.append("Returns and lengths are as they were logged.")
    elif names & {*EPISODE_QUANTITIES}:
        last = f"the last {data.averaged_over or 100} episodes"
        trailing = (
            last if (column.window or data.windows[0]) == TRAILING_WINDOW else f"the episodes {of_budget}"
        )
        averaged.append(f"{last}, as Stable-Baselines3 logs them" if data.averaged_over else trailing)
    if names & {*UPDATE_QUANTITIES}:
        averaged.append(f"the updates {of_budget}")
    if averaged:
        notes.append(f"Training curves average {', or '.join(averaged)}.")
    if column.beside:
        notes += _of_beside(column.beside, averaged)
    return [*notes, *([X_NOTES[column.x]] if column.x in X_NOTES else [])]


def _of_beside(data: StudyData, averaged: Sequence[str]) -> list[str]:
    """Return what the caption says of another study's runs, beside curves that average something."""
    if data.averaged_over is None:
        return []
    name, last = data.study.name, f"the last {data.averaged_over} episodes"
    notes = [f"The environment of {name} is not recorded."]
    if data.averaged_over == 1:
        return [f"Those of {name} are as they were logged.", *notes]
    if last not in averaged:
        return [f"Those of {name} average {last}.", *notes]
    return notes
