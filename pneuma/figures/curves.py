"""Figures of curves: a panel for each quantity, and for each world.

A line is the mean over runs, in a band that the legend describes. In panels of few conditions each line has
its name and the number of its runs at its end; else they are in the legend.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Patch

from pneuma.analysis.curves import STEPS, curve_names
from pneuma.analysis.environments import OUTCOME, Parts, environments, in_environment_of, profiles, references
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError, unknown_name
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel, in_grid
from pneuma.figures.lines import PALE, QUANTITIES, USUAL_BAND, X_LABELS, Column, usual_quantities
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.words import after_thesis, fits_panel, headline_of, merge_notes, styles_of
from pneuma.store.quantities import EPISODE_QUANTITIES

BAND_OF_PROFILES = "95 % band, stratified bootstrap"


def curves_page(
    studies: StudyData | Mapping[str, StudyData],
    quantities: str | Sequence[str] = (),
    basename: str = "",
    beside: StudyData | None = None,
    **how: Any,
) -> Page:
    """Return the figure of the curves of a study's finished runs.

    Args:
        studies: the study; or its runs in each world, by the title of a column. The quantities are the rows
            then.
        quantities: of `curve_names`; default: the return, in other environments than Pneuma's that of
            evaluations, and the share killed, as far as recorded. If returns are of different rewards, the
            length of episodes replaces them.
        basename: of the files; default: of a single study its figure, and how this one differs from the
            usual.
        beside: another study, whose runs are drawn in the columns of their environment.
        how: band, window, log, x and center, as `Column` has them.

    Raises:
        UserError: for more conditions than a panel can show, a quantity that the study's data does not have,
            a band that runs are too few for, or runs beside that are all of other environments.
    """
    columns = {"": studies} if isinstance(studies, StudyData) else studies
    data, alone = next(iter(columns.values())), len(columns) == 1
    if not all(map(fits_panel, columns.values())):
        most = f"pick {style.MOST_IN_A_PANEL} at most by --condition, or --figure summary"
        raise UserError(f"study {data.study.name}: its conditions do not fit one panel: {most}")
    names = [quantities] if isinstance(quantities, str) else [*dict.fromkeys(quantities)]
    names = [*filter(None, names)] or usual_quantities(data, beside)
    others = {title: beside and in_environment_of(each, beside) for title, each in columns.items()}
    if beside and not any(others.values()):
        its, own = (" and ".join(environments(each)) for each in (beside, data))
        raise UserError(f"--beside {beside.study.name}: its runs are of {its}, and not of {own}")
    having = _having(columns, names)
    drawn = {
        title: Column(columns[title], known, beside=others[title], **how) for title, known in having.items()
    }
    first = next(iter(drawn.values()))
    stem = basename or data.basename(*_differences(first, names, beside))
    if alone:
        rows = -(-len(names) // style.COLUMNS)
        across = -(-len(names) // rows)
        panels = in_grid([first.panel(name) for name in names], across)
        inches = rows * style.PANEL_INCHES * (1.2 if across == 1 else 1)
        headline, notes = headline_of(data), first.notes
    else:
        panels, notes = _in_columns(drawn, names)
        inches = 0.95 * len(names) * style.PANEL_INCHES
        by_world = len({each.world for each in columns.values()}) > 1
        shown = after_thesis(stem) or "by world" * by_world
        headline = ": ".join(filter(None, [data.study.title, shown]))
    runs = lines_of_runs(*columns.values(), *dict.fromkeys(filter(None, others.values())))
    meanings = {word: artist for column in drawn.values() for word, artist in column.meanings.items()}
    widths = None if alone else [1.0] * len(drawn)
    spare = alone and not quantities
    return Page(stem, panels, inches, headline, runs, meanings, notes, widths, spare)


def _having(columns: Mapping[str, StudyData], names: Sequence[str]) -> dict[str, list[str]]:
    """Return those of some quantities that each column has, without columns that have none.

    Raises:
        UserError: for a quantity that no column has.
    """
    known = {title: curve_names(data) for title, data in columns.items()}
    every, data = dict.fromkeys(chain.from_iterable(known.values())), next(iter(columns.values()))
    for name in names:
        if name not in every:
            raise unknown_name(f"curve in {data.what} of study {data.study.name}", name, every)
    having = {title: [name for name in names if name in of] for title, of in known.items()}
    return {title: kept for title, kept in having.items() if kept}


def plot_curves(data: StudyData, quantity: str = "", ax: Axes | None = None, **how: Any) -> Axes:
    """Draw a study's curves of one quantity into axes, by default the current ones: `pneuma.api.plot`."""
    if ax is None:
        from matplotlib import pyplot

        ax = pyplot.gca()
    column = Column(data, [quantity or usual_quantities(data)[0]], ends=False, **how)
    (name,) = column.curves
    width = ax.get_window_extent().width / ax.figure.dpi
    grid.fill(ax, column.panel(name), grid.ROW_INCHES, width)
    ax.legend()
    return ax


def _differences(column: Column, names: Sequence[str], beside: StudyData | None) -> list[str]:
    """Return how a figure differs from the study's usual one, for the name of its files."""
    data, differs = column.data, []
    if names != usual_quantities(data):
        differs.append("all" if names == curve_names(data) else "-".join(names))
    differs += [column.bands[0]] * (column.band is not None and column.bands[0] != USUAL_BAND)
    differs += [column.center] * (column.center != "mean") + ["log"] * column.log
    differs += [f"over-{column.x}"] * (column.x != STEPS)
    if column.window and column.window != data.windows[0] and {*names} & {*EPISODE_QUANTITIES}:
        differs.append(column.window.removesuffix("%"))
    return [*differs, *(["beside", beside.study.name] if beside else [])]


# --- Scores over several environments ------------------------------------------------------------------


def profile_page(data: StudyData, parts: Parts, outcome: str = OUTCOME) -> Page:
    """Return performance profiles (Agarwal et al. 2021): the share of runs above each score.

    Scores are those of `pneuma.analysis.environments.scores`, over all environments together.
    """
    table, looks = profiles(parts, outcome), styles_of(next(iter(parts.values())))

    def draw(axes: Axes) -> None:
        for condition, frame in table.groupby("condition", sort=False):
            colour = looks[str(condition)]["color"]
            grid.draw_band(axes, frame, None, color=colour, alpha=PALE)
            label = f"{condition} ({frame['runs'].iloc[0]})"
            axes.plot(frame["x"], frame["centre"], color=colour, label=label)
        axes.set(xlim=(table["x"].min(), table["x"].max()), ylim=(0, 1 + grid.BELOW_ZERO))

    panel = Panel(draw, x="Score", y="Share of runs above it", y_ticks=grid.shares)
    meanings = {BAND_OF_PROFILES: Patch(color=style.INK, alpha=PALE, linewidth=0)}
    words = find_outcome(outcome).words
    scales = []
    for env, (low, high) in references(parts, outcome).items():
        of = "" if env in data.study.scores else " (random player, best condition)"
        scales.append(f"{grid.number(low)} and {grid.number(high)} in {env}{of}")
    notes = [f"Score: {words}; 0 and 1 are {', '.join(scales)}.", data.ends]
    headline = headline_of(data, "performance profiles")
    stem, inches = data.basename("profile"), 1.2 * style.PANEL_INCHES
    return Page(stem, [[panel]], inches, headline, lines_of_runs(data), meanings, notes)


# --- Worlds beside each other ------------------------------------------------------------------------


def _in_columns(
    drawn: dict[str, Column], quantities: Sequence[str]
) -> tuple[list[list[Panel | None]], list[str]]:
    """Return a column for each world, and a row for each quantity; and the notes on them."""
    notes = merge_notes({title: (column.data, column.notes) for title, column in drawn.items()})
    if len(drawn) > style.COLUMNS or not all(column.at_ends for column in drawn.values()):
        notes.append("In brackets: runs in each column.")  # one legend for all
        every = dict.fromkeys(name for column in drawn.values() for name in column.data.study.conditions)
        labels = {name: _joint_label(name, drawn.values()) for name in every}
        drawn = {title: replace(column, labels=labels, ends=False) for title, column in drawn.items()}
    first = next(iter(drawn))

    def panel(title: str, column: Column, name: str) -> Panel | None:
        top, low = name == quantities[0], name == quantities[-1]
        if name not in column.curves:
            return None
        along = X_LABELS[column.x] * low
        left = replace(column.panel(name), title=title * top, x=along, y=QUANTITIES[name].title)
        return left if title == first else replace(left, y="", at_left=left)

    return [[panel(*each, name) for each in drawn.items()] for name in quantities], notes


def _joint_label(condition: str, columns: Iterable[Column]) -> str:
    counts: list[int] = []
    names: dict[str, str] = {}
    for column in columns:
        counts.append(len(column.data.of_condition(condition)))
        names |= column.data.study.labels
    return f"{names.get(condition, condition)} ({', '.join(map(str, counts))})"
