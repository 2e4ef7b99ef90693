"""Kills against the learning rate over the samples of an update, for the study `noise-scale`.

    python -m tools.noise_scale [RESULTS]

prints a row for each condition, by falling ratio, and Spearman's correlation over conditions, with and
without those that have few updates. `make figures` draws them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter
from scipy.stats import spearmanr

from pneuma.analysis.outcomes import find_outcome, outcome_values
from pneuma.analysis.runs import RunIndex, open_study
from pneuma.analysis.study_data import StudyData
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import samples_of
from pneuma.figures.words import headline_of
from pneuma.study.plan import Selection
from pneuma.study.store import Store

STUDY, STEPS, OUTCOME = "noise-scale", 294_912, "late-share-killed"
MARKERS = {1: "o", 4: "s", 16: "D"}
"""By the number of parallel environments."""
COLOURS = {1e-4: style.COLOURS[0], 3e-4: style.COLOURS[1], 1e-3: style.COLOURS[2]}
"""By the learning rate."""
FEW_UPDATES = 50


@dataclass(frozen=True)
class Cell:
    """A condition: its settings, and the outcome of each of its runs."""

    slots: int
    horizon: int
    rate: float
    killed: np.ndarray

    @property
    def ratio(self) -> float:
        return self.rate / (self.slots * self.horizon)

    @property
    def updates(self) -> int:
        return STEPS // (self.slots * self.horizon)


def noise_cells(data: StudyData) -> list[Cell]:
    """Return the conditions that have runs, by falling ratio."""
    found = []
    for name in data.conditions:
        if runs := data.of_condition(name):
            slots, horizon, rate = (runs[0].fields[key] for key in ("slots", "horizon", "learning_rate"))
            found.append(Cell(slots, horizon, rate, outcome_values(data, name, OUTCOME)))
    return sorted(found, key=lambda cell: -cell.ratio)


def correlations(cells: list[Cell]) -> list[str]:
    """Return in words how kills go with the ratio."""
    found = []
    for words, least in (("", 0), (f" with {FEW_UPDATES} updates or more", FEW_UPDATES)):
        of = [(cell.ratio, cell.killed.mean()) for cell in cells if cell.updates >= least]
        correlation = f"{spearmanr(of).statistic:.2f}".replace("-", "−")
        found.append(f"Spearman's correlation over {len(of)} conditions{words}: {correlation}.")
    return found


def open_noise_scale(index: RunIndex) -> StudyData:
    return open_study(index, STUDY, Selection(steps=STEPS))


def noise_page(data: StudyData) -> Page:
    """Return kills over the ratio: a dot for each run, a large mark for the mean of a condition."""
    cells = noise_cells(data)
    marks: dict[str, Any] = {"a run": Line2D([], [], color=style.GREY, marker=".", linestyle="")}
    for slots, marker in MARKERS.items():
        look: Any = {"color": style.GREY, "marker": marker, "linestyle": "", "markersize": 5}
        marks[f"mean, {slots} environment{'s' * (slots > 1)}"] = Line2D([], [], **look)
    for rate, colour in COLOURS.items():
        marks[f"learning rate {rate:g}"] = Line2D([], [], color=colour, linewidth=3)
    panel = Panel(
        lambda axes: _draw(axes, cells), "", "Learning rate over the samples of an update", "Share killed",
        _ratios, grid.shares,
    )  # fmt: skip
    words = find_outcome(OUTCOME).words
    few = [cell for cell in cells if cell.updates < FEW_UPDATES]
    crossed = f"Crossed out: {few[0].updates} updates in all." if few else ""
    caption = [f"{words[:1].upper()}{words[1:]}.", *correlations(cells), crossed]
    headline = headline_of(data, "at the end of training")
    return Page(STUDY, [[panel]], 1.3 * style.PANEL_INCHES, headline, samples_of(data), marks, caption)


def _ratios(axis: Axis) -> None:
    axis.axes.set_xscale("log")
    axis.set_major_formatter(FuncFormatter(lambda ratio, _: f"{ratio:.0e}".replace("e-0", "e-")))


def _draw(axes: Axes, cells: list[Cell]) -> None:
    for cell in cells:
        colour = COLOURS[cell.rate]
        axes.plot([cell.ratio] * len(cell.killed), cell.killed, ".", color=colour, alpha=0.4, markersize=3)
        axes.plot(
            cell.ratio, cell.killed.mean(), MARKERS[cell.slots], color=colour, markeredgecolor=style.INK,
            markeredgewidth=0.6, markersize=5, zorder=2.5,
        )  # fmt: skip
        if cell.updates < FEW_UPDATES:
            axes.plot(cell.ratio, cell.killed.mean(), "x", color="white", markersize=4, zorder=2.6)
    axes.set_ylim(0, 1 + grid.BELOW_ZERO)


if __name__ == "__main__":
    results = sys.argv[1] if sys.argv[1:] else "results"
    cells = noise_cells(open_noise_scale(RunIndex(Store(results))))
    print("ratio     slots  horizon  rate    updates  runs  killed")
    for cell in cells:
        settings = f"{cell.ratio:.1e}  {cell.slots:5}  {cell.horizon:7}  {cell.rate:.0e}  {cell.updates:7}"
        print(f"{settings}  {len(cell.killed):4}  {cell.killed.mean():.2f}")
    print("\n".join(correlations(cells)))
