"""The figures of a search: Optuna's pictures of its trials, and how its winner does on fresh seeds.

Record → Optuna's axes in our style, the thesis's values marked → files
winners, their runs → Page (`grid.py`)
"""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullLocator
from optuna.importance import PedAnovaImportanceEvaluator
from optuna.trial import FrozenTrial, TrialState
from optuna.visualization import matplotlib as pictures

from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.study_data import StudyData
from pneuma.errors import counted, plain
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import Origin, sample, samples_of
from pneuma.figures.style import COLOURS, INK, WIDTH
from pneuma.figures.words import capital, headline_of, notes_of
from pneuma.search.promote import Winner, fresh_values, gains
from pneuma.search.record import Record

TABLES = {"table-6-1": ":", "table-6-2": "--"}
"""Bases whose values are marked: the thesis's, and the lines that mark them."""
COLUMNS, ROW_INCHES = 4, 1.75
LEAST_TRIALS, BEST_TRIALS, BEST_SHARE = 10, 5, 0.1
"""Share of the trials that importances treat as the best, though never fewer than five trials."""


def draw_search(
    searched: Record, folder: Path, formats: Sequence[str], command: str = "", only: Collection[str] = ()
) -> list[Path]:
    """Draw the pictures of a search, or `only` some, and write each; none before a trial is complete.

    Their origin tells the `command` that draws them again.
    """
    search, budget = searched.search, searched.budget
    complete = [trial for trial in searched.trials if trial.state == TrialState.COMPLETE]
    if not complete:
        return []
    ids = (name for trial in searched.trials for name in trial.user_attrs.get("run_ids", []))
    origin = Origin(command=plain(command), runs=(sample(search.name, "", ids, budget.seeds),))
    files = list[Path]()
    with style.house_style(), _optuna_in_our_style():
        for name, (title, draw) in _pictures(searched, complete).items():
            if only and name not in only:
                continue
            axes = np.ravel(np.array(draw()))
            figure = axes[0].figure
            try:
                figure.set_layout_engine("constrained")
                headline = f"{search.full_title}: {title}. {_amount(searched)}"
                figure.suptitle(textwrap.fill(headline, style.characters(1.2 * style.TYPE_POINTS)))
                for each in axes:
                    each.set_title("")
                files += style.save_figure(figure, folder, f"search-{search.label}-{name}", formats, origin)
            finally:
                plt.close(figure)
    return files


@contextmanager
def _optuna_in_our_style() -> Iterator[None]:
    """Let Optuna, which asks for the style `ggplot`, change nothing of the present one."""
    library: Any = matplotlib.style.library
    before = library["ggplot"]
    plt.rcParams |= {"figure.constrained_layout.use": True, "figure.figsize": (WIDTH, WIDTH / 2)}
    library["ggplot"] = {}
    try:
        with warnings.catch_warnings(action="ignore"):  # of what is experimental, and of low targets
            yield
    finally:
        library["ggplot"] = before


Picture = tuple[str, Callable[[], Any]]
"""Its title, and what draws it."""


def _pictures(searched: Record, complete: Sequence[FrozenTrial]) -> dict[str, Picture]:
    """Return each picture by name, in the first of the objectives, unless it shows both."""
    study, (first, *others) = searched.study, searched.search.sought
    words = [
        f"{capital(find_outcome(each.outcome).words.partition(',')[0])}, {each.over_seeds} of seeds"
        for each in (first, *others)
    ]
    of_first: dict[str, Any] = {"target_name": words[0]}
    if others:
        of_first["target"] = lambda trial: trial.values[0]
    drawn: dict[str, Picture] = {
        "history": ("history", lambda: _history(searched, of_first)),
        "values": ("values of parameters", lambda: _slices(searched, of_first)),
    }
    several = len({name for trial in complete for name in trial.params}) > 1
    if several and len(complete) >= LEAST_TRIALS:
        share = max(BEST_SHARE, BEST_TRIALS / len(complete))
        evaluator = PedAnovaImportanceEvaluator(target_quantile=share)  # Watanabe et al. 2023
        sign = -1 if first.direction == "maximize" else 1  # it asks what makes a target low
        low: dict[str, Any] = {"target": lambda trial: sign * trial.values[0], "target_name": words[0]}
        # Of equally important ones the first comes first: a set's order would change from process to process.
        low["params"] = sorted(set.intersection(*({*trial.params} for trial in complete)))
        title = "which parameters tell the best trials from the others (PED-ANOVA)"
        drawn["importances"] = title, lambda: pictures.plot_param_importances(study, evaluator, **low)
    if len(others) == 1:
        drawn["front"] = "both objectives", lambda: pictures.plot_pareto_front(study, target_names=words)
    return drawn


def _amount(searched: Record) -> str:
    ended = [trial.state for trial in searched.trials]
    words = {TrialState.COMPLETE: "whole", TrialState.PRUNED: "stopped early", TrialState.FAIL: "failed"}
    counts = [f"{ended.count(state)} {word}" for state, word in words.items() if state in ended]
    seeds, steps = counted(len(searched.budget.seeds), "seed"), searched.budget.steps
    return f"{counted(len(ended), 'trial')} ({', '.join(counts)}); {seeds}, {steps:,} steps each"


def _tables(searched: Record) -> list[tuple[int, str]]:
    """Return the thesis's tables with which a search starts, each with its trial."""
    starts = enumerate(searched.search.start)
    return [(number, start) for number, start in starts if isinstance(start, str) and start in TABLES]


def _history(searched: Record, of_first: dict[str, Any]) -> Axes:
    """Draw every trial's value and the best so far, with the trials of the thesis's tables."""
    axes: Axes = pictures.plot_optimization_history(searched.study, **of_first)
    values = {trial.number: trial.values[0] for trial in searched.trials if trial.values}
    for number, base in _tables(searched):
        if number in values:
            marker = "sD"[[*TABLES].index(base)]
            axes.plot(number, values[number], marker, color=INK, zorder=4, label=base)
    axes.legend()
    return axes


def _slices(searched: Record, of_first: dict[str, Any]) -> Any:
    """Draw trials over the values of each parameter, in rows, with the values of the thesis's tables."""
    search = searched.search
    slices: Any = np.ravel(np.array(pictures.plot_slice(searched.study, **of_first)))
    figure, rows, marks = slices[0].figure, math.ceil(len(slices) / COLUMNS), dict[str, Any]()
    figure.set_size_inches(WIDTH, ROW_INCHES * rows + 0.7)
    places = figure.add_gridspec(rows, min(COLUMNS, len(slices)))
    for place, axes in enumerate(slices):
        name, of_choices = axes.get_xlabel(), axes.xaxis.have_units()
        for _, base in _tables(searched):
            if name in (params := search.params_of(base)):
                at = repr(params[name]) if of_choices else params[name]
                marks[base] = axes.axvline(at, color=INK, linewidth=0.8, linestyle=TABLES[base], zorder=1.2)
        axes.set_subplotspec(places[divmod(place, COLUMNS)])
        axes.tick_params(labelleft=place % COLUMNS == 0)
        axes.set(xlabel=name.replace("_", " "), ylabel="")
        if of_choices:
            choices = [text.get_text().strip("'") for text in axes.get_xticklabels()]
            axes.set_xticks(range(len(choices)), choices, rotation=30, ha="right", rotation_mode="anchor")
        elif axes.get_xscale() == "log":
            axes.xaxis.set(major_locator=LogLocator(numticks=5), minor_locator=NullLocator())
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    figure.supylabel(of_first["target_name"])
    if marks:
        figure.legend(marks.values(), marks.keys(), loc="outside lower center", ncols=len(marks))
    return slices


# --- Winners on fresh seeds -------------------------------------------------------------------------


def winners_page(basename: str, winners: Sequence[Winner], data: StudyData) -> Page:
    """Return how winners of searches do on fresh seeds, in the first of their objectives.

    A row for each: its base, the winner with the interval of its gain, and what the search had seen of it.
    """
    objective = winners[0].search.sought[0]
    found = gains(winners, data).query("objective == @objective.name")
    arms = {winner.name: fresh_values(winner, objective, data) for winner in winners}
    found = found.sort_values("fresh", ascending=objective.direction == "minimize", kind="stable")
    measured, means = find_outcome(objective.outcome), objective.over_seeds == "mean"
    words, share = capital(measured.words), measured.unit == "share"
    rows, names = found.to_dict("records"), [*found["search"]]
    x = words if means else f"{words}, {objective.over_seeds} of seeds"
    ticks = grid.shares if share else grid.few
    panels = [
        Panel(partial(_draw_values, rows=rows, arms=arms, from_zero=share), x=x, x_ticks=ticks, rows=names)
    ]
    if shown := means and bool(np.isfinite(found["low"]).any()):
        ticks = grid.points if share else grid.few
        differences = partial(grid.draw_differences, rows=rows, markerfacecolor=COLOURS[1])
        panels.append(Panel(differences, x="Tuned less untuned", x_ticks=ticks, rows=[""] * len(rows)))
    inches = max(grid.ROW_INCHES * len(rows) + 0.7, 1.4)
    seeds = counted(len(data.of_condition(winners[0].tuned)), "fresh seed")
    title = headline_of(data, f"{seeds}, {data.budget:,} steps")
    caption = [*notes_of(data), "Dots: runs. Right: the difference of means with its 95 % interval." * shown]
    widths = [2, 1] if shown else None
    return Page(basename, [panels], inches, title, samples_of(data), caption=caption, widths=widths)


def _draw_values(
    axes: Axes, rows: Sequence[Mapping[Any, Any]], arms: Mapping[str, Sequence[np.ndarray]], from_zero: bool
) -> None:
    """Draw a row for each winner: the runs of both conditions, and their values over seeds."""
    base, tuned = COLOURS[:2]
    looks: dict[str, tuple[str, dict[str, Any]]] = {
        "untuned": ("base", {"marker": "o", "color": base}),
        "tuned": ("fresh", {"marker": "D", "color": INK, "markerfacecolor": tuned}),
        "tuned, as its search saw it": ("seen", {"marker": "o", "color": base, "markerfacecolor": "white"}),
    }
    for place, row in enumerate(rows):
        for values, colour in zip(arms[row["search"]], (tuned, base), strict=True):
            axes.plot(values, [place + 0.22] * len(values), "o", color=colour, markersize=2.2, alpha=0.6)
    for label, (key, look) in looks.items():
        look |= {"label": label, "linestyle": "", "markersize": 4.5, "zorder": 2.6}
        axes.plot([row[key] for row in rows], range(len(rows)), **look)
    if from_zero:
        axes.set_xlim(left=0)
