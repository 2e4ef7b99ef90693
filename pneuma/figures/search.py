"""Figures of a search, drawn from its record: how it went, what mattered, and where good values lie.

history · importances · slices · parallel coordinates · contour · Pareto front
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, Formatter, FuncFormatter, NullLocator

from pneuma.analysis.outcomes import find_outcome
from pneuma.errors import counted
from pneuma.figures.panel import log_ticks, per_cent
from pneuma.figures.style import COLOURS, house_style, put_caption, save_figure
from pneuma.search.importance import LEAST_TRIALS, importances
from pneuma.search.record import trial_values
from pneuma.search.recorded import read_space
from pneuma.search.space import Parameter, Range

PAGE_INCHES = 7.0
SLICE_COLUMNS = 3
MOST_AXES = 8
"""Parameters that a contour and parallel coordinates can show; the most important ones."""
COLOUR_MAP = "cividis"
"""Its lightness grows evenly, so that it reads the same in grey and for the colour-blind."""


@dataclass(frozen=True)
class _Seen:
    """A search as it is drawn.

    Attributes:
        trials: those with values, in order.
        parameters: of the space, the most important first.
        weights: importance of each, summing to 1; empty with too few trials.
        objectives: their documents.
    """

    record: Mapping[str, Any]
    trials: Sequence[Mapping[str, Any]]
    parameters: Sequence[Parameter]
    weights: Mapping[str, float]
    objectives: Sequence[Mapping[str, Any]]

    def values(self, place: int = 0) -> np.ndarray:
        """Return an objective's values of the complete trials, (trials,)."""
        return np.array([trial_values(trial)[place] for trial in self.complete])

    @property
    def complete(self) -> list[Mapping[str, Any]]:
        """The trials that were trained to their end."""
        return [trial for trial in self.trials if trial["state"] == "complete"]

    def numbers(self, place: int = 0) -> Formatter:
        """Return how an objective's values are written: a share in per cent."""
        if find_outcome(self.objectives[place]["outcome"]).unit == "share":
            return FuncFormatter(per_cent)
        return FuncFormatter(lambda value, _: f"{value:g}")

    def label(self, place: int = 0) -> str:
        """Return what an objective is, for an axis."""
        own = self.objectives[place]
        seeds = counted(len(self.record["seeds"]), "seed")
        return f"{own['outcome'].replace('-', ' ')}, {_OVER[own['over_seeds']]} of {seeds}"


_OVER = {"mean": "mean", "median": "median", "iqm": "IQM", "least": "least", "deviation": "SD"}


def draw_search(
    record: Mapping[str, Any], folder: Path, what: Sequence[str], formats: tuple[str, ...]
) -> list[Path]:
    """Draw figures of a search; return the files written: of each figure that its trials are enough for.

    Args:
        record: as `pneuma.search.record.read_record` returns it.
        folder: where to write.
        what: of `FIGURES`.
        formats: of `pneuma.figures.FIGURE_FORMATS`.
    """
    space = read_space(record)
    weights = importances(record, space)
    parameters = sorted(space.parameters, key=lambda p: -weights.get(p.name, 0.0))
    trials = [trial for trial in record["trials"] if trial["state"] != "failed"]
    seen = _Seen(record, trials, parameters, weights, record["identity"]["objectives"])
    if not seen.complete:
        return []
    paths = []
    for name in what:
        with house_style():
            figure = FIGURES[name](seen)
            if figure is not None:
                _add_words(figure, seen)
                paths += save_figure(figure, folder, f"search-{record['search']}-{name}", formats)
    return paths


def _history(seen: _Seen) -> Figure:
    """Every trial in the order of asking, and the best so far."""
    figure, axes = _panel(3.4)
    numbers = np.array([trial["number"] for trial in seen.complete])
    values = seen.values()
    axes.plot(numbers, values, "o", color=COLOURS[0], markersize=4, label="trial")
    pruned = [trial for trial in seen.trials if trial["state"] == "pruned"]
    if pruned:
        axes.plot(
            [trial["number"] for trial in pruned], [trial_values(trial)[0] for trial in pruned], "x",
            color="#777777", markersize=4, label="given up early",
        )  # fmt: skip
    if len(seen.objectives) == 1:
        best = (
            np.maximum.accumulate if seen.objectives[0]["direction"] == "maximize" else np.minimum.accumulate
        )
        axes.step(numbers, best(values), where="post", color=COLOURS[1], label="best so far")
    axes.set(title="Trials in the order of asking", xlabel="Trial", ylabel=seen.label())
    axes.yaxis.set_major_formatter(seen.numbers())
    axes.legend(loc="best")
    return figure


def _importances(seen: _Seen) -> Figure | None:
    """How much of the difference between good trials and all each parameter makes."""
    if not seen.weights:
        return None
    names = [parameter.name for parameter in seen.parameters if parameter.name in seen.weights][::-1]
    figure, axes = _panel(1.2 + 0.26 * len(names))
    axes.barh(names, [seen.weights[name] for name in names], color=COLOURS[0], height=0.6)
    axes.set(title="Importance of each hyperparameter (PED-ANOVA)", xlim=(0, None))
    axes.xaxis.set_major_formatter(FuncFormatter(per_cent))
    axes.grid(visible=False, axis="y")
    return figure


def _slices(seen: _Seen) -> Figure:
    """The objective over each parameter, one point a trial."""
    rows = math.ceil(len(seen.parameters) / SLICE_COLUMNS)
    figure = Figure(figsize=(PAGE_INCHES, 0.9 + 1.9 * rows), layout="constrained")
    panels = figure.subplots(rows, SLICE_COLUMNS, sharey=True, squeeze=False).ravel()
    values = seen.values()
    panels[0].yaxis.set_major_formatter(seen.numbers())
    for axes, parameter in zip(panels, seen.parameters, strict=False):
        held = [parameter.name in trial["params"] for trial in seen.complete]
        at = _positions(parameter, [trial for trial, has in zip(seen.complete, held, strict=True) if has])
        axes.scatter(at, values[held], s=12, color=COLOURS[0], alpha=0.7, linewidth=0)
        _scale(axes.xaxis, parameter, axes.set_xscale)
        axes.set_title(parameter.name, fontsize=8.5)
    for axes in panels[len(seen.parameters) :]:
        axes.set_visible(False)
    figure.supylabel(seen.label(), fontsize=8.5)
    return figure


def _parallel(seen: _Seen) -> Figure:
    """Each trial a line over the parameters, coloured by its value."""
    of_all = [p for p in seen.parameters if all(p.name in trial["params"] for trial in seen.complete)]
    parameters = of_all[:MOST_AXES]
    figure, axes = _panel(3.8)
    values = seen.values()
    low, high = values.min(), values.max()
    colours = ScalarMappable(Normalize(low, high if high > low else low + 1), COLOUR_MAP)
    heights = np.array([_unit_positions(parameter, seen.complete) for parameter in parameters])
    places = np.arange(len(parameters))
    for index in np.argsort(values if seen.objectives[0]["direction"] == "maximize" else -values):
        axes.plot(places, heights[:, index], color=colours.to_rgba(values[index]), linewidth=1.1, alpha=0.85)
    for place, parameter in enumerate(parameters):
        axes.axvline(place, color="#AAAAAA", linewidth=0.7)
        for share, text in _ends(parameter):
            axes.text(place, share, f" {text}", fontsize=6, va="center", bbox=_BEHIND)
    axes.set_xticks(places, [parameter.name.replace("_", "\n") for parameter in parameters])
    few = "most important" if seen.weights else "first"
    which = f"{len(parameters)} {few} " if len(parameters) < len(of_all) else ""
    whose = " that all trials have" if len(of_all) < len(seen.parameters) else ""
    axes.set(title=f"Trials over the {which}hyperparameters{whose}", yticks=[], ylim=(-0.06, 1.06))
    axes.grid(visible=False)
    figure.colorbar(colours, ax=axes, label=seen.label(), format=seen.numbers())
    return figure


_BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}


def _contour(seen: _Seen) -> Figure | None:
    """The value over the two most important ranges: one dot a trial, on a surface through them."""
    ranges = [p for p in seen.parameters if isinstance(p.domain, Range)]
    ranges = [p for p in ranges if all(p.name in trial["params"] for trial in seen.complete)][:2]
    if len(ranges) < 2 or len(seen.complete) < 4:
        return None
    figure, axes = _panel(4.2)
    x, y = (_unit_positions(parameter, seen.complete) for parameter in ranges)
    values = seen.values()
    levels = Normalize(values.min(), values.max())
    if np.ptp(values) > 0:
        grid = np.linspace(0, 1, 60)
        surface = _smooth(x, y, values, grid)
        axes.contourf(grid, grid, surface, levels=10, cmap=COLOUR_MAP, norm=levels, alpha=0.85)
    axes.scatter(x, y, c=values, cmap=COLOUR_MAP, norm=levels, edgecolor="white", linewidth=0.8, s=26)
    for axis, parameter in ((axes.xaxis, ranges[0]), (axes.yaxis, ranges[1])):
        ticks = _ticks(parameter)
        axis.set_ticks([share for share, _ in ticks], [text for _, text in ticks])
    axes.set(
        title="Between trials: a mean weighted by nearness, no model", xlabel=ranges[0].name,
        ylabel=ranges[1].name, xlim=(0, 1), ylim=(0, 1),
    )  # fmt: skip
    axes.grid(visible=False)
    figure.colorbar(ScalarMappable(levels, COLOUR_MAP), ax=axes, label=seen.label(), format=seen.numbers())
    return figure


def _front(seen: _Seen) -> Figure | None:
    """Two objectives against each other, and the trials that none other beats in both."""
    if len(seen.objectives) != 2:
        return None
    figure, axes = _panel(4.0)
    x, y = seen.values(0), seen.values(1)
    best = np.isin([trial["number"] for trial in seen.complete], seen.record["best"])
    axes.scatter(x[~best], y[~best], s=16, color="#999999", label="trial")
    axes.plot(x[best], y[best], "o", color=COLOURS[1], markersize=5, label="Pareto front")
    shared: dict[tuple[float, float], list[str]] = {}
    for trial, at in zip(seen.complete, zip(x, y, strict=True), strict=True):
        if trial["number"] in seen.record["best"]:
            shared.setdefault(at, []).append(str(trial["number"]))
    for at, numbers in shared.items():
        told = ", ".join(numbers)
        axes.annotate(told, at, (4, 4), textcoords="offset points", fontsize=6.5)
    axes.set(title="Pareto front (numbers of trials)", xlabel=seen.label(0), ylabel=seen.label(1))
    axes.xaxis.set_major_formatter(seen.numbers(0))
    axes.yaxis.set_major_formatter(seen.numbers(1))
    axes.legend(loc="best")
    return figure


FIGURES: dict[str, Callable[[_Seen], Figure | None]] = {
    "history": _history,
    "importances": _importances,
    "slices": _slices,
    "parallel": _parallel,
    "contour": _contour,
    "front": _front,
}
NEEDS = {
    "history": "a complete trial",
    "importances": f"{LEAST_TRIALS} complete trials, five of them better than the worst",
    "slices": "a complete trial",
    "parallel": "a complete trial",
    "contour": "4 complete trials with two ranges that all of them have",
    "front": "two objectives",
}


# --- Axes ------------------------------------------------------------------------------------------


def _panel(height_inches: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(PAGE_INCHES, height_inches), layout="constrained")
    return figure, figure.subplots()


def _add_words(figure: Figure, seen: _Seen) -> None:
    """Put below the panels what was searched."""
    record = seen.record
    states = [trial["state"] for trial in record["trials"]]
    counts = ", ".join(f"{states.count(state)} {state}" for state in _STATES if state in states)
    seeds = counted(len(record["seeds"]), "seed")
    put_caption(
        figure,
        f"Search {record['search']}: {counts} trials, {seeds} × {record['steps']:,} steps; "
        f"sampler {record['identity']['sampler']['name']}; {record['digest']}",
    )


_STATES = ("complete", "pruned", "failed")


def _scale(axis: Any, parameter: Parameter, set_scale: Callable[[str], None]) -> None:
    """Give an axis a parameter's scale, or its choices' names."""
    if isinstance(parameter.domain, Range):
        if parameter.domain.log:
            set_scale("log")
            axis.set_major_locator(FixedLocator(log_ticks(parameter.domain.low, parameter.domain.high)))
            axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        return
    names = list(parameter.domain.settings_of)
    axis.set_ticks(range(len(names)), names, fontsize=6.5, rotation=0 if len(names) < 4 else 30)
    axis.axes.set_xlim(-0.5, len(names) - 0.5)


def _positions(parameter: Parameter, trials: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Return where trials lie on a parameter's own axis, (trials,)."""
    values = [trial["params"][parameter.name] for trial in trials]
    if isinstance(parameter.domain, Range):
        return np.array(values, float)
    return np.array([list(parameter.domain.settings_of).index(value) for value in values], float)


def _unit_positions(parameter: Parameter, trials: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Return where trials lie between a parameter's ends, 0 to 1, (trials,)."""
    at = _positions(parameter, trials)
    domain = parameter.domain
    if not isinstance(domain, Range):
        return at / max(len(domain.settings_of) - 1, 1)
    low, high = domain.low, domain.high
    if domain.log:
        return np.log(at / low) / math.log(high / low)
    return (at - low) / (high - low)


def _ends(parameter: Parameter) -> list[tuple[float, str]]:
    if isinstance(parameter.domain, Range):
        return [(0.0, f"{parameter.domain.low:g}"), (1.0, f"{parameter.domain.high:g}")]
    return _ticks(parameter)


def _ticks(parameter: Parameter) -> list[tuple[float, str]]:
    """Return a few places between a parameter's ends, with their values."""
    domain = parameter.domain
    if not isinstance(domain, Range):
        names = list(domain.settings_of)
        return [(place / max(len(names) - 1, 1), name) for place, name in enumerate(names)]
    spread = np.geomspace if domain.log else np.linspace
    shares = np.linspace(0, 1, 4)
    return [
        (share, f"{value:.3g}" if 0 < share < 1 else f"{value:g}")
        for share, value in zip(shares, spread(domain.low, domain.high, 4), strict=True)
    ]


def _smooth(x: np.ndarray, y: np.ndarray, values: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Return the mean of the values weighted by inverse squared distance, (points, points)."""
    across, up = np.meshgrid(grid, grid)
    squares = (across[..., None] - x) ** 2 + (up[..., None] - y) ** 2 + 1e-3
    return (values / squares).sum(axis=-1) / (1 / squares).sum(axis=-1)
