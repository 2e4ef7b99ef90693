"""`pneuma study plot`, `export` and `publish`: files made from a study."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.analysis import BAND_NAMES, CENTER_NAMES, EDGED_BANDS, EXPORT_SUFFIXES, EXPORT_TABLES, X_AXES
from pneuma.cli import options as opt
from pneuma.cli.output import (
    Result,
    check_file,
    draw_files,
    nothing_yet,
    read_formats,
    rows_result,
    say,
    write_file,
    wrote,
)
from pneuma.errors import UserError, counted, unknown_name
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

FIGURE_KINDS = ("curves", "summary", "profile", "one-action")
EVERY_QUANTITY, ACTIONS = "all", "actions"
_ENDINGS = ", ".join(EXPORT_SUFFIXES)
PUBLISHED_CURVES = (
    "return", "length", "hp", "entropy", "grad_norm", "approx_kl", "explained_variance", "dead_units",
    *ACTION_QUANTITIES,
)  # fmt: skip
"""The quantities whose curves a published table keeps by default."""


# --- plot -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drawing:
    """What a figure shows, and how."""

    figure: Annotated[
        str | None,
        opt.choice(
            FIGURE_KINDS,
            "Curves (default for up to 7 conditions), a summary, profiles, or runs in one action.",
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
        str | None, opt.choice(BAND_NAMES, "What the band shows (default: sd, the mean's interval in it).")
    ] = None
    window: Annotated[str | None, opt.choice(WINDOWS, "Which episodes a point averages.")] = None
    x: Annotated[str | None, opt.choice(X_AXES, "What curves lie over (default: steps).")] = None
    center: Annotated[str | None, opt.choice(CENTER_NAMES, "The line in a band (default: mean).")] = None
    beside: Annotated[str | None, opt.option("NAME", "Another study, or logs, to be drawn too.")] = None
    log: Annotated[bool, opt.flag("--log", "Logarithmic axes of values.")] = False
    formats: opt.Formats = None
    width: Annotated[float, opt.option("INCHES", "In inches.", min=1.5, max=30)] = 7.0
    height: Annotated[float | None, opt.option("INCHES", "In inches, with all words.", min=1, max=30)] = None
    title: Annotated[str | None, opt.option("TEXT", "In place of the study's.")] = None
    style: Annotated[str, opt.option("NAME|FILE", "A style sheet of matplotlib, over Pneuma's.")] = ""
    plain: Annotated[bool, opt.flag("--plain", "Without headline and caption, for papers.")] = False

    @property
    def of_curves(self) -> dict[str, Any]:
        """Those of the options that are of curves alone, but for quantities."""
        names = ("band", "window", "x", "center", "beside", "log")
        return {name: value for name in names if (value := getattr(self, name))}


def plot(
    picked: opt.RunFilter,
    asked: Drawing,
    names: Annotated[opt.Several, opt.argument("NAME", "Studies; left out: all that were run.")] = None,
    out: opt.PlotFolder = None,
) -> Result:
    """Draw a study: curves over its steps, or a summary of its outcomes.

    A study of several environments has a panel for each.
    """
    if asked.figure in FIGURE_KINDS[1:] and (asked.quantity or asked.of_curves):
        options = "--quantity, --band, --window, --x, --center, --beside and --log"
        raise UserError(f"{options}: are of --figure curves")
    formats, store = read_formats(asked.formats, out), picked.store
    if not names and (lacking := nothing_yet(store)):
        raise UserError(lacking)
    from pneuma.analysis.environments import by_environment
    from pneuma.figures.curves import curves_page, profile_page
    from pneuma.figures.origin import lines_of_runs
    from pneuma.figures.style import Look
    from pneuma.figures.summary import summary_page
    from pneuma.figures.words import fits_panel

    how = dict(asked.of_curves)
    of_beside = opt.RunFilter(results=picked.results, world=picked.world)
    beside = of_beside.open(asked.beside) if asked.beside else None

    def draw(name: str, world: str | None) -> Page:
        data = picked.open(name, world)
        parts = {env: part for env, part in by_environment(data).items() if part.rows}
        shown = parts if len(parts) > 1 else data
        if beside:
            known = {*data.conditions, *(name for part in parts.values() for name in part.conditions)}
            alike = [name for name in beside.conditions if name in known and beside.of_condition(name)]
            how["beside"] = beside.of_conditions(alike) if picked.condition and alike else beside
        fits = all(map(fits_panel, parts.values())) and not data.study.outcomes
        kind = asked.figure or FIGURE_KINDS[0 if asked.quantity or how or fits else 1]
        quantities = _quantities(data, asked.quantity or [])
        if kind == "summary":
            page = summary_page(shown)
        elif kind == "curves":
            page = curves_page(shown, quantities, **how)
        elif kind == "one-action":
            from pneuma.figures.one_action import one_action_page  # SciPy's statistics take half a second

            page = one_action_page(data)
        elif len(parts) == 1:
            raise UserError(f"--figure {kind}: is over several environments; {name} has one")
        else:
            page = profile_page(data, parts)
        if len(parts) > 1:  # under the names that tell the environment
            page = replace(page, runs=lines_of_runs(data, *filter(None, [how.get("beside")])))
        return page

    def pages() -> Iterator[Page]:
        every = [(name, picked.world) for name in names] if names else _run_here(picked)
        problems = []
        for name, world in every:
            try:
                yield draw(name, world)
            except UserError as error:
                problems.append(error)
                if names or len(problems) == len(every):
                    raise problems[0] from None
        for problem in problems:
            say(f"Note: {problem}.")

    look = Look(asked.width, asked.height, asked.title, asked.style, asked.plain)
    files = draw_files(store, out, formats, pages(), look)
    return Result({"figures": files}, wrote(files))


def _run_here(picked: opt.RunFilter) -> list[tuple[str, str | None]]:
    """Return the studies that were run in the results folder, each in its world."""
    from pneuma.analysis.runs import studies_here

    here = [data for data in studies_here(picked.index, picked.world) if len(data.finished)]
    if not here:
        raise UserError(f"no run of a study has finished in {picked.store.root}")
    return [(data.study.file, data.world or None) for data in here]


def _quantities(data: StudyData, names: list[str]) -> list[str]:
    """Return the quantities to draw, with `all` and `actions` expanded."""
    from pneuma.analysis.curves import curve_names

    known = curve_names(data)
    stand_for = {EVERY_QUANTITY: known, ACTIONS: [name for name in ACTION_QUANTITIES if name in known]}
    quantities = [quantity for name in names for quantity in stand_for.get(name, [name])]
    if names and not quantities:
        raise UserError(f"study {data.study.name}: {data.what} has no {names[0]}")
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
    """Print the thesis's Tables 6.1 and 6.2: default and final hyperparameters, as printed there."""
    for name in names or ():
        if name not in THESIS_TABLES:
            raise unknown_name("table", name, THESIS_TABLES)
    from pneuma.presets import BASES
    from pneuma.values import short

    heads = ["Hyperparameter", *(name.replace("table-6-", "Table 6.") for name in names or THESIS_TABLES)]
    rows = [
        dict(zip(heads, [said, *(short(BASES[name][field]) for name in names or THESIS_TABLES)], strict=True))
        for said, field in THESIS_ROWS.items()
    ]
    return rows_result("rows", rows)


# --- export ---------------------------------------------------------------------------------------


def export(
    name: opt.Study,
    picked: opt.RunFilter,
    table: Annotated[str, opt.choice(EXPORT_TABLES, "What to export.")],
    out: Annotated[Path, opt.option("FILE", f"The file to write, in {_ENDINGS}; - prints CSV.")],
    band: Annotated[str | None, opt.choice(EDGED_BANDS, "Of curves: low and high (default: sd).")] = None,
    window: Annotated[str | None, opt.choice(WINDOWS, "Of curves: which episodes a point averages.")] = None,
) -> Result:
    """Write a study's records as one tidy table."""
    if (band or window) and table != "curves":
        raise UserError("--band and --window: go with --table curves alone")
    printed = str(out) == "-"
    if not printed:
        check_file(out, EXPORT_SUFFIXES)
    data = picked.open(name)
    from pneuma.analysis.export import encode_table

    form = "csv" if printed else EXPORT_SUFFIXES[out.suffix.lower()]
    encoded, rows = encode_table(data, table, form, picked.store, window, band or EDGED_BANDS[0])
    if printed:
        return Result({}, file=encoded)
    write_file(out, encoded)
    return Result({"file": out, "rows": rows}, [f"wrote {out}: {counted(rows, 'row')}"])


# --- publish --------------------------------------------------------------------------------------


def _read_curves(text: str) -> tuple[str, ...]:
    """Return the named quantities, with `actions` expanded."""
    names = [] if text == "none" else [name.strip() for name in text.split(",")]
    allowed = (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES, ACTIONS)
    for name in names:
        if name not in allowed:
            raise UserError(f"--curves {name}: {unknown_name('value', name, allowed)}")
    return tuple(
        quantity for name in names for quantity in (ACTION_QUANTITIES if name == ACTIONS else (name,))
    )


def publish(
    name: opt.Study,
    picked: opt.RunFilter,
    curves: Annotated[Any, opt.option("NAME,…|none", "Of which to keep curves.", _read_curves)] = None,
) -> Result:
    """Write a study's runs as rows of one small table, from which they are read where they are not stored.

    Rows that the table has already stay in it. The same runs give the same bytes.
    """
    data = picked.open(name)
    from pneuma.analysis.export import publish_runs

    path, new, staying, size = publish_runs(
        picked.store, data, PUBLISHED_CURVES if curves is None else curves
    )
    more = f", {staying} as they were published before" if staying else ""
    text = f"wrote {path}: {counted(new, 'run')} from here{more}; {size / 1000:.0f} kB"
    written = {"study": data.study.name, "file": path, "bytes": size}
    return Result({**written, "runs": new, "staying": staying}, [text])
