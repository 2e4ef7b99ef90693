"""`pneuma study plot`, `export` and `publish`: files made from a study."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.analysis import BAND_NAMES, EDGED_BANDS, EXPORT_SUFFIXES, EXPORT_TABLES
from pneuma.cli import complete
from pneuma.cli import options as opt
from pneuma.cli.output import (
    check_file,
    draw_files,
    print_json,
    read_formats,
    say,
    tell_written,
    write_file,
)
from pneuma.cli.study_records import each_study, nothing_yet, open_data
from pneuma.errors import UserError, counted, unknown_name
from pneuma.figures import FIGURE_KINDS
from pneuma.study.plan import Selection
from pneuma.study.quantities import (
    ACTION_QUANTITIES,
    CURVE_QUANTITIES,
    EPISODE_QUANTITIES,
    UPDATE_QUANTITIES,
    WINDOWS,
)

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData
    from pneuma.study.store import Store

EVERY_QUANTITY, ACTIONS = "all", "actions"
PUBLISHED_CURVES = (
    "return", "length", "hp", "entropy", "grad_norm", "approx_kl", "explained_variance", "dead_units",
    *ACTION_QUANTITIES,
)  # fmt: skip
"""The quantities whose curves a published table keeps by default."""


# --- plot -----------------------------------------------------------------------------------------


@opt.grouped
def plot(
    picked: opt.Chosen,
    names: Annotated[
        list[str] | None, opt.argument("NAME", "Studies; left out: all that were run.", complete.studies)
    ] = None,
    figure: Annotated[
        opt.Text,
        opt.choice(
            "--figure",
            FIGURE_KINDS,
            "Curves over steps (default for seven conditions or less), or a summary.",
        ),
    ] = None,
    quantity: Annotated[
        list[Any] | None,
        opt.choice(
            "--quantity",
            (*CURVE_QUANTITIES, ACTIONS, EVERY_QUANTITY),
            "A curve, such as entropy; actions, or all (may be repeated; default: share_killed and return).",
            "NAME",
        ),
    ] = None,
    band: Annotated[
        opt.Text,
        opt.choice(
            "--band", BAND_NAMES, "What the band shows (default: sd, with the mean's interval in it)."
        ),
    ] = None,
    window: Annotated[opt.Text, opt.choice("--window", WINDOWS, "Which episodes a point averages.")] = None,
    beside: Annotated[
        opt.Text, opt.option("--beside", "NAME", "Another study, or imported logs, whose runs are drawn too.")
    ] = None,
    format: opt.Formats = None,
    out: opt.PlotFolder = None,
    json: opt.Json = False,
) -> None:
    """Draw a study: curves over its steps, or a summary of its outcomes."""
    if figure == "summary" and (quantity or band or window or beside):
        raise UserError("--quantity, --band, --window and --beside: are of --figure curves")
    formats, store = read_formats(format, out), picked.store
    if not names and (lacking := nothing_yet(store)):
        raise UserError(lacking)
    from pneuma.figures.curves import draw_study
    from pneuma.figures.summary import draw_summary
    from pneuma.figures.words import fits_panel

    other = open_data(opt.Chosen(Selection(), None, store), beside) if beside else None

    def draw_one(folder: Path, asked: tuple[str, str | None]) -> list[Path]:
        name, world = asked
        data = open_data(replace(picked, world=world), name)
        words = ["plot", name, *(["--beside", beside] if beside else [])]
        of_curves = quantity or band or window or beside or fits_panel(data)
        kind = figure or FIGURE_KINDS[0 if of_curves else 1]
        look: dict[str, Iterable[str]] = {"figure": [kind], "format": formats}
        if kind == "summary":
            return draw_summary(data, folder, formats, command=opt.drawing_command(words, picked, look))
        quantities = _quantities(data, quantity or [])
        given = {"band": filter(None, [band]), "window": filter(None, [window])}
        again = opt.drawing_command(words, picked, {**look, "quantity": quantities, **given})
        return draw_study(data, folder, quantities, band, window, formats, beside=other, command=again)

    def draw(folder: Path) -> list[Path]:
        one = partial(draw_one, folder)
        asked = [(name, picked.world) for name in names or ()]
        drawn = [*map(one, asked)] if names else each_study(_run_here(picked), one)
        return [path for paths in drawn for path in paths]

    tell_written(draw_files(store, out, draw), json)


def _run_here(picked: opt.Chosen) -> list[tuple[str, str | None]]:
    """Return the studies, each with its world, all of whose conditions have runs in the results folder."""
    from pneuma.analysis.held import studies_here
    from pneuma.analysis.run_index import RunIndex

    held = studies_here(RunIndex(picked.store), picked.world)
    if not any(one.whole for one in held):
        names = ", ".join(dict.fromkeys(one.name for one in held)) or "one"
        raise UserError(f"no study has runs of all its conditions in {picked.store.root}: name {names}")
    return [(one.name, one.world or None) for one in held if one.whole]


def _quantities(data: StudyData, names: list[str]) -> list[str]:
    """Return the quantities to draw, with `all` and `actions` expanded."""
    from pneuma.analysis.curves import curve_names

    known = curve_names(data)
    stand_for = {EVERY_QUANTITY: known, ACTIONS: [name for name in ACTION_QUANTITIES if name in known]}
    quantities = [quantity for name in names for quantity in stand_for.get(name, [name])]
    if names and not quantities:
        raise UserError(f"study {data.study}: {data.what} has no {names[0]}")
    return quantities


# --- export ---------------------------------------------------------------------------------------


@opt.grouped
def export(
    name: opt.StudyName,
    table: Annotated[str, opt.choice("--table", EXPORT_TABLES, "What to export.")],
    out: Annotated[
        Path,
        opt.option("--out", "FILE", f"The file to write, in {', '.join(EXPORT_SUFFIXES)}; - prints CSV."),
    ],
    picked: opt.Chosen,
    band: Annotated[
        opt.Text,
        opt.choice("--band", EDGED_BANDS, "Of curves: what low and high are (default: sd)."),
    ] = None,
    window: Annotated[
        opt.Text, opt.choice("--window", WINDOWS, "Of curves: which episodes a point averages.")
    ] = None,
    json: opt.Json = False,
) -> None:
    """Write a study's records as one tidy table."""
    if (band or window) and table != "curves":
        raise UserError("--band and --window: go with --table curves alone")
    printed = str(out) == "-"
    if not printed:
        check_file(out, EXPORT_SUFFIXES)
    elif json:
        raise UserError("--json: standard output is for the table; name a file by --out")
    data = open_data(picked, name)
    from pneuma.analysis.export import encode_table

    form = "csv" if printed else EXPORT_SUFFIXES[out.suffix.lower()]
    encoded, rows = encode_table(data, table, form, picked.store, window, band or EDGED_BANDS[0])
    if printed:
        sys.stdout.buffer.write(encoded)
        return None
    write_file(out, encoded)
    if json:
        return print_json({"file": out, "rows": rows})
    return say(f"wrote {out}: {counted(rows, 'row')}")


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


@opt.grouped
def publish(
    name: opt.StudyName,
    picked: opt.Chosen,
    curves: Annotated[
        Any,
        opt.option(
            "--curves",
            "NAME,…|none",
            "Keep curves of these quantities, not of the usual.",
            _read_curves,
        ),
    ] = None,
    json: opt.Json = False,
) -> None:
    """Write a study's runs as rows of one small table, from which they are read where they are not stored.

    Rows that the table has already stay in it. The same runs give the same bytes.
    """
    store = picked.store
    data = open_data(picked, name)
    from pneuma.study.locks import run_lock

    with run_lock(store.root / ".publishing") as alone:  # of two that merge at once, one would lose rows
        if not alone:
            raise UserError(f"another command publishes from {store.root}: try again when it has ended")
        path, encoded, new, staying = _publish(store, data, curves or PUBLISHED_CURVES)
    if json:
        written = {"study": data.study, "file": path, "bytes": len(encoded)}
        return print_json({**written, "runs": new, "staying": staying})
    more = f", {staying} as they were published before" if staying else ""
    return say(f"wrote {path}: {counted(new, 'run')} from here{more}; {len(encoded) / 1000:.0f} kB")


def _publish(store: Store, data: StudyData, curves: Sequence[str]) -> tuple[Path, bytes, int, int]:
    """Write the table; return its path and content, and how many of its rows are new and how many stay."""
    from pneuma.analysis.frames import table_name
    from pneuma.analysis.run_index import RunIndex
    from pneuma.study.published import encode_published

    stem = table_name(data)
    new = {run.run_id: run.row for run in data.runs if not run.row.published}
    if not new:
        raise UserError(f"study {data.study}: its runs are not in {store.root}: nothing is new to publish")
    before = RunIndex(store, shipped=False).tables.get(stem)
    rows = {**(before.rows() if before else {}), **new}
    listing = store.listing(data.study)
    about = {"study": data.study, "world": data.world or None, "settings": dict(data.changed)}
    about |= {"listing": listing} if listing else {}
    order = sorted(rows.values(), key=lambda row: (row.config_id, row.budget, row.seed))
    path, encoded = store.published_path(stem), encode_published(order, about, curves)
    store.write(path, encoded)
    return path, encoded, len(new), len(rows) - len(new)
