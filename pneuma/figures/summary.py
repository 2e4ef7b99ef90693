"""The figure of what a study's runs came to: every run, means with intervals, profiles, improvement.

It shows the share of monsters killed at the end, or the return where nobody could be killed or no
evaluations are held. Of many crossed conditions each cell is a panel of its own, with rows alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from pneuma.analysis.coverage import is_trusted
from pneuma.analysis.curves import curve_names
from pneuma.analysis.estimates import performance_profile
from pneuma.analysis.intervals import LEAST_RESAMPLED
from pneuma.analysis.outcomes import PRIMARY, find_outcome, is_return, outcome_values
from pneuma.analysis.references import have_one_return
from pneuma.analysis.run_view import common_step
from pneuma.analysis.summaries import summary_table
from pneuma.analysis.tables import StudyData
from pneuma.figures.captions import absent_told, forks_told, headline_of, looks_told, step_told
from pneuma.figures.crossed import are_crossed, row_names
from pneuma.figures.looks import MOST_IN_A_PANEL, condition_looks
from pneuma.figures.panel import per_cent, whole_ticks
from pneuma.figures.sizes import SIZES, Size
from pneuma.figures.style import house_style, save_figure
from pneuma.figures.summary_cells import draw_cells
from pneuma.figures.summary_rows import (
    ROW_LINES,
    Rows,
    Values,
    dense,
    draw_interval,
    label_rows,
    row_entries,
)
from pneuma.figures.words import Words, wrap_label

WITHOUT_EVALUATIONS = "final-return"
LABEL_LINE = 0.7
"""How far apart rows are for each line of their names, in parts of the usual distance."""
LONGEST_INCHES = 7.6
"""Of the rows: with what is said around them a figure still fits a page."""
LABEL_CHARACTERS = 32
"""Of a line of a condition's name at most, so that it leaves room for the panels."""
MOST_ROWS = 24
"""Conditions up to which crossed ones, too, are rows one below the other."""


def draw_summary(
    data: StudyData, folder: Path, formats: tuple[str, ...] = ("png", "svg"), *, size: str = "page"
) -> list[Path]:
    """Draw what the runs of every condition came to; return the files written.

    Args:
        data: the study.
        folder: where to write.
        formats: of `FIGURE_FORMATS`.
        size: one of `SIZES`.

    Raises:
        UserError: for more than a slide has room for.
    """
    how = SIZES[size]
    outcome = shown_outcome(data)
    table = summary_table(data, [outcome])
    own = table[table["outcome"] == outcome]
    with house_style(how.type_points):
        figure = _figure(data, outcome, own, how)
        return save_figure(figure, folder, summary_stem(data, size), formats, how.dots_per_inch)


def summary_stem(data: StudyData, size: str) -> str:
    """Return the name of a summary's files."""
    return "-".join([data.figure, "summary", *([] if size == "page" else [size])])


def shown_outcome(data: StudyData) -> str:
    """Return the outcome that is drawn."""
    return PRIMARY if "share_killed" in curve_names(data) else WITHOUT_EVALUATIONS


def _figure(data: StudyData, outcome: str, table: pd.DataFrame, size: Size) -> Figure:
    values = {name: _known(data, name, outcome) for name in data.conditions if data.of_condition(name)}
    rows = Rows(data, outcome, values, table)
    if len(values) > MOST_ROWS and are_crossed(list(values)):
        words = _words(data, outcome, values, table[table["statistic"] != "improvement"])
        return draw_cells(rows, size, words)
    figure = Figure(figsize=(size.width, size.height or size.width), layout="constrained")
    labels, told = _labels(values, size)
    usual = ROW_LINES * size.line_inches
    lines = max(label.count("\n") + 1 for label in labels)
    wanted = usual * max(1, LABEL_LINE * lines)
    pitch = min(wanted, LONGEST_INCHES / len(values))
    rows_inches = pitch * len(values) + 0.75
    improved = table[table["statistic"] == "improvement"]
    profiled = len(values) <= MOST_IN_A_PANEL
    panels = [
        rows_inches,
        *([rows_inches] if len(improved) else []),
        *([size.panel_height] if profiled else []),
    ]
    stacked = size.columns == 1
    places = figure.subplots(
        len(panels) if stacked else 1,
        1 if stacked else len(panels),
        squeeze=False,
        height_ratios=panels if stacked else None,
    ).ravel()
    with dense(pitch / wanted):
        _draw_runs(places[0], rows, labels)
        if len(improved):
            _draw_improvement(places[1], data, list(values), improved, labels if stacked else ())
    if profiled:
        _draw_profiles(places[-1], rows)
    words = _words(data, outcome, values, table)
    words = replace(words, caption=[*words.caption, *filter(None, [told])])
    low, high = words.put(figure, size, sum(panels) if stacked else max(panels), row_entries(places[0]))
    size.check_room(1 + len(values) // 3, high - low)
    return figure


def _labels(values: Values, size: Size) -> tuple[list[str], str]:
    """Return every condition's words beside its row, and what these are if that is not said."""
    characters = min(LABEL_CHARACTERS, size.characters(size.type_points) // 3)
    names, told = row_names(list(values), characters)
    counted = (f"{name} (n = {len(runs)})" for name, runs in zip(names, values.values(), strict=True))
    return ["\n".join(wrap_label(label, characters)) for label in counted], told


def _words(data: StudyData, outcome: str, values: Values, table: pd.DataFrame) -> Words:
    return Words(headline_of(data, "at the end of training"), "", _caption(data, outcome, values, table))


def _known(data: StudyData, condition: str, outcome: str) -> np.ndarray:
    values = outcome_values(data, condition, outcome, common_step(data))
    return values[np.isfinite(values)]


def _draw_runs(axes: Axes, rows: Rows, labels: Sequence[str]) -> None:
    rows.draw(axes, {name: place for place, name in enumerate(rows.values)})
    label_rows(axes, labels)
    axes.set(title="Every run", xlabel=rows.label)
    rows.set_axis(axes)


def _draw_improvement(
    axes: Axes, data: StudyData, shown: Sequence[str], table: pd.DataFrame, labels: Sequence[str]
) -> None:
    looks = condition_looks(data.conditions)
    for one in table.itertuples():
        sure = np.isfinite(float(one.low))  # type: ignore[arg-type]
        face = looks[str(one.condition)]["color"] if sure else "white"
        draw_interval(axes, one, shown.index(str(one.condition)), "o", face)
    axes.axvline(0.5, color="#666666", linewidth=0.9, zorder=1.2)
    if (baseline := data.record["baseline"]) in shown:
        place = (0.5, shown.index(baseline))
        axes.annotate(
            "baseline", place, (4, 0), textcoords="offset points", size="small", color="#666666", va="center"
        )
    axes.set(xlim=(0, 1), title="Against the baseline", xlabel="Probability of being better")
    label_rows(axes, labels or [""] * len(shown))


def _draw_profiles(axes: Axes, rows: Rows) -> None:
    """Draw the share of runs above every level: whoever's line is higher is better at that level."""
    pooled = np.concatenate(list(rows.values.values()))
    if not len(pooled):
        return
    levels = np.linspace(0 if rows.are_shares else pooled.min(), pooled.max(), 201)
    looks = condition_looks(rows.data.conditions)
    for condition, runs in rows.values.items():
        if len(runs):
            look = {**looks[condition], "marker": ""}
            axes.step(levels, performance_profile(runs, levels), where="post", **look)
    axes.set(title="Runs above a level", xlabel=rows.label)
    axes.set(ylabel="Share of runs", ylim=(0, 1.02))
    axes.xaxis.set_major_locator(whole_ticks(4))
    axes.yaxis.set_major_formatter(FuncFormatter(per_cent))
    if rows.are_shares:
        axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def _caption(data: StudyData, outcome: str, values: Values, table: pd.DataFrame) -> list[str]:
    known_outcome = find_outcome(outcome)
    shown = known_outcome.words
    words = [f"{', '.join(data.environments)}. {shown[:1].upper()}{shown[1:]}."]
    words += [*forks_told(data), *looks_told(data)]
    if len(values) <= MOST_IN_A_PANEL:
        words.append("Runs above a level: in the colours of the rows.")
    words += step_told(data)
    improved = table[table["statistic"] == "improvement"]
    if len(improved):
        resampled = min(len(known) for known in values.values()) >= LEAST_RESAMPLED
        why = ": no resample differs" if resampled else ""
        hollow = f"; hollow where there is none{why}" if improved["low"].isna().any() else ""
        words.append(
            "Against the baseline: the probability that a run is better than one of "
            f"{data.record['baseline']}, a tie being half of it, with 95 % intervals (bootstrap){hollow}."
        )
    words += absent_told(data)
    for name, known in values.items():
        total = len(data.of_condition(name))
        if len(known) < total:
            words.append(
                f"{total - len(known)} of {total} runs of {name} have no value, and count nowhere here."
            )
    if known_outcome.bounds == (0.0, 1.0) and (table["low"] < 0).any():
        words.append("Intervals are cut off below 0 %.")
    counts = [len(known) for known in values.values()]
    if is_return(outcome) and not have_one_return(data):
        words.append("Returns of unlike rewards, or of more players, cannot be compared.")
    if any(0 < count < LEAST_RESAMPLED for count in counts):
        words.append("Of fewer than three runs there is no bootstrap interval, of one none at all.")
    if any(count >= LEAST_RESAMPLED and not is_trusted("bootstrap", count) for count in counts):
        words.append("With so few runs bootstrap intervals cover less often than in 95 % of cases.")
    return words
