"""Figures of a search: Optuna's plots in Pneuma's style."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import RcParams, style
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter
from optuna.exceptions import ExperimentalWarning
from optuna.importance import PedAnovaImportanceEvaluator
from optuna.visualization import matplotlib as plots

from pneuma.errors import counted
from pneuma.figures.origin import Origin, sample
from pneuma.figures.style import CAPTION, TYPE_POINTS, house_style, save_figure
from pneuma.search.optuna_study import ended_study
from pneuma.search.storage import RecordedSearch

PAGE_INCHES = 7.0
NEEDS = {
    "history": "a complete trial",
    "importances": "10 complete trials, five of them better than the worst",
    "slices": "a complete trial",
    "parallel": "a complete trial",
    "front": "two objectives",
}
"""All figures, and what each needs. All but the Pareto front show the first objective."""
LEAST_TRIALS, BEST_TRIALS, BEST_SHARE = 10, 5, 0.1
"""Share of the trials that importances treat as the best, though never fewer than five trials."""


def draw_search(
    searched: RecordedSearch, folder: Path, formats: tuple[str, ...], command: str = ""
) -> list[Path]:
    """Draw all figures for which a search has enough trials; return the files written."""
    if not any(trial.state == "complete" for trial in searched.trials):
        return []
    ids = (run_id for trial in searched.trials for run_id in trial.run_ids)
    trained = sample(searched.task.search.name, "", ids, searched.task.budget.seeds)
    origin, paths = Origin(command=command, runs=(trained,)), []
    for name in NEEDS:
        with _plotting():
            axes = _plot(name, searched)
            if axes is not None:
                figure = np.ravel(axes)[0].figure
                _lay_out(figure, name, len(searched.task.search.space.parameters))
                text = {"x": 0.01, "ha": "left", "fontsize": CAPTION * TYPE_POINTS, "color": "#444444"}
                figure.supxlabel(_caption(searched), **text)
                stem = f"search-{searched.task.search.name}-{name}"
                paths += save_figure(figure, folder, stem, formats, origin)
            plt.close("all")
    return paths


@contextmanager
def _plotting() -> Iterator[None]:
    """Let Optuna plot in Pneuma's style, as it sets 'ggplot' before each plot."""
    theirs = style.library["ggplot"]
    style.library["ggplot"] = RcParams()
    try:
        with house_style(), warnings.catch_warnings():
            warnings.simplefilter("ignore", ExperimentalWarning)
            warnings.filterwarnings("ignore", "Attempting to set identical")  # of a parameter with one value
            plt.rcParams["figure.constrained_layout.use"] = True
            yield
    finally:
        style.library["ggplot"] = theirs


def _plot(name: str, searched: RecordedSearch) -> Any:
    """Return the axes of one of Optuna's plots; None if there are too few trials."""
    search, trials = searched.task.search, searched.trials
    if name == "front":
        return plots.plot_pareto_front(ended_study(trials, search)) if len(search.objectives) == 2 else None
    study = ended_study(trials, search, objectives=1)
    target = f"{search.objectives[0].outcome}, {search.objectives[0].over_seeds}"
    if name == "history":
        return plots.plot_optimization_history(study, target_name=target)
    if name == "slices":
        return plots.plot_slice(study, target_name=target)
    if name == "parallel":
        return plots.plot_parallel_coordinate(study, target_name=target)
    values = sorted(trial.values[0] for trial in trials if trial.state == "complete")
    if search.objectives[0].direction == "maximize":
        values.reverse()
    share = max(BEST_SHARE, BEST_TRIALS / len(values))
    if len(values) < LEAST_TRIALS or values[math.ceil(share * len(values)) - 1] == values[-1]:
        return None
    return plots.plot_param_importances(study, evaluator=PedAnovaImportanceEvaluator(target_quantile=share))


def _lay_out(figure: Figure, name: str, parameters: int) -> None:
    """Set a figure's size, wider than a page if each parameter has a panel."""
    wide = {"slices": 1.5, "parallel": 1.0}.get(name, 0.0) * parameters
    height = 1.2 + 0.28 * parameters if name == "importances" else 3.4
    if name == "history":
        figure.set_layout_engine("constrained")  # Optuna gives this one another
    figure.set_size_inches(max(PAGE_INCHES, wide), height)
    for axes in figure.axes:
        if name == "history":
            axes.lines[0].set_drawstyle("steps-post")  # the best value rises at a trial, not before it
        if name == "parallel":
            axes.grid(visible=False)
            axes.spines["right"].set_visible(True)
        if name == "slices" and axes.get_xlabel():
            axes.tick_params(axis="x", labelrotation=40)
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":  # its usual labels are formulas, which the style does not draw
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())


def _caption(searched: RecordedSearch) -> str:
    search, budget = searched.task.search, searched.task.budget
    states = [trial.state for trial in searched.trials]
    counts = ", ".join(
        f"{states.count(state)} {state}" for state in ("complete", "pruned", "failed") if state in states
    )
    return (
        f"Search {search.name}: {counts} trials, {counted(len(budget.seeds), 'seed')} × {budget.steps:,} "
        f"steps; sampler {search.spec.sampler.name}; {searched.task.digest}"
    )
