"""`pneuma study plot`, `export` and `publish`: files made from a study."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.analysis import (
    ACTION_QUANTITIES,
    BAND_NAMES,
    CURVE_QUANTITIES,
    EDGED_BANDS,
    EPISODE_QUANTITIES,
    EXPORT_SUFFIXES,
    EXPORT_TABLES,
    EXPORTED_BAND,
    UPDATE_QUANTITIES,
    WINDOWS,
)
from pneuma.analysis.stored_studies import is_shipped, studies_run_here, study_record
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
from pneuma.cli.study_records import each_study, nothing_yet, open_data, tell_left_out
from pneuma.errors import UserError, unknown_name
from pneuma.figures import FIGURE_KINDS
from pneuma.worlds import in_world, split_world

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

EVERY_QUANTITY, ACTIONS = "all", "actions"


# --- plot -----------------------------------------------------------------------------------------


@opt.grouped
def plot(
    picked: opt.Chosen,
    names: Annotated[
        list[str] | None, opt.argument("NAME", "Studies; left out: all that were run.", complete.studies)
    ] = None,
    figure: Annotated[
        str, opt.choice("--figure", FIGURE_KINDS, "Curves over steps, or what the runs came to.")
    ] = FIGURE_KINDS[0],
    quantity: Annotated[
        list[Any] | None,
        opt.choice(
            "--quantity",
            (*CURVE_QUANTITIES, ACTIONS, EVERY_QUANTITY),
            "A curve, such as entropy; actions, or all (may be repeated; default: share_killed and return).",
            "NAME",
        ),
    ] = None,
    band: Annotated[opt.Text, opt.choice("--band", BAND_NAMES, "What the band shows (default: ci).")] = None,
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
    if not names and (lacking := nothing_yet(store, picked.world)):
        raise UserError(lacking)
    from pneuma.analysis.run_index import open_study
    from pneuma.figures.curves import draw_study, settle
    from pneuma.figures.summary import draw_summary

    other = open_study(store, study_record(store, beside)) if beside else None

    def draw_one(folder: Path, name: str) -> list[Path]:
        data = open_data(picked, name)
        words = ["plot", name, *(["--beside", beside] if beside else [])]
        look: dict[str, Iterable[str]] = {"figure": [figure], "format": formats}
        if figure == "summary":
            return draw_summary(data, folder, formats, command=opt.drawing_command(words, picked, look))
        settled = settle(data, band, window, quantities=_quantities(data, quantity or []))
        look |= {"quantity": settled.quantities, "band": [settled.band], "window": [settled.window]}
        again = opt.drawing_command(words, picked, look)
        return draw_study(data, folder, settled, formats, beside=other, command=again)

    def draw(folder: Path) -> list[Path]:
        one = partial(draw_one, folder)
        drawn = map(one, names) if names else each_study(studies_run_here(store, picked.world), one)
        return [path for paths in drawn for path in paths]

    tell_written(draw_files(store, out, draw), json)


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
        opt.choice("--band", EDGED_BANDS, f"Of curves: what low and high are (else {EXPORTED_BAND})."),
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
    data = open_data(picked, name, published=table not in ("episodes", "metrics"))
    from pneuma.analysis.export import encode_table

    form = "csv" if printed else EXPORT_SUFFIXES[out.suffix.lower()]
    encoded, rows = encode_table(data, table, form, window, band or EXPORTED_BAND)
    if printed:
        sys.stdout.buffer.write(encoded)
        return None
    write_file(out, encoded)
    if json:
        return print_json({"file": out, "rows": rows})
    return say(f"wrote {out}: {rows:,} rows")


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
    as_: Annotated[
        opt.Text, opt.option("--as", "NAME", "Name the table: a second budget has one of its own.")
    ] = None,
    json: opt.Json = False,
) -> None:
    """Write a study's runs as one small table, from which it is drawn and judged without them.

    Runs of the selection that were published before and are not here stay in it as they are: a study
    may thus be trained on several machines, or part by part. Runs that other studies have published are found
    in their tables.
    """
    store = picked.store
    record = study_record(store, name, picked.selection, picked.world)
    if as_ is not None:
        if is_shipped(as_) or not re.fullmatch(r"[\w-]+", as_):
            raise UserError(f"--as {as_}: must be letters, digits and hyphens, and no shipped study's name")
        world = split_world(record["study"])[1]
        table, (title, place, _) = in_world(as_, world), record["title"].partition(f" ({world})")
        record = {**record, "study": table, "figure": table, "title": f"{title}: {as_}{place}"}
    from pneuma.analysis.published import TIMES_SUFFIX
    from pneuma.analysis.publishing import encode_study, encode_times
    from pneuma.analysis.run_index import RunIndex, open_study

    index, path = RunIndex(store, shipped=False), store.published_path(record["study"], shipped=False)
    data = open_study(index, record, "own")
    new, staying = len(data.runs) - len(data.published), len(data.published)
    if not new:
        raise UserError(f"study {data.study}: its runs are not in {store.root}: nothing is new to publish")
    tell_left_out(data)
    encoded = encode_study(data, curves, index.table(data.study))
    store.write(path, encoded)
    store.write(path.with_suffix(TIMES_SUFFIX), encode_times(data))
    if json:
        about = {"study": data.study, "file": path, "bytes": len(encoded)}
        return print_json({**about, "runs": new, "staying": staying})
    more = f", {staying} as they were published before" if staying else ""
    return say(f"wrote {path}: {new} runs from here{more}; {len(encoded) / 1000:.0f} kB")
