"""`pneuma study export` and `publish`: what people take away from a study, beside figures."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pneuma.analysis import (
    ACTION_QUANTITIES,
    EDGED_BANDS,
    EPISODE_QUANTITIES,
    EXPORT_FORMATS,
    EXPORT_SUFFIXES,
    EXPORT_TABLES,
    EXPORTED_BAND,
    PUBLISHED_TABLES,
    UPDATE_QUANTITIES,
    WINDOWS,
)
from pneuma.cli.options import (
    Json,
    Results,
    Selected,
    StudyName,
    WorldName,
    print_json,
    read_path,
    say,
    selects,
)
from pneuma.cli.out_files import check_folder, write_file
from pneuma.cli.plain_text import plain
from pneuma.cli.study_records import study_record
from pneuma.errors import UserError, unknown_name
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.published import PublishedTable
    from pneuma.analysis.tables import StudyData

RESULTS = Path("results")


@selects
def export(
    name: StudyName,
    table: Annotated[str, typer.Option("--table", metavar="|".join(EXPORT_TABLES), help="What to export.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", parser=read_path, help="The file to write; - for standard output."
        ),
    ],
    format: Annotated[
        str | None,
        typer.Option(
            "--format", metavar="|".join(EXPORT_FORMATS), help="Its format (default: by the file's ending)."
        ),
    ] = None,
    band: Annotated[
        str | None,
        typer.Option(
            "--band",
            metavar="|".join(EDGED_BANDS),
            help=f"Of curves: what low and high are (default: {EXPORTED_BAND}).",
        ),
    ] = None,
    window: Annotated[
        str | None,
        typer.Option(
            "--window", metavar="|".join(WINDOWS), help="Of curves: which episodes a point averages."
        ),
    ] = None,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Write a study's records as one tidy table."""
    check_choice("--table", table, EXPORT_TABLES)
    for option, value, allowed in (("--band", band, EDGED_BANDS), ("--window", window, WINDOWS)):
        if value is not None:
            check_choice(option, value, allowed)
            if table != "curves":
                raise UserError(f"{option} {value}: goes with --table curves alone")
    form = format or EXPORT_SUFFIXES.get(out.suffix, "csv" if str(out) == "-" else "")
    if not form:
        endings = ", ".join(EXPORT_SUFFIXES)
        raise UserError(f"--out {out}: its ending tells no format; end it in {endings}, or give --format")
    check_choice("--format", form, EXPORT_FORMATS)
    if json and str(out) == "-":
        raise UserError("--json: standard output is for the table; name a file by --out")
    data = open_data(Store(results), name, selection, world, mixed=table in PUBLISHED_TABLES)
    from pneuma.analysis.export import encode_table, lacks_window

    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if str(out) != "-":
        check_folder("--out", out.parent)
    if window and (lacking := lacks_window(data, window)):
        say(f"Note: {', '.join(lacking)}: not held with the window {window}, and left out.", aside=True)
    encoded, rows = encode_table(data, table, form, window, band or EXPORTED_BAND)
    if str(out) == "-":
        sys.stdout.buffer.write(encoded)
        return None
    write_file(out, encoded)
    if json:
        return print_json({"schema": 1, "file": str(out), "rows": rows})
    print(f"wrote {plain(str(out))}: {rows:,} rows")
    return None


@selects
def publish(
    name: StudyName,
    selection: Selected = None,
    world: WorldName = None,
    curves: Annotated[
        str | None,
        typer.Option(metavar="NAME,…|none", help="Keep curves of these quantities alone; left out: of all."),
    ] = None,
    rounding: Annotated[
        bool, typer.Option("--round", help="Keep curves to a thousandth of their range: a third of the size.")
    ] = False,
    replace: Annotated[
        bool,
        typer.Option(
            "--replace",
            help="Let published runs leave the table that are not selected, and curves that are not named.",
        ),
    ] = False,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Write a study's runs as one small table, from which it is drawn and judged without them.

    Runs of the selection that were published before and are not here stay in it as they are: a study
    may thus be trained on several machines, or part by part. Runs that other studies have published are found
    in their tables.
    """
    kept = _read_curves(curves)
    store = Store(results)
    record = study_record(store, name, selection, world)
    from pneuma.analysis.published import published_path, times_path
    from pneuma.analysis.publishing import encode_study, encode_times
    from pneuma.analysis.run_index import open_study

    path = published_path(store, record["study"])
    own = _published_before(store, record["study"], replace)
    data = open_study(store, record, mixed=own is not None, others=False)
    new = len(data.runs) - len(data.published)
    if not new:
        raise UserError(f"study {data.study}: its runs are not in {results}; there is nothing new to publish")
    leaving = own.finished - {run.run_id for run in data.runs} if own else frozenset()
    if own and not replace:
        _refuse_losses(data, own, leaving, kept)
    tell_left_out(data)
    encoded = encode_study(data, kept, rounding, own)
    store.write(path, encoded)
    store.write(times_path(store, data.study), encode_times(data))
    staying = len(data.published)
    if json:
        counts = {"runs": new, "staying": staying, "leaving": len(leaving)}
        document = {"schema": 1, "study": data.study, "file": str(path), "bytes": len(encoded)}
        return print_json({**document, **counts})
    more = f", {staying} as they were published before" if staying else ""
    print(f"wrote {plain(str(path))}: {new} runs from here{more}; {len(encoded) / 1000:.0f} kB")
    return None


def _published_before(store: Store, study: str, replace: bool) -> PublishedTable | None:
    """Return what was published of a study before; None where that cannot be read and is to be replaced.

    Raises:
        UserError: for such a table otherwise: what runs it holds, and would lose, nobody can tell.
    """
    from pneuma.analysis.published import published_path, read_published

    path = published_path(store, study)
    try:
        return read_published(store, study) if path.exists() else None
    except UserError:
        if replace:
            return None
        raise UserError(
            f"{path}: damaged, or of another version; take it from version control again, or publish the "
            "runs that are here alone in its place by --replace"
        ) from None


def _refuse_losses(
    data: StudyData, own: PublishedTable, leaving: frozenset[str], kept: Collection[str] | None
) -> None:
    """Refuse to let published runs, or curves that are not named, leave the table.

    Raises:
        UserError: naming what would be lost.
    """
    selected = leaving & {run["run_id"] for run in data.record["runs"]}
    if selected:
        raise UserError(
            f"study {data.study}: the curves of its table have points up to step {own.budget:,}, these need "
            f"{data.budget:,}, and not all runs of the table are here: publish those of most steps first"
        )
    if leaving:
        raise UserError(
            f"study {data.study}: {len(leaving)} published runs are not in this selection; select them too "
            "(--preset, --condition, --seeds), or let them leave the table by --replace"
        )
    dropped = [name for name in own.quantities if kept is not None and name not in kept]
    if dropped:
        raise UserError(
            f"study {data.study}: curves of {', '.join(dropped)} are published, and --curves leaves them "
            "out; name them too, or let them leave the table by --replace"
        )


def _read_curves(told: str | None) -> tuple[str, ...] | None:
    """Return the quantities named, of which `actions` is all actions' shares; None for all."""
    if told is None:
        return None
    names = [] if told == "none" else [name.strip() for name in told.split(",")]
    for name in names:
        check_choice("--curves", name, (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES, "actions"))
    return tuple(own for name in names for own in (ACTION_QUANTITIES if name == "actions" else (name,)))


def open_data(
    store: Store, name: str, selection: Selected, world: str | None, *, mixed: bool = True
) -> StudyData:
    """Open a study's data, as `open_study` does, and say how many runs of the selection are left out."""
    record = study_record(store, name, selection, world)
    from pneuma.analysis.run_index import open_study

    data = open_study(store, record, mixed=mixed)
    tell_left_out(data)
    return data


def tell_left_out(data: StudyData) -> None:
    """Say how many runs of a selection are not shown, or not here, if any."""
    of = f"of {data.left_out + len(data.runs)} runs of {plain(data.study)}"
    if 0 < len(data.published) < len(data.runs):
        say(f"Note: {len(data.published)} {of} are not here, but published.", aside=True)
    if data.left_out:
        say(f"Note: {data.left_out} {of} are not here, not finished or damaged, and left out.", aside=True)


def check_choice(option: str, value: str, allowed: Iterable[str]) -> None:
    """Refuse a value of an option that is none of those allowed."""
    if value not in allowed:
        raise UserError(f"{option} {value}: " + str(unknown_name("value", value, allowed)))


def tell_written(files: Iterable[Path]) -> None:
    """Say which files were written."""
    for path in files:
        print(f"wrote {plain(str(path))}")
