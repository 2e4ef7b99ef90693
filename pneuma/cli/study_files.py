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
    EPISODE_QUANTITIES,
    UPDATE_QUANTITIES,
    WINDOWS,
)

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData
    from pneuma.figures.grid import Page

CURVES, SUMMARY, PROFILE, ONE_ACTION = FIGURE_KINDS = ("curves", "summary", "profile", "one-action")
EVERY_QUANTITY, ACTIONS = "all", "actions"
_ENDINGS = ", ".join(EXPORT_SUFFIXES)
PUBLISHED_CURVES = (
    "return", "length", "hp", "entropy", "grad_norm", "approx_kl", "explained_variance", "dead_units",
    *ACTION_QUANTITIES,
)  # fmt: skip
"""The quantities whose curves a published table keeps by default."""
OF_CURVES = ("band", "window", "x", "log")
"""Options that only figures of curves have, beside --quantity and --beside."""


# --- plot -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawing:
    """What a figure shows, and how."""

    figure: Annotated[
        str | None,
        opt.choice(
            FIGURE_KINDS,
            "Curves (default for up to 7 conditions), a summary, profiles, or one-action runs.",
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
        opt.choice(BAND_NAMES, "What the band shows (default: sd, with the mean's interval inside)."),
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
        """Those of `OF_CURVES` that are given."""
        return {name: getattr(self, name) for name in OF_CURVES if getattr(self, name)}

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
    formats, store = read_formats(drawing.formats, out), selection.store
    nothing = nothing_yet(store)
    if not names and nothing:
        raise UserError(nothing)
    from pneuma.figures.grid import save_page
    from pneuma.figures.style import Look

    look = Look(drawing.width, drawing.height, drawing.title, drawing.style, drawing.plain)
    beside = None
    if drawing.beside:
        if len(drawing.beside) > 1:
            raise UserError("--beside takes one study: import the logs of several under one --name")
        beside = opt.RunFilter(results=selection.results, world=selection.world).open(drawing.beside[0])
    if names:
        pages = [_draw(selection.open(name), drawing, beside) for name in names]
    else:
        pages = _draw_all(selection, drawing, beside)

    def save(folder: Path) -> Iterator[Path]:
        for page in pages:
            yield from save_page(page, folder, formats, look)

    files = keep_files(store, out, save)
    answers = [page.answer.document for page in pages if page.answer]
    return Result({"figures": files, "answers": answers}, wrote(files))


def _draw_all(selection: opt.RunFilter, drawing: Drawing, beside: StudyData | None) -> list[Page]:
    """Return the figures of the studies that were run here and can be drawn."""
    from pneuma.analysis.runs import studies_here

    pages: list[Page] = []
    problems: list[UserError] = []
    for data in studies_here(selection.index, selection.world):
        if len(data.finished):
            try:
                opened = replace(selection, world=data.world or None).open(data.study.file)
                pages.append(_draw(opened, drawing, beside))
            except UserError as error:
                problems.append(error)
    if not pages:
        raise next(iter(problems), UserError(f"no run of a study has finished in {selection.store.root}"))
    for problem in problems:
        say(Message("Note: ", *problem.args, "."))
    return pages


def _draw(data: StudyData, drawing: Drawing, beside: StudyData | None) -> Page:
    """Return the figure of a study."""
    from pneuma.analysis.environments import columns_of
    from pneuma.answers.curves import find_curves
    from pneuma.answers.outcomes import show_outcomes
    from pneuma.answers.profiles import profile_scores
    from pneuma.figures import shares
    from pneuma.figures.curves import curves_page
    from pneuma.figures.origin import lines_of_runs
    from pneuma.figures.summary import summary_page
    from pneuma.figures.words import fits_panel

    columns, figure = columns_of(data), drawing.figure
    if figure is None:
        fits = all(map(fits_panel, columns.values())) and not data.study.outcomes
        figure = CURVES if drawing.is_of_curves or fits else SUMMARY
    if figure == PROFILE:
        return shares.profile_page(profile_scores(data))
    if figure == ONE_ACTION:
        from pneuma.answers.one_action import find_one_action  # SciPy's statistics take half a second

        return shares.one_action_page(find_one_action(data))
    if figure == SUMMARY:
        page = summary_page(show_outcomes(columns))
    else:
        quantities = _quantities(data, drawing)
        page = curves_page(find_curves(columns, quantities, beside, **drawing.curve_options))
    if len(columns) > 1:  # under the names that contain the environment
        page = replace(page, runs=lines_of_runs(*filter(None, [data, beside])))
    return page


def _quantities(data: StudyData, drawing: Drawing) -> list[str]:
    """Return the quantities to draw, with `all` and `actions` expanded."""
    from pneuma.analysis.curves import curve_names

    recorded = curve_names(data)
    actions = [name for name in ACTION_QUANTITIES if name in recorded]
    groups = {EVERY_QUANTITY: recorded, ACTIONS: actions or [ACTIONS]}
    quantities: list[str] = []
    for name in drawing.quantity or ():
        quantities += groups.get(name, [name])
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
    from pneuma.values import short

    for name in names or ():
        if name not in THESIS_TABLES:
            raise unknown_name("table", name, THESIS_TABLES)
    rows = []
    for words, field in THESIS_ROWS.items():
        row = {"Hyperparameter": words}
        for name in names or THESIS_TABLES:
            row[name.replace("table-6-", "Table 6.")] = short(BASES[name][field])
        rows.append(row)
    return rows_result("rows", rows)


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
    data = selection.open(name)
    from pneuma.analysis.export import encode_frame
    from pneuma.answers.export import export_records

    answer = export_records(data, table, selection.store, window, band or EDGED_BANDS[0])
    if is_printed:
        return Result({}, file=encode_frame(answer.table, "csv"))
    write_file(out, encode_frame(answer.table, EXPORT_SUFFIXES[out.suffix.lower()]))
    text = f"wrote {out}: {counted(len(answer.table), 'row')}"
    return Result({"file": out, **answer.about}, [text])


# --- publish --------------------------------------------------------------------------------------


def _read_curves(text: str) -> tuple[str, ...]:
    """Return the named quantities, with `actions` expanded."""
    if text == "none":
        return ()
    allowed = (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES, ACTIONS)
    quantities: list[str] = []
    for env_data in text.split(","):
        name = env_data.strip()
        if name not in allowed:
            raise UserError(f"--curves {name}: {unknown_name('value', name, allowed)}")
        quantities += ACTION_QUANTITIES if name == ACTIONS else [name]
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
    data = selection.open(name)
    from pneuma.analysis.export import publish_runs

    kept_curves = PUBLISHED_CURVES if curves is None else curves
    path, new, staying, size = publish_runs(selection.store, data, kept_curves)
    text = f"wrote {path}: {counted(new, 'run')} from here"
    if staying:
        text += f", {staying} as they were published before"
    document = {"study": data.study.name, "file": path, "bytes": size, "runs": new, "staying": staying}
    return Result(document, [f"{text}; {size / 1000:.0f} kB"])
