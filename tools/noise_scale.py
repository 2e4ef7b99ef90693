"""Kills against the learning rate over the samples of an update, for the study `noise-scale`.

    python -m tools.noise_scale [RESULTS]

prints a row for each condition, by falling ratio, and Spearman's correlation over conditions, with and
without those that have few updates. `make figures` draws them.
"""

from __future__ import annotations

import sys
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.drawing import run_table
from pneuma.analysis.outcomes import find_outcome, outcome_values
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.words import capital
from pneuma.store.index import RunIndex
from pneuma.store.quantities import POWERS, SHARES
from pneuma.store.store import Store
from pneuma.study.plan import Query

STUDY, STEPS, OUTCOME = "noise-scale", 294_912, "late-share-killed"
MARKERS = {1: "o", 4: "s", 16: "D"}
"""By the number of parallel environments."""
COLOURS = {1e-4: "C0", 3e-4: "C1", 1e-3: "C2"}
"""By the learning rate."""
FEW_UPDATES = 50


def noise_cells(data: StudyData) -> pd.DataFrame:
    """Return settings and outcomes of each condition that has runs, by falling ratio."""
    rows: list[dict[str, Any]] = []
    for name in data.conditions:
        if runs := data.of_condition(name):
            slots, horizon, rate = (runs[0].fields[key] for key in ("slots", "horizon", "learning_rate"))
            samples, killed = slots * horizon, outcome_values(data, name, OUTCOME)
            settings = {"ratio": rate / samples, "slots": slots, "horizon": horizon, "rate": rate}
            outcomes = {"runs": len(runs), "mean": killed.mean(), "killed": killed}
            rows.append({**settings, "updates": STEPS // samples, **outcomes})
    return pd.DataFrame(rows).sort_values("ratio", ascending=False, kind="stable")


def correlations(cells: pd.DataFrame) -> list[str]:
    """Return in words how kills go with the ratio."""
    sentences = []
    for words, least in (("", 0), (f" with {FEW_UPDATES} updates or more", FEW_UPDATES)):
        enough = cells[cells["updates"] >= least]
        correlation = f"{enough['ratio'].corr(enough['mean'], method='spearman'):.2f}".replace("-", "−")
        sentences.append(f"Spearman's correlation over {len(enough)} conditions{words}: {correlation}.")
    return sentences


def open_noise_scale(index: RunIndex) -> StudyData:
    return open_study(index, Query(STUDY, steps=STEPS))


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
        lambda axes: _draw(axes, cells),
        x="Learning rate over the samples of an update",
        y="Share killed",
        x_kind=POWERS,
        y_kind=SHARES,
    )
    words = find_outcome(OUTCOME).words
    few = cells["updates"][cells["updates"] < FEW_UPDATES]
    crossed = f"Crossed out: {few.iloc[0]} updates in all." if len(few) else ""
    caption = [f"{capital(words)}.", *correlations(cells), crossed]
    headline, runs = f"{data.full_title}: at the end of training", lines_of_runs(run_table({"": data}))
    return Page(STUDY, [[panel]], 1.3 * style.PANEL_INCHES, headline, runs, marks, caption)


def _draw(axes: Axes, cells: pd.DataFrame) -> None:
    for cell in cells.to_dict("records"):
        colour, at, mean = COLOURS[cell["rate"]], cell["ratio"], cell["mean"]
        axes.plot([at] * cell["runs"], cell["killed"], ".", color=colour, alpha=0.4, markersize=3)
        axes.plot(
            at, mean, MARKERS[cell["slots"]], color=colour, markeredgecolor=style.INK, markeredgewidth=0.6,
            markersize=5, zorder=2.5,
        )  # fmt: skip
        if cell["updates"] < FEW_UPDATES:
            axes.plot(at, mean, "x", color="white", markersize=4, zorder=2.6)
    axes.set_ylim(0, 1 + grid.BELOW_ZERO)


if __name__ == "__main__":
    results = sys.argv[1] if sys.argv[1:] else "results"
    cells = noise_cells(open_noise_scale(RunIndex(Store(results))))
    print(cells.drop(columns="killed").to_string(index=False, float_format="{:.2g}".format))
    print("\n".join(correlations(cells)))
