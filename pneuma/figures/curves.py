"""Figures of curves: a panel for each quantity, and for each world.

A line is the mean over runs, in a band that the legend describes. In panels of few conditions each line has
its name and the number of its runs at its end; else they are in the legend.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from pneuma.analysis.curves import BANDS, checked_band, curve_names
from pneuma.analysis.outcomes import have_one_return
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError, counted
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel, in_grid
from pneuma.figures.lines import QUANTITIES, USUAL_BAND, Column
from pneuma.figures.origin import Sample, samples_of
from pneuma.figures.words import after_thesis, fits_panel, headline_of, merge_notes
from pneuma.study.quantities import EPISODE_QUANTITIES

USUAL_QUANTITIES = ("return", "share_killed", "success")


def curves_page(
    studies: StudyData | Mapping[str, StudyData | None],
    quantities: str | Sequence[str] = (),
    band: str | None = None,
    window: str | None = None,
    *,
    beside: StudyData | None = None,
    basename: str = "",
    log: bool = False,
) -> Page:
    """Return the figure of the curves of a study's finished runs.

    Args:
        studies: the study; or its runs in each world, by the title of a column, which is narrow if there are
            none. The quantities are the rows then.
        quantities: of `curve_names`; default: the return and the share killed, as far as recorded. If returns
            are of different rewards, the length of episodes replaces them.
        band: one of `BANDS`; default: the deviation, and inside it the interval of the mean.
        window: one of the study's windows; default: the first.
        beside: another study, whose runs are dashed lines.
        log: whether axes of values are logarithmic.
        basename: of the files; default: of a single study its figure, and how this one differs from the
            usual.

    Raises:
        UserError: for more conditions than a panel can show, a quantity that the study's data does not have,
            or a band that runs are too few for.
    """
    columns = {"": studies} if isinstance(studies, StudyData) else studies
    data = next(filter(None, columns.values()))
    if not all(fits_panel(each) for each in columns.values() if each):
        most = f"pick {style.MOST_IN_A_PANEL} at most by --condition, or --figure summary"
        raise UserError(f"study {data.study.name}: its conditions do not fit one panel: {most}")
    names = [quantities] if isinstance(quantities, str) else [*dict.fromkeys(quantities)]
    names = names or usual_quantities(data)
    drawn = {
        title: Column(
            each,
            names if len(columns) == 1 else _known(each, names),
            _asked_band(each, band),
            window,
            beside,
            log=log,
        )
        for title, each in columns.items()
        if each
    }
    runs = samples_of(*(each.data for each in drawn.values()), *filter(None, [beside]))
    if len(columns) > 1:
        name = basename or data.basename(*_differences(next(iter(drawn.values()))))
        return _columns_page({title: drawn.get(title) for title in columns}, names, name, runs)
    (column,) = drawn.values()
    rows = -(-len(column.quantities) // style.COLUMNS)
    across = -(-len(column.quantities) // rows)
    return Page(
        basename or data.basename(*_differences(column)),
        in_grid([column.panel(name) for name in column.quantities], across),
        rows * style.PANEL_INCHES * (1.2 if across == 1 else 1),
        headline_of(data),
        runs,
        column.meanings,
        column.notes,
    )


def _known(data: StudyData, quantities: Sequence[str]) -> list[str]:
    return [name for name in quantities if name in curve_names(data)]


def _joint_label(condition: str, columns: Iterable[Column]) -> str:
    counts: list[int] = []
    names: dict[str, str] = {}
    for column in columns:
        counts.append(len(column.data.of_condition(condition)))
        names |= column.data.study.labels
    return f"{names.get(condition, condition)} ({', '.join(map(str, counts))})"


def usual_quantities(data: StudyData) -> list[str]:
    known = curve_names(data)
    wanted = USUAL_QUANTITIES if have_one_return(data) else ("length", "share_killed", "success")
    return [name for name in wanted if name in known] or known[:1] or ["return"]


def _asked_band(data: StudyData, band: str | None) -> str:
    """Refuse a band that was asked for and could not be drawn, as runs are too few."""
    name = checked_band(band or USUAL_BAND)
    for condition in data.conditions if band else ():
        if 0 < (count := len(data.of_condition(condition))) < BANDS[name].least_runs:
            runs, least = counted(count, "run"), BANDS[name].least_runs
            raise UserError(f"--band {band}: {condition} has {runs}, and it needs {least}; try --band runs")
    return name


def _differences(column: Column) -> list[str]:
    """Return how a figure differs from the study's usual one, for the name of its files."""
    data, names, differs = column.data, list(column.quantities), []
    if names != usual_quantities(data):
        differs.append("all" if names == curve_names(data) else "-".join(names))
    differs += [column.band] * (column.band != USUAL_BAND) + ["log"] * column.log
    if column.window and column.window != data.windows[0] and {*names} & {*EPISODE_QUANTITIES}:
        differs.append(column.window.removesuffix("%"))
    return [*differs, *(["beside", column.beside.study.name] if column.beside else [])]


# --- Worlds beside each other ------------------------------------------------------------------------


def _columns_page(
    columns: Mapping[str, Column | None], quantities: Sequence[str], basename: str, runs: Sequence[Sample]
) -> Page:
    """Return a column for each world, and a row for each quantity."""
    drawn = {title: column for title, column in columns.items() if column}
    by_world = len({column.data.world for column in drawn.values()}) > 1
    first = next(iter(drawn))
    notes = merge_notes({title: (column.data, column.notes) for title, column in drawn.items()})
    together = len(drawn) > style.COLUMNS or not all(column.at_ends for column in drawn.values())
    if together:  # one legend for all columns
        notes.append("In brackets: runs in each column.")
        every = dict.fromkeys(name for column in drawn.values() for name in column.data.study.conditions)
        labels = {name: _joint_label(name, drawn.values()) for name in every}
        drawn = {title: replace(column, labels=labels) for title, column in drawn.items()}

    def panel(title: str, name: str) -> Panel | None:
        column, top, low = drawn.get(title), name == quantities[0], name == quantities[-1]
        if column is None:
            return grid.no_runs(title * top)
        if name not in column.curves:
            return None
        label, steps = QUANTITIES[name].title * (title == first), "Environment steps" * low
        return replace(column.panel(name), title=title * top, x=steps, y=label)

    title = drawn[first].data.study.title
    meanings = {word: artist for column in drawn.values() for word, artist in column.meanings.items()}
    return Page(
        basename,
        [[panel(title, name) for title in columns] for name in quantities],
        0.95 * len(quantities) * style.PANEL_INCHES,
        ": ".join(filter(None, [title, after_thesis(basename) or "by world" * by_world])),
        runs,
        meanings,
        notes,
        [1 if title in drawn else grid.EMPTY_WIDTH for title in columns],
    )
