"""`pneuma study plot`, `table`, `export` and `publish`: files made from a study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.analysis import BAND_NAMES, EDGED_BANDS, EXPORT_SUFFIXES, EXPORT_TABLES, X_AXES
from pneuma.cli import options as opt
from pneuma.cli.output import (
    Result,
    check_file,
    keep_files,
    nothing_yet,
    read_formats,
    rows_result,
    say,
    write_file,
    wrote,
)
from pneuma.errors import Message, UserError, counted, unknown_name
from pneuma.store.quantities import (
    ACTION_QUANTITIES,
    CURVE_QUANTITIES,
    PUBLISHED_CURVES,
    TRAINING_QUANTITIES,
    WINDOWS,
)

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData
    from pneuma.figures.grid import Page

FIGURE_KINDS = ("curves", "summary", "profile", "one-action", "factors")
CURVES, SUMMARY, PROFILE, ONE_ACTION, FACTORS = FIGURE_KINDS
EVERY_QUANTITY, ACTIONS = "all", "actions"
_ENDINGS = ", ".join(EXPORT_SUFFIXES)
CURVE_OPTIONS = ("band", "window", "x", "log")
"""Options that only figures of curves have, beside --quantity and --beside."""


# --- plot -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawing:
    """What a figure shows, and how."""

    figure: Annotated[
        str | None,
        opt.choice(
            FIGURE_KINDS,
            "What it draws (default: curves of up to 7 conditions, else a summary).",
        ),
    ] = None
    quantity: Annotated[
        opt.SeveralRead,
        opt.choice(
            (*CURVE_QUANTITIES, ACTIONS, EVERY_QUANTITY),
            "A curve, as entropy; actions, or all (repeatable; default: share_killed and a return).",
            "NAME",
        ),
    ] = None
    band: Annotated[
        str | None,
        opt.choice(
            BAND_NAMES, "What the band shows (default: sd, and from 7 runs on the mean's interval in it)."
        ),
    ] = None
    window: Annotated[str | None, opt.choice(WINDOWS, "Episodes averaged at each point.")] = None
    x: Annotated[str | None, opt.choice(X_AXES, "Horizontal axis of curves (default: steps).")] = None
    beside: Annotated[
        opt.Several, opt.option("NAME", "Draw another study, or imported logs, in the same panels.")
    ] = None
    log: Annotated[bool, opt.flag("--log", "Use a logarithmic vertical axis.")] = False
    formats: opt.Formats = None
    width: Annotated[float, opt.option("INCHES", "Width in inches.", min=1.5, max=30)] = 7.0
    height: Annotated[
        float | None,
        opt.option("INCHES", "Total height in inches, headline and caption included.", min=1, max=30),
    ] = None
    title: Annotated[str | None, opt.option("TEXT", "Title instead of the study's.")] = None
    style: Annotated[str, opt.option("NAME|FILE", "A matplotlib style sheet, applied after Pneuma's.")] = ""
    plain: Annotated[bool, opt.flag("--plain", "Omit headline and caption, as for papers.")] = False

    @property
    def curve_options(self) -> dict[str, Any]:
        """Those of `CURVE_OPTIONS` that are given."""
        return {name: getattr(self, name) for name in CURVE_OPTIONS if getattr(self, name)}

    @property
    def is_of_curves(self) -> bool:
        return bool(self.quantity or self.beside or self.curve_options)


def plot(
    selection: opt.RunFilter,
    drawing: Drawing,
    names: Annotated[opt.Several, opt.argument("NAME", "Studies (default: all that were run).")] = None,
    out: opt.PlotFolder = None,
) -> Result:
    """Draw a study's learning curves, or a summary of its outcomes.

    A study of several environments has a panel for each.
    """
    if drawing.figure not in (None, CURVES) and drawing.is_of_curves:
        options = "--quantity, --band, --window, --x, --beside and --log"
        raise UserError(f"{options} require --figure {CURVES}")
    formats = read_formats(drawing.formats, out)
    nothing = nothing_yet(selection.store)
    if not names and nothing:
        raise UserError(nothing)
    from pneuma.figures.grid import save_page
    from pneuma.figures.style import Look

    look = Look(drawing.width, drawing.height, drawing.title, drawing.style, drawing.plain)
    beside_data = None
    if drawing.beside:
        if len(drawing.beside) > 1:
            raise UserError("--beside takes one study: import the logs of several under one --name")
        beside_data = _open_beside(selection, drawing.beside[0])
    if names:
        pages = [_draw(selection.open(name), drawing, beside_data) for name in names]
    else:
        pages = _draw_all(selection, drawing, beside_data)

    def save(folder: Path) -> Iterator[Path]:
        for page in pages:
            yield from save_page(page, folder, formats, look)

    figure_files = keep_files(selection.store, out, save)
    answers = [page.answer.document for page in pages if page.answer]
    return Result({"figures": figure_files, "answers": answers}, wrote(figure_files))


def _open_beside(selection: opt.RunFilter, name: str) -> StudyData:
    """Open the study that is drawn beside others: its conditions of the selected names, if it has some."""
    from pneuma.analysis.runs import configurations_of

    beside = opt.RunFilter(results=selection.results, world=selection.world)
    _, conditions, _ = configurations_of(selection.index, beside.query(name).study, selection.world)
    same_names = [condition for condition in selection.condition or () if condition in conditions]
    return replace(beside, condition=same_names or None).open(name)


def _draw_all(selection: opt.RunFilter, drawing: Drawing, beside_data: StudyData | None) -> list[Page]:
    """Return the figures of the studies that were run here and can be drawn."""
    from pneuma.analysis.runs import studies_here

    pages: list[Page] = []
    problems: list[UserError] = []
    for study_data in studies_here(selection.index, selection.world):
        if len(study_data.finished):
            try:
                opened_data = replace(selection, world=study_data.world or None).open(study_data.study.file)
                pages.append(_draw(opened_data, drawing, beside_data))
            except UserError as error:
                problems.append(error)
    if not pages:
        raise next(iter(problems), UserError(f"no run of a study has finished in {selection.store.root}"))
    for problem in problems:
        say(Message("Note: ", *problem.args, "."))
    return pages


def _draw(study_data: StudyData, drawing: Drawing, beside_data: StudyData | None) -> Page:
    """Return the figure of a study."""
    from pneuma.analysis.curves import find_curves
    from pneuma.analysis.drawing import run_table
    from pneuma.analysis.environments import columns_of, profile_scores
    from pneuma.analysis.summaries import show_outcomes
    from pneuma.figures import shares
    from pneuma.figures.curves import curves_page
    from pneuma.figures.origin import lines_of_runs
    from pneuma.figures.summary import summary_page
    from pneuma.figures.words import fits_panel

    columns, figure_kind = columns_of(study_data), drawing.figure
    if figure_kind is None:
        fit_panels = all(map(fits_panel, columns.values())) and not study_data.study.outcomes
        figure_kind = CURVES if drawing.is_of_curves or fit_panels else SUMMARY
    if figure_kind == PROFILE:
        return shares.profile_page(profile_scores(study_data))
    if figure_kind == ONE_ACTION:
        from pneuma.analysis.one_action import find_one_action  # SciPy's statistics take half a second

        return shares.one_action_page(find_one_action(study_data))
    if figure_kind == FACTORS:
        from pneuma.analysis.factors import compare_factors, factors_of
        from pneuma.figures.heat_map import heat_map_page

        factors = factors_of(next(iter(columns.values())))
        if len(factors) < 2:
            raise UserError(f"--figure {FACTORS} requires two factors; {study_data.label} has {len(factors)}")
        return heat_map_page(compare_factors(study_data, *factors[:2]))
    if figure_kind == SUMMARY:
        page = summary_page(show_outcomes(columns))
    elif figure_kind == CURVES:
        quantities = _quantities(study_data, drawing)
        page = curves_page(find_curves(columns, quantities, beside_data, **drawing.curve_options))
    else:
        raise NotImplementedError(f"a figure of kind {figure_kind}")
    if len(columns) > 1:  # under the names that contain the environment
        shown = filter(None, [study_data, beside_data])
        page = replace(page, runs=lines_of_runs(*(run_table({"": shown_data}) for shown_data in shown)))
    return page


def _quantities(study_data: StudyData, drawing: Drawing) -> list[str]:
    """Return the quantities to draw, with `all` and `actions` expanded."""
    from pneuma.analysis.curves import curve_names

    recorded = curve_names(study_data)
    actions = [quantity for quantity in ACTION_QUANTITIES if quantity in recorded]
    quantities_by_name = {EVERY_QUANTITY: recorded, ACTIONS: actions or [ACTIONS]}
    quantities: list[str] = []
    for quantity in drawing.quantity or ():
        quantities += quantities_by_name.get(quantity, [quantity])
    return quantities


# --- table ----------------------------------------------------------------------------------------

THESIS_TABLES = ("table-6-1", "table-6-2")
THESIS_ROWS = {
    "Discount γ": "gamma", "Learning rate α": "learning_rate", "GAE parameter λ": "gae_lambda",
    "Clipping parameter ϵ": "clip_range", "Horizon": "horizon", "Minibatch size": "minibatch",
    "Num. epochs": "epochs", "Value coefficient": "value_coefficient",
    "Entropy coefficient": "entropy_coefficient",
}  # fmt: skip
"""What the tables have, by the thesis's words."""


def table(
    names: Annotated[opt.Several, opt.argument("TABLE", "table-6-1, table-6-2 (default: both).")] = None,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Print the thesis's Tables 6.1 and 6.2: default and final hyperparameters."""
    from pneuma.presets import BASES
    from pneuma.values import format_short

    for table_name in names or ():
        if table_name not in THESIS_TABLES:
            raise unknown_name("table", table_name, THESIS_TABLES)
    table_rows = []
    for row_label, field_name in THESIS_ROWS.items():
        table_row = {"Hyperparameter": row_label}
        for table_name in names or THESIS_TABLES:
            table_row[table_name.replace("table-6-", "Table 6.")] = format_short(
                BASES[table_name][field_name]
            )
        table_rows.append(table_row)
    return rows_result("rows", table_rows)


# --- export ---------------------------------------------------------------------------------------


def export(
    name: opt.Study,
    selection: opt.RunFilter,
    table: Annotated[str, opt.choice(EXPORT_TABLES, "Table to export.")],
    out: Annotated[Path, opt.option("FILE", f"The file to write, ending in {_ENDINGS}; - prints CSV.")],
    band: Annotated[
        str | None, opt.choice(EDGED_BANDS, "With --table curves: what low and high are (default: sd).")
    ] = None,
    window: Annotated[
        str | None, opt.choice(WINDOWS, "With --table curves: episodes averaged at each point.")
    ] = None,
) -> Result:
    """Write a study's records as one tidy table."""
    if (band or window) and table != "curves":
        raise UserError("--band and --window require --table curves")
    is_printed = str(out) == "-"
    if not is_printed:
        check_file(out, EXPORT_SUFFIXES)
    study_data = selection.open(name)
    from pneuma.analysis.export import encode_frame, export_records

    answer = export_records(study_data, table, selection.store, window, band or EDGED_BANDS[0])
    if is_printed:
        return Result({}, file=encode_frame(answer.table, "csv"))
    write_file(out, encode_frame(answer.table, EXPORT_SUFFIXES[out.suffix.lower()]))
    wrote_line = f"wrote {out}: {counted(len(answer.table), 'row')}"
    return Result({"file": out, **answer.about}, [wrote_line])


# --- publish --------------------------------------------------------------------------------------


def _read_curves(curves_text: str) -> tuple[str, ...]:
    """Return the named quantities, with `actions` expanded."""
    if curves_text == "none":
        return ()
    allowed = (*TRAINING_QUANTITIES, ACTIONS)
    quantities: list[str] = []
    for quantity in map(str.strip, curves_text.split(",")):
        if quantity not in allowed:
            raise UserError(f"--curves {quantity}: {unknown_name('value', quantity, allowed)}")
        quantities += ACTION_QUANTITIES if quantity == ACTIONS else [quantity]
    return tuple(quantities)


def publish(
    name: opt.Study,
    selection: opt.RunFilter,
    curves: Annotated[
        Any, opt.option("NAME,…|none", "Quantities whose curves are kept.", _read_curves)
    ] = None,
) -> Result:
    """Publish a study's finished runs as one small table, which replaces runs that are not stored.

    Rows already in the table are kept. The same runs give the same bytes.
    """
    study_data = selection.open(name)
    from pneuma.analysis.export import publish_runs

    kept_curves = PUBLISHED_CURVES if curves is None else curves
    path, new, staying, size = publish_runs(selection.store, study_data, kept_curves)
    wrote_line = f"wrote {path}: {counted(new, 'run')} from here"
    if staying:
        wrote_line += f", {staying} as they were published before"
    document = {"study": study_data.study.name, "file": path, "bytes": size, "runs": new, "staying": staying}
    return Result(document, [f"{wrote_line}; {size / 1000:.0f} kB"])
