"""`pneuma study plot`, `export` and `publish`: what people take away from a study."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from pneuma.analysis import BAND_NAMES, EXPORT_FORMATS, EXPORT_SUFFIXES, EXPORT_TABLES, WINDOWS
from pneuma.cli.options import (
    Conditions,
    EngineName,
    Json,
    Preset,
    Results,
    Seeds,
    SettingName,
    Settings,
    Steps,
    StudyName,
    print_json,
    read_selection,
    say,
)
from pneuma.cli.plain_text import plain
from pneuma.cli.study_records import known_studies, study_record
from pneuma.errors import UserError, unknown_name
from pneuma.figures import FIGURE_FORMATS
from pneuma.study.plan import Selection
from pneuma.study.store import Store, write_whole

if TYPE_CHECKING:
    from pneuma.analysis.tables import StudyData

RESULTS = Path("results")
MOST_PUBLISHED_BYTES = 20_000_000
"""Over all studies (design section 4)."""


def plot(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]…", help="Studies; left out: all that were run.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Where to write (default: RESULTS/figures).")
    ] = None,
    band: Annotated[
        str, typer.Option("--band", metavar="|".join(BAND_NAMES), help="What the band shows.")
    ] = "std",
    window: Annotated[
        str | None,
        typer.Option("--window", metavar="|".join(WINDOWS), help="Which episodes a point averages."),
    ] = None,
    format: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            metavar="|".join(FIGURE_FORMATS),
            help="File formats (may be repeated; default: png and svg).",
        ),
    ] = None,
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    setting: SettingName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Draw a study's figure: mean over seeds with a band, return and monsters killed."""
    formats = tuple(format or ("png", "svg"))
    _check_looks(band, window, formats)
    selection = read_selection(preset, seeds, steps, engine, condition, set_)
    store = Store(results)
    studies = _studies_to_draw(store, names or known_studies(store, setting), selection, window, setting)
    paths = _draw(store, studies, out, lambda data, folder: _figure(data, folder, band, window, formats))
    if json:
        return print_json({"schema": 1, "figures": [str(path) for path in paths]})
    for path in paths:
        print(f"wrote {plain(str(path))}")
    return None


def export(
    name: StudyName,
    table: Annotated[str, typer.Option("--table", metavar="|".join(EXPORT_TABLES), help="What to export.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="The file to write; - for standard output.")
    ],
    format: Annotated[
        str | None,
        typer.Option(
            "--format", metavar="|".join(EXPORT_FORMATS), help="Its format (default: by the file's ending)."
        ),
    ] = None,
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    setting: SettingName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Write a study's records as one tidy table."""
    check_choice("--table", table, EXPORT_TABLES)
    form = format or EXPORT_SUFFIXES.get(out.suffix, "csv" if str(out) == "-" else "")
    if not form:
        endings = ", ".join(EXPORT_SUFFIXES)
        raise UserError(f"--out {out}: its ending tells no format; end it in {endings}, or give --format")
    check_choice("--format", form, EXPORT_FORMATS)
    selection = read_selection(preset, seeds, steps, engine, condition, set_)
    store = Store(results)
    record = study_record(store, name, selection, setting)
    from pneuma.analysis.export import encode_table
    from pneuma.analysis.sources import open_study

    data = open_study(store, record)
    _tell_left_out(data)
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if str(out) != "-":
        check_folder("--out", out.parent)
    encoded, rows = encode_table(data, table, form)
    if str(out) == "-":
        sys.stdout.buffer.write(encoded)
        return None
    write_whole(out, encoded)
    if json:
        return print_json({"schema": 1, "file": str(out), "rows": rows})
    print(f"wrote {out}: {rows:,} rows")
    return None


def publish(
    name: StudyName,
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    setting: SettingName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Write a study's runs as one small table, from which it is drawn and judged without them."""
    selection = read_selection(preset, seeds, steps, engine, condition, set_)
    store = Store(results)
    record = study_record(store, name, selection, setting)
    from pneuma.analysis.published import PublishedRuns, encode_study, published_path, published_studies
    from pneuma.analysis.published_times import encode_times, times_path
    from pneuma.analysis.sources import open_study

    data = open_study(store, record)
    if isinstance(data.source, PublishedRuns):
        raise UserError(f"study {data.study}: its runs are not in {results}; there is nothing new to publish")
    _tell_left_out(data)
    encoded = encode_study(data)
    path = published_path(store, data.study)
    store.write(path, encoded)
    store.write(times_path(store, data.study), encode_times(data))
    size = sum(published_path(store, study).stat().st_size for study in published_studies(store))
    if size > MOST_PUBLISHED_BYTES:
        say(f"Note: published tables come to {size / 1e6:.1f} MB; more than 20 MB is a lot to commit.", True)
    if json:
        document = {"schema": 1, "study": data.study, "file": str(path), "bytes": len(encoded)}
        return print_json({**document, "runs": len(data.runs)})
    print(f"wrote {plain(str(path))}: {len(data.runs)} runs, {len(encoded) / 1000:.0f} kB")
    return None


def _check_looks(band: str, window: str | None, formats: Iterable[str]) -> None:
    check_choice("--band", band, BAND_NAMES)
    if window is not None:
        check_choice("--window", window, WINDOWS)
    for form in formats:
        check_choice("--format", form, FIGURE_FORMATS)


def _studies_to_draw(
    store: Store,
    names: Sequence[str],
    selection: Selection | None,
    window: str | None,
    setting: str | None,
) -> list[StudyData]:
    """Return the data of studies, each with a figure's name of its own."""
    from pneuma.analysis.sources import open_study

    if not names:
        raise UserError(f"no study was run in {store.root} yet: run `pneuma study run activation` first")
    studies = [open_study(store, study_record(store, name, selection, setting)) for name in names]
    for data in studies:
        data.checked_window(window)
    stems = Counter(data.figure for data in studies)
    for data in studies:
        if stems[data.figure] > 1:
            data.figure += f"-{data.study}"
    return studies


def _draw(
    store: Store,
    studies: Sequence[StudyData],
    out: Path | None,
    figure: Callable[[StudyData, Path], list[Path]],
) -> list[Path]:
    """Draw studies into a folder that a person names, or else into that of the results.

    In a results folder, which may be a stranger's, no link is followed.
    """
    if out is not None:
        check_folder("--out", out)
    else:
        store.check_writable()
    for data in studies:
        _tell_left_out(data)
    if out is not None:
        return [path for data in studies for path in figure(data, out)]
    with TemporaryDirectory() as folder:
        drawn = [path for data in studies for path in figure(data, Path(folder))]
        paths = {path: store.root / "figures" / path.name for path in drawn}
        for path, target in paths.items():
            store.write(target, path.read_bytes())
    return list(paths.values())


def _figure(
    data: StudyData, folder: Path, band: str, window: str | None, formats: tuple[str, ...]
) -> list[Path]:
    from pneuma.figures.curves import draw_study

    return draw_study(data, folder, band, window, formats)


def _tell_left_out(data: StudyData) -> None:
    """Say how many runs of a selection are not shown, if any."""
    if data.left_out:
        of = f"{data.left_out} of {data.left_out + len(data.runs)} runs of {plain(data.study)}"
        say(f"Note: {of} are not finished, or damaged, and left out.", as_json=True)


def check_choice(option: str, value: str, allowed: Iterable[str]) -> None:
    """Refuse a value of an option that is none of those allowed."""
    if value not in allowed:
        raise UserError(f"{option} {value}: " + str(unknown_name("value", value, allowed)))


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder that cannot be written, before any work is done."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".pneuma-probe"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"{option} {folder}: cannot be written ({error.strerror})") from None
