"""The figures of a search: its trials, and how its winner does on fresh seeds.

RecordedSearch → panels → Page (`grid.py`)
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator
from optuna.exceptions import ExperimentalWarning
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances

from pneuma.analysis.frames import StudyData
from pneuma.analysis.outcomes import find_outcome, outcome_values
from pneuma.errors import counted
from pneuma.figures import grid
from pneuma.figures.grid import Page, Panel, in_grid
from pneuma.figures.origin import sample, samples_of
from pneuma.figures.style import COLOURS, GREY, INK, MARKERS, TYPE_POINTS
from pneuma.figures.words import capital, headline_of, notes_of
from pneuma.search.optuna_study import ended_study
from pneuma.search.promote import Gain, Winner, gains
from pneuma.search.space import Parameter
from pneuma.search.storage import RecordedSearch
from pneuma.search.trials import EndedTrial

COLUMNS = 4
LEAST_TRIALS, BEST_TRIALS, BEST_SHARE = 10, 5, 0.1
"""Share of the trials that importances treat as the best, though never fewer than five trials."""
COMPLETE, BEST = COLOURS[0], COLOURS[1]
ROW_INCHES = 1.75


def search_page(searched: RecordedSearch) -> Page | None:
    """Return the figure of a search; None before a trial is complete."""
    drawn = _Drawn(searched)
    if not drawn.complete:
        return None
    search, budget = searched.task.search, searched.task.budget
    importances = drawn.importances()
    wide = Panel(drawn.history, "History", "Trial", drawn.label, x_ticks=_whole, y_ticks=drawn.ticks)
    top: list[Panel | None] = [wide] * COLUMNS
    if importances:
        bars = Panel(partial(_draw_bars, shares=importances), "Importance", "Share")
        top = [*[wide] * (COLUMNS // 2), *[bars] * (COLUMNS // 2)]
    slices = [drawn.slice(each, i % COLUMNS == 0) for i, each in enumerate(search.space.parameters)]
    rows = [top, *in_grid(slices, COLUMNS)]
    if len(search.objectives) == 2:
        rows.append([Panel(drawn.front, "Both objectives", drawn.label, drawn.second)] * COLUMNS)
    elif len(search.space.parameters) > 1:
        rows.append([Panel(drawn.parallel, "Best trials")] * COLUMNS)
    ids = (run_id for trial in searched.trials for run_id in trial.run_ids)
    runs, caption = [sample(search.name, "", ids, budget.seeds)], drawn.caption(bool(importances))
    inches = ROW_INCHES * len(rows)
    return Page(f"search-{search.label}", rows, inches, search.title, runs, caption=caption)


class _Drawn:
    """A search as it is drawn: the first of its objectives, unless said otherwise."""

    def __init__(self, searched: RecordedSearch) -> None:
        self.search, self.task, self.trials = searched.task.search, searched.task, searched.trials
        self.complete = [trial for trial in self.trials if trial.state == "complete"]
        self.pruned = [trial for trial in self.trials if trial.state == "pruned"]
        best = searched.best
        front = best if isinstance(best, list) else [] if best is None else [best]
        self.best = [trial for trial in self.complete if trial.number in front]
        self.label, *more = [
            f"{capital(find_outcome(each.outcome).words.partition(',')[0])}, {each.over_seeds} of seeds"
            for each in self.search.objectives
        ]
        self.second = more[0] if more else ""
        shared = find_outcome(self.search.objectives[0].outcome).unit == "share"
        self.ticks = grid.shares if shared else grid.few

    @property
    def sign(self) -> int:
        return 1 if self.search.objectives[0].direction == "maximize" else -1

    def history(self, axes: Axes) -> None:
        """Draw every trial's value, and the best so far as steps."""
        self._points(axes, self.pruned, [trial.number for trial in self.pruned], pruned=True)
        self._points(axes, self.complete, [trial.number for trial in self.complete])
        values = [self.sign * trial.values[0] for trial in self.complete]
        best = self.sign * np.maximum.accumulate(values)
        last = self.trials[-1].number
        numbers = [*(trial.number for trial in self.complete), last]
        axes.step(numbers, [*best, best[-1]], where="post", color=BEST, linewidth=1.4, label="best so far")
        for base, number in self._starts().items():
            trial = self.trials[number]
            if trial.values:
                marker = MARKERS[1 + TABLES.index(base)]
                look: Any = {"marker": marker, "color": INK, "markersize": 5, "linestyle": ""}
                axes.plot([number], trial.values[:1], label=base, zorder=4, **look)
        axes.set_xlim(-0.5, last + 0.5)

    def _starts(self) -> dict[str, int]:
        """Return the numbers of the trials of the bases that the search starts with."""
        return {
            base: number
            for number, base in enumerate(self.search.spec.start)
            if number < len(self.trials) and base in TABLES
        }

    def _points(
        self, axes: Axes, trials: Sequence[EndedTrial], places: Sequence[float], pruned: bool = False
    ) -> None:
        look: Any = {"marker": "x", "color": GREY} if pruned else {"marker": "o", "color": COMPLETE}
        if not trials:  # nor is it in the legend
            return
        label = "stopped early, at its last value" if pruned else "complete trial"
        axes.plot(
            places, [trial.values[0] for trial in trials], linestyle="", markersize=3, alpha=0.65,
            markeredgewidth=0.8 if pruned else 0, label=label, **look,
        )  # fmt: skip

    def slice(self, parameter: Parameter, first: bool) -> Panel:
        """Return the panel of one parameter: values of trials over its values; the first has numbers."""
        draw = partial(self._slice, parameter=parameter)
        x_ticks = partial(_choices, parameter=parameter) if parameter.choices else grid.few
        if parameter.log:
            x_ticks = _logarithmic

        def y_ticks(axis: Axis) -> None:
            self.ticks(axis)
            axis.set_tick_params(labelleft=first)

        return Panel(draw, parameter.name.replace("_", " "), x_ticks=x_ticks, y_ticks=y_ticks)

    def _slice(self, axes: Axes, parameter: Parameter) -> None:
        for trials, pruned in ((self.pruned, True), (self.complete, False)):
            having = [trial for trial in trials if parameter.name in trial.params]
            self._points(axes, having, [_place(parameter, trial) for trial in having], pruned)
        for trial in self.best[:1]:
            if parameter.name in trial.params:
                look: Any = {"marker": "D", "color": BEST, "markersize": 5, "linestyle": ""}
                axes.plot([_place(parameter, trial)], trial.values[:1], label="best", zorder=4, **look)
        for base in self._starts():
            params = self.search.space.params_of(base)
            if parameter.name in params:
                value = params[parameter.name]
                at = [*parameter.choices].index(value) if parameter.choices else value
                line: Any = {"color": INK, "linewidth": 0.8, "linestyle": (":", "--")[TABLES.index(base)]}
                axes.axvline(at, zorder=1.2, label=f"value of {base}", **line)

    def front(self, axes: Axes) -> None:
        """Draw both objectives of every trial, those of the Pareto front joined."""
        places = np.array([trial.values for trial in self.complete])
        axes.plot(places[:, 0], places[:, 1], linestyle="", marker="o", markersize=3, color=COMPLETE)
        best = np.array(sorted(trial.values for trial in self.best))
        axes.plot(best[:, 0], best[:, 1], marker="D", markersize=4, color=BEST, label="Pareto front")

    def parallel(self, axes: Axes) -> None:
        """Draw each complete trial as a line through its values, each from 0 to 1; the best in front."""
        ranked = sorted(self.complete, key=lambda trial: self.sign * trial.values[0])
        best = min(max(BEST_TRIALS, math.ceil(BEST_SHARE * len(ranked))), len(ranked))
        for rank, trial in enumerate(ranked):
            heights = [_height(each, trial.params) for each in self.search.space.parameters]
            good = rank >= len(ranked) - best
            look: Any = {"color": BEST, "alpha": 0.8} if good else {"color": COMPLETE, "alpha": 0.15}
            label = f"best {counted(best, 'trial')}" if rank == len(ranked) - 1 else None
            axes.plot(range(len(heights)), heights, linewidth=1.0 if good else 0.6, label=label, **look)
        names = [each.name.replace("_", "\n") for each in self.search.space.parameters]
        axes.set_xticks(range(len(names)), names, fontsize=0.8 * TYPE_POINTS)
        axes.set_yticks([0, 1], ["least", "greatest"])
        axes.set_ylim(-0.08, 1.08)

    def importances(self) -> dict[str, float]:
        """Return each parameter's share of the importance, by PED-ANOVA; none of one, or from too few trials.

        It asks what tells the best tenth of the trials from the others (Watanabe et al. 2023).
        """
        values = sorted((self.sign * trial.values[0] for trial in self.complete), reverse=True)
        share = max(BEST_SHARE, BEST_TRIALS / max(len(values), 1))
        if (
            len(self.search.space.parameters) < 2
            or len(values) < LEAST_TRIALS
            or values[math.ceil(share * len(values)) - 1] == values[-1]
        ):
            return {}
        study = ended_study(self.trials, self.search, objectives=1)
        with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
            evaluator = PedAnovaImportanceEvaluator(target_quantile=share)
            found = get_param_importances(study, evaluator=evaluator)  # equal ones in any order
        names = [each.name for each in self.search.space.parameters if each.name in found]
        return {name: found[name] for name in sorted(names, key=lambda name: -found[name])}

    def caption(self, importances: bool) -> list[str]:
        states = [trial.state for trial in self.trials]
        whole, *others = (
            f"{states.count(state)} {words}"
            for state, words in (("complete", ""), ("pruned", "more stopped early"), ("failed", "failed"))
        )
        others = [words for words in others if not words.startswith("0 ")]
        seeds, steps = counted(len(self.task.budget.seeds), "seed"), self.task.budget.steps
        trials = "; ".join([f"{whole}trials of {seeds} and {steps:,} steps each", *others])
        lines = [f"{trials}. Sampler: {self.search.spec.sampler.name}."]
        if importances:
            best = "five trials" if len(self.complete) * BEST_SHARE < BEST_TRIALS else "tenth of the trials"
            lines.append(f"Importance: which parameters tell the best {best} from the others (PED-ANOVA).")
        return lines


# --- Winners on fresh seeds -------------------------------------------------------------------------


def winners_page(basename: str, winners: Sequence[Winner], data: StudyData) -> Page:
    """Return how winners of searches do on fresh seeds, in the first of their objectives.

    A row for each: its base, the winner with the interval of its gain, and what the search had seen of it.
    """
    objective = winners[0].searched.task.search.objectives[0]
    measured, seeds = find_outcome(objective.outcome), len(data.of_condition(winners[0].tuned))
    words = capital(measured.words)
    found = {winner.name: gains(winner, data)[objective.name] for winner in winners}
    means = objective.over_seeds == "mean"
    sign = -1 if objective.direction == "maximize" else 1
    ranked = dict(sorted(found.items(), key=lambda pair: sign * pair[1].fresh))
    share = measured.unit == "share"
    runs = {
        winner.name: tuple(
            outcome_values(data, condition, objective.outcome) for condition in (winner.name, winner.tuned)
        )
        for winner in winners
    }
    panels = [
        Panel(
            partial(_draw_gains, found=ranked, runs=runs, from_zero=share),
            x=words if means else f"{words}, {objective.over_seeds} of seeds",
            x_ticks=grid.shares if share else grid.few,
            rows=[*ranked],
        )
    ]
    if shown := means and any(np.isfinite(gain.interval).all() for gain in found.values()):
        draw = partial(_draw_differences, found=[*ranked.values()])
        panels.append(Panel(draw, x="Tuned less untuned", x_ticks=grid.points if share else grid.few,
                            rows=[""] * len(ranked)))  # fmt: skip
    inches = max(grid.ROW_INCHES * len(ranked) + 0.7, 1.4)
    title = headline_of(data, f"{counted(seeds, 'fresh seed')}, {data.budget:,} steps")
    caption = [*notes_of(data), "Dots: runs. Right: the difference of means with its 95 % interval." * shown]
    widths = [2, 1] if shown else None
    return Page(basename, [panels], inches, title, samples_of(data), caption=caption, widths=widths)


def _draw_gains(
    axes: Axes, found: Mapping[str, Gain], runs: Mapping[str, tuple[np.ndarray, ...]], from_zero: bool
) -> None:
    """Draw a row for each gain: the runs of both conditions, and their values over seeds."""
    for place, (name, gain) in enumerate(found.items()):
        for values, colour in zip(runs[name], (COMPLETE, BEST), strict=True):
            axes.plot(values, [place + 0.22] * len(values), "o", color=colour, markersize=2.2, alpha=0.6)
        look: Any = {"markersize": 4.5, "linestyle": "", "color": COMPLETE, "zorder": 2.6}
        axes.plot([gain.fresh], [place], marker="D", **{**look, "color": INK, "markerfacecolor": BEST})
        axes.plot([gain.seen], [place], marker="o", markerfacecolor="white", **look)
        axes.plot([gain.fresh_baseline], [place], marker="o", **look)
    shown: Any = {"color": COMPLETE, "marker": "o", "linestyle": "", "markersize": 4.5}
    axes.plot([], [], label="untuned", **shown)
    axes.plot([], [], label="tuned", **{**shown, "marker": "D", "color": INK, "markerfacecolor": BEST})
    axes.plot([], [], label="tuned, as its search saw it", markerfacecolor="white", **shown)
    if from_zero:
        axes.set_xlim(left=0)


def _draw_differences(axes: Axes, found: Sequence[Gain]) -> None:
    axes.axvline(0, color=GREY, linewidth=0.8)
    for place, gain in enumerate(found):
        low, high = gain.interval
        row = {"value": gain.difference, "low": low, "high": high}
        grid.draw_interval(axes, place, row, markerfacecolor=BEST)


GOLDEN = (5**0.5 - 1) / 2
"""Its multiples lie evenly between whole numbers."""
TABLES = ("table-6-1", "table-6-2")
"""Bases whose values are marked: the thesis's."""


def _place(parameter: Parameter, trial: EndedTrial) -> float:
    """Return where a trial lies on a parameter's axis; those of one choice side by side, in their order."""
    value: Any = trial.params[parameter.name]
    if not parameter.choices:
        return float(value)
    return [*parameter.choices].index(value) + 0.5 * ((trial.number * GOLDEN) % 1 - 0.5)


def _height(parameter: Parameter, params: Mapping[str, Any]) -> float:
    """Return where a trial's value lies in its range, from 0 to 1; NaN if it lacks it."""
    if parameter.name not in params:
        return math.nan
    value = params[parameter.name]
    if parameter.choices:
        return [*parameter.choices].index(value) / (len(parameter.choices) - 1)
    low, high = parameter.extremes
    if parameter.log:
        low, high, value = math.log(low), math.log(high), math.log(value)
    return float((value - low) / (high - low))


def _draw_bars(axes: Axes, shares: Mapping[str, float]) -> None:
    """Draw importances as bars, the greatest at the top, each with its name at its end."""
    axes.barh(range(len(shares)), [*shares.values()], height=0.6, color=COMPLETE)
    for place, (name, share) in enumerate(shares.items()):
        small: Any = {"fontsize": 0.8 * TYPE_POINTS, "va": "center_baseline"}
        axes.annotate(name.replace("_", " "), (share, place), (3, 0), textcoords="offset points", **small)
    axes.set(xlim=(0, 1.6 * max(shares.values())), ylim=(len(shares) - 0.4, -0.6), yticks=())
    axes.grid(axis="y", visible=False)


def _whole(axis: Axis) -> None:
    axis.set_major_locator(MaxNLocator(8, integer=True, min_n_ticks=1))


def _logarithmic(axis: Axis) -> None:
    axis.axes.set_xscale("log")
    axis.set_major_locator(LogLocator(numticks=5))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: f"{value:g}")


def _choices(axis: Axis, parameter: Parameter) -> None:
    names = [re.sub(r'[\[\]"]', "", name).replace(", ", ",\n") for name in parameter.names]
    axis.axes.set_xticks(range(len(names)), names, rotation=40 if len(names) > MOST_UPRIGHT else 0)
    axis.axes.set_xlim(-0.5, len(names) - 0.5)


MOST_UPRIGHT = 4
"""Most choices whose names stand upright beside each other."""
