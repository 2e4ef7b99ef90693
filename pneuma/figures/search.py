"""The figures of a search: Optuna's pictures of its trials in our style, with the thesis's values marked."""

from __future__ import annotations

import math
import textwrap
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib import colormaps
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.ticker import LogLocator, NullLocator
from optuna.importance import PedAnovaImportanceEvaluator
from optuna.trial import TrialState
from optuna.visualization import matplotlib as pictures

from pneuma.analysis.outcomes import find_outcome
from pneuma.errors import counted
from pneuma.figures import style
from pneuma.figures.origin import line_of_runs, origin_text
from pneuma.figures.style import INK, WIDTH
from pneuma.figures.words import capital
from pneuma.search.log import Record

TABLES = {"table-6-1": ("s", ":"), "table-6-2": ("D", "--")}
"""The thesis's bases: the marker of their trials and the line at their values."""
TABLE_LABELS = {"table-6-1": "Table 6.1", "table-6-2": "Table 6.2"}
LATE_BLUES = ListedColormap(colormaps["Blues"](np.linspace(0.2, 1, 256)))
"""Colours of trials in their order; the first is not white."""
COLUMNS, ROW_INCHES = 4, 1.75
LETTERS_ACROSS = 24
"""Most letters of choices that are written level below a panel."""
LEAST_TRIALS, BEST_TRIALS, BEST_SHARE = 10, 5, 0.1
"""Importances need this many trials, and treat this share as the best, but at least this number of trials."""


def draw_search(
    record: Record, folder: Path, formats: Sequence[str], only: Collection[str] = ()
) -> list[Path]:
    """Draw the pictures of a search, or `only` some, and write each; none before a trial is complete."""
    if not record.complete:
        return []
    search = record.search
    run_ids: list[str] = []
    for trial in record.ended:
        run_ids += trial.user_attrs.get("run_ids", [])
    run_line = line_of_runs(search.name, "", run_ids, record.budget.seeds)
    paths: list[Path] = []
    with style.house_style(), _optuna_in_our_style():
        for picture_name, (title, draw) in _pictures(record).items():
            if only and picture_name not in only:
                continue
            panels = np.ravel(np.array(draw(record)))
            figure = panels[0].figure
            try:
                figure.set_layout_engine("constrained")
                headline = f"{search.full_title}: {title}. {_amount(record)}"
                figure.suptitle(
                    _in_lines(f"{search.full_title}: {title}", _amount(record)), x=0.01, ha="left"
                )
                for axes in panels:
                    axes.set_title("")
                basename, origin = f"search-{search.label}-{picture_name}", origin_text(headline, [run_line])
                paths += style.save_figure(figure, folder, basename, formats, origin)
            finally:
                plt.close(figure)
    return paths


@contextmanager
def _optuna_in_our_style() -> Iterator[None]:
    """Keep the present style, where Optuna would use the style `ggplot`."""
    library: Any = matplotlib.style.library
    ggplot_style = library["ggplot"]
    plt.rcParams |= {"figure.constrained_layout.use": True, "figure.figsize": (WIDTH, WIDTH / 2)}
    library["ggplot"] = {}
    try:
        with warnings.catch_warnings(action="ignore"):  # experimental features, and low targets
            yield
    finally:
        library["ggplot"] = ggplot_style


def _in_lines(title: str, amount: str) -> str:
    letters = style.characters(1.2 * style.TYPE_POINTS)
    return "\n".join(textwrap.fill(part, letters, break_on_hyphens=False) for part in (title, amount))


Draw = Callable[[Record], Any]


def _pictures(record: Record) -> dict[str, tuple[str, Draw]]:
    """Return the title of each picture by name, and what draws it."""
    pictures_by_name: dict[str, tuple[str, Draw]] = {
        "history": ("history", _history),
        "values": ("values of parameters", _slices),
    }
    parameters = {parameter for trial in record.complete for parameter in trial.params}
    if len(parameters) > 1 and len(record.complete) >= LEAST_TRIALS:
        title = "parameters that separate the best trials (PED-ANOVA)"
        pictures_by_name["importances"] = title, _importances
    if len(record.search.objectives) == 2:
        pictures_by_name["front"] = "both objectives", _front
    return pictures_by_name


def _target_names(record: Record) -> list[str]:
    target_names: list[str] = []
    for objective in record.search.objectives.values():
        outcome = capital(find_outcome(objective.outcome).words.partition(",")[0])
        target_names.append(f"{outcome}, {objective.over_seeds} of seeds")
    return target_names


def _target(record: Record) -> dict[str, Any]:
    """Return the first of the objectives, as Optuna's pictures take it."""
    first_name, *other_names = _target_names(record)
    if other_names:
        return {"target_name": first_name, "target": lambda trial: trial.values[0]}
    return {"target_name": first_name}


def _front(record: Record) -> Axes:
    axes: Axes = pictures.plot_pareto_front(record.study, target_names=_target_names(record))
    return axes


def _amount(record: Record) -> str:
    words = {TrialState.COMPLETE: "complete", TrialState.PRUNED: "stopped early", TrialState.FAIL: "failed"}
    states = [trial.state for trial in record.ended]
    counts = [f"{states.count(state)} {word}" for state, word in words.items() if state in states]
    seeds = counted(len(record.budget.seeds), "seed")
    trials = counted(len(states), "trial")
    return f"{trials} ({', '.join(counts)}); {seeds}, {record.budget.steps:,} steps each"


def _tables(record: Record) -> list[tuple[int, str]]:
    """Return the thesis's tables with which a search starts, each with its trial."""
    starts = enumerate(record.search.start)
    return [(number, start) for number, start in starts if isinstance(start, str) and start in TABLES]


def _importances(record: Record) -> Axes:
    """Draw how well each parameter separates the best trials from the others (Watanabe et al. 2023)."""
    complete = record.complete
    share = max(BEST_SHARE, BEST_TRIALS / len(complete))
    evaluator = PedAnovaImportanceEvaluator(target_quantile=share)
    (objective, *_) = record.search.objectives.values()
    sign = -1 if objective.direction == "maximize" else 1  # it asks what makes a target low
    # Of equally important ones the first comes first: a set's order would change from process to process.
    parameter_names = sorted(set.intersection(*(set(trial.params) for trial in complete)))
    axes: Axes = pictures.plot_param_importances(
        record.study,
        evaluator,
        params=parameter_names,
        target=lambda trial: sign * trial.values[0],
        target_name=_target_names(record)[0],
    )
    names = [tick_label.get_text().replace("_", " ") for tick_label in axes.get_yticklabels()]
    axes.set_yticks(axes.get_yticks(), names)
    axes.xaxis.set_label_text("Importance")
    axes.yaxis.set_label_text("")
    return axes


def _history(record: Record) -> Axes:
    """Draw every trial's value and the best so far, with the trials of the thesis's tables."""
    axes: Axes = pictures.plot_optimization_history(record.study, **_target(record))
    for line in axes.lines:  # none for several objectives
        line.set_label("best so far")
    value_by_trial = {trial.number: trial.values[0] for trial in record.ended if trial.values}
    for number, base in _tables(record):
        if number in value_by_trial:
            marker, _ = TABLES[base]
            axes.plot(number, value_by_trial[number], marker, color=INK, zorder=4, label=TABLE_LABELS[base])
    axes.set_xlim(-1, record.ended[-1].number + 1)  # a generation may have trials beyond the budget
    axes.legend()
    return axes


def _slices(record: Record) -> Any:
    """Draw trials over the values of each parameter, in rows, with the values of the thesis's tables."""
    panels: Any = np.ravel(np.array(pictures.plot_slice(record.study, **_target(record))))
    figure = panels[0].figure
    row_count = math.ceil(len(panels) / COLUMNS)
    figure.set_size_inches(WIDTH, ROW_INCHES * row_count + 0.7)
    panel_grid = figure.add_gridspec(row_count, min(COLUMNS, len(panels)))
    lines_by_table: dict[str, Any] = {}
    for position, axes in enumerate(panels):
        parameter, has_choices = axes.xaxis.get_label_text(), axes.xaxis.have_units()
        for _, base in _tables(record):
            params = record.search.params_of(base)
            if parameter in params:
                value = repr(params[parameter]) if has_choices else params[parameter]
                _, line = TABLES[base]
                lines_by_table[base] = axes.axvline(
                    value, color=INK, linewidth=0.8, linestyle=line, zorder=1.2
                )
        for points in axes.collections:
            points.set_cmap(LATE_BLUES)
        row, column = divmod(position, COLUMNS)
        axes.set_subplotspec(panel_grid[row, column])
        axes.tick_params(labelleft=column == 0)
        axes.xaxis.set_label_text(parameter.replace("_", " "))
        axes.yaxis.set_label_text("")
        if has_choices:
            choices = [tick_label.get_text().strip("'[]\"") for tick_label in axes.get_xticklabels()]
            look: Any = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"}
            if len("  ".join(choices)) <= LETTERS_ACROSS:
                look = {}
            axes.set_xticks(range(len(choices)), choices, **look)
        elif axes.get_xscale() == "log":
            axes.xaxis.set(major_locator=LogLocator(numticks=5), minor_locator=NullLocator())
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    figure.supylabel(_target_names(record)[0], fontsize=style.TYPE_POINTS)
    if lines_by_table:
        table_names = [TABLE_LABELS[base] for base in lines_by_table]
        figure.legend(
            lines_by_table.values(), table_names, loc="outside lower center", ncols=len(table_names)
        )
    return panels
