"""`pneuma study export` and `publish`: what people take away from a study, beside figures."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Sequence
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
    from pneuma.analysis.published import PublishedRuns
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
    may thus be trained on several machines, or part by part. The same runs of other studies' tables
    count, where they hold as much.
    """
    kept = _read_curves(curves)
    store = Store(results)
    data = open_data(store, name, selection, world, mixed=False, tell=False)
    from pneuma.analysis.published import PublishedRuns, published_path
    from pneuma.analysis.published_times import encode_times, times_path
    from pneuma.analysis.publishing import encode_study, runs_leaving, runs_staying

    if isinstance(data.source, PublishedRuns):
        raise UserError(f"study {data.study}: its runs are not in {results}; there is nothing new to publish")
    path = published_path(store, data.study)
    own = _published_before(store, data, replace)
    leaving = runs_leaving(data, own) if own else []
    before = _with_other_studies(store, data, own, kept, rounding)
    staying = runs_staying(data, before)
    elsewhere = len(staying) - len(runs_staying(data, own))
    tell_left_out(data, len(staying))
    if not replace:
        _refuse_losses(data.study, own, leaving, kept)
    encoded = encode_study(data, kept, rounding, before)
    store.write(path, encoded)
    times = {run_id: before.times[run_id] for run_id in staying if run_id in before.times} if before else {}
    store.write(times_path(store, data.study), encode_times(data, times))
    if json:
        counts = {"runs": len(data.runs), "staying": len(staying), "of_other_studies": elsewhere}
        document = {"schema": 1, "study": data.study, "file": str(path), "bytes": len(encoded)}
        return print_json({**document, **counts, "leaving": len(leaving)})
    sources = {"as they were published before": len(staying) - elsewhere, "of other studies": elsewhere}
    more = "".join(f", {count} {source}" for source, count in sources.items() if count)
    print(f"wrote {plain(str(path))}: {len(data.runs)} runs from here{more}; {len(encoded) / 1000:.0f} kB")
    return None


def _published_before(store: Store, data: StudyData, replace: bool) -> PublishedRuns | None:
    """Return what was published of a study before; None where that cannot be read and is to be replaced.

    Raises:
        UserError: for such a table otherwise: what runs it holds, and would lose, nobody can tell.
    """
    from pneuma.analysis.published import published_path, read_published

    path = published_path(store, data.study)
    try:
        return read_published(store, data.study) if path.exists() else None
    except UserError:
        if replace:
            return None
        raise UserError(
            f"{path}: damaged, or of another version; take it from version control again, or publish the "
            "runs that are here alone in its place by --replace"
        ) from None


def _refuse_losses(
    study: str, own: PublishedRuns | None, leaving: Sequence[str], kept: Collection[str] | None
) -> None:
    """Refuse to let published runs that are not selected, or curves that are not named, leave the table.

    Raises:
        UserError: naming what would be lost.
    """
    if leaving:
        raise UserError(
            f"study {study}: {len(leaving)} published runs are not in this selection; select them too "
            "(--preset, --condition, --seeds), or let them leave the table by --replace"
        )
    dropped = [name for name in own.curve_names if name not in kept] if own and kept is not None else []
    if dropped:
        raise UserError(
            f"study {study}: curves of {', '.join(dropped)} are published, and --curves leaves them "
            "out; name them too, or let them leave the table by --replace"
        )


def _with_other_studies(
    store: Store, data: StudyData, own: PublishedRuns | None, curves: tuple[str, ...] | None, rounding: bool
) -> PublishedRuns | None:
    """Return what was published of a study's runs before, also by other studies; see `with_other_studies`."""
    from pneuma.analysis.published import published_studies, read_published
    from pneuma.analysis.publishing import runs_staying, with_other_studies

    if data.left_out == len(runs_staying(data, own)):
        return own
    others = []
    for study in published_studies(store):
        try:
            others += [read_published(store, study)] if study != data.study else []
        except UserError as error:
            say(f"Note: {error}; its runs are not taken from it.", aside=True)
    return with_other_studies(data, own, others, curves, rounding)


def _read_curves(told: str | None) -> tuple[str, ...] | None:
    """Return the quantities named, of which `actions` is all actions' shares; None for all."""
    if told is None:
        return None
    names = [] if told == "none" else [name.strip() for name in told.split(",")]
    for name in names:
        check_choice("--curves", name, (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES, "actions"))
    return tuple(own for name in names for own in (ACTION_QUANTITIES if name == "actions" else (name,)))


def open_data(
    store: Store, name: str, selection: Selected, world: str | None, *, mixed: bool = True, tell: bool = True
) -> StudyData:
    """Open a study's data, as `open_study` does, and say how many runs of the selection are left out."""
    record = study_record(store, name, selection, world)
    from pneuma.analysis.sources import open_study

    data = open_study(store, record, mixed=mixed)
    if tell:
        tell_left_out(data)
    return data


def tell_left_out(data: StudyData, found_elsewhere: int = 0) -> None:
    """Say how many runs of a selection are not shown, or not here, if any."""
    from pneuma.analysis.partly_published import PartlyPublished

    if isinstance(data.source, PartlyPublished):
        published = sum(run.run_id in data.source.published_ids for run in data.runs)
        of = f"{published} of {data.left_out + len(data.runs)} runs"
        say(f"Note: {of} of {plain(data.study)} are not here, but taken from its table.", aside=True)
    missing = data.left_out - found_elsewhere
    if missing:
        of = f"{missing} of {data.left_out + len(data.runs)} runs of {plain(data.study)}"
        say(f"Note: {of} are not here, not finished or damaged, and left out.", aside=True)


def check_choice(option: str, value: str, allowed: Iterable[str]) -> None:
    """Refuse a value of an option that is none of those allowed."""
    if value not in allowed:
        raise UserError(f"{option} {value}: " + str(unknown_name("value", value, allowed)))


def tell_written(files: Iterable[Path]) -> None:
    """Say which files were written."""
    for path in files:
        print(f"wrote {plain(str(path))}")
