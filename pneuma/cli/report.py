"""`pneuma report`: all evidence as one page that opens offline."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Annotated

import typer

from pneuma import __version__
from pneuma.cli.options import Json, Quiet, Results, print_json, read_path, say
from pneuma.cli.plain_text import plain
from pneuma.cli.report_contents import anywhere, studies_to_report, study_section
from pneuma.errors import UserError, counted
from pneuma.study.store import Store, write_whole

RESULTS = Path("results")
ENDINGS = (".html", ".htm")


def report(
    out: Annotated[
        Path,
        typer.Option("--out", metavar="FILE", parser=read_path, help="The page to write, ending in .html."),
    ],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help="Studies; left out: all that are shipped or were run."),
    ] = None,
    results: Results = RESULTS,
    quiet: Quiet = False,
    json: Json = False,
) -> None:
    """Write verdicts, figures, numbers, settings and runs as one HTML page that opens offline."""
    _check_out(out)
    store = Store(results)
    studies = studies_to_report(store, names or [])
    from pneuma.figures.judged import judged_claims
    from pneuma.figures.report import Report, report_page

    try:
        claims, note = judged_claims(store, studies)
    except UserError as error:  # a damaged published table: the page says so, and shows the rest
        claims, note = [], anywhere(store, error)
    sections = []
    for place, study in enumerate(studies, 1):
        say(f"{place}/{len(studies)} {plain(study)}", aside=True, quiet=quiet)
        sections.append(study_section(store, study))
    page = report_page(Report(claims, sections, note, __version__))
    try:
        write_whole(out, page)
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None
    if json:
        document = {"schema": 1, "file": str(out), "bytes": len(page)}
        return print_json({**document, "studies": len(sections), "claims": len(claims)})
    held = f"{_studies(len(sections))}, {counted(len(claims), 'claim')}"
    print(f"wrote {plain(str(out))}: {len(page) / 1e6:.1f} MB, {held}")
    return None


def _studies(count: int) -> str:
    return "1 study" if count == 1 else f"{count} studies"


def _check_out(out: Path) -> None:
    """Refuse a file that cannot be written, before any work is done."""
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if out.suffix.lower() not in ENDINGS:
        raise UserError(f"--out {out}: must end in {' or '.join(ENDINGS)}")
    if not out.parent.is_dir():
        raise UserError(f"--out {out}: there is no folder {out.parent}")
    try:
        with tempfile.TemporaryFile(dir=out.parent):
            pass
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None
