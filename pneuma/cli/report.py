"""`pneuma report`: all evidence as one page that opens offline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pneuma import __version__
from pneuma.cli.options import Json, Quiet, Results, print_json, read_path, say
from pneuma.cli.out_files import check_file, write_file
from pneuma.cli.plain_text import plain
from pneuma.cli.report_contents import anywhere, studies_to_report, study_section
from pneuma.cli.study_records import nothing_yet
from pneuma.errors import UserError, counted
from pneuma.study.store import Store

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
    check_file(out, ENDINGS)
    store = Store(results)
    if lacking := nothing_yet(store):
        say(f"Note: {lacking}.", aside=True, quiet=quiet)
    studies = studies_to_report(store, names or [])
    from pneuma.figures.judged import judged_claims
    from pneuma.figures.report import Report, report_page

    try:
        claims, note = judged_claims(store, studies)
        unjudged = ""
    except UserError as error:  # a damaged published table: the page says so, and shows the rest
        claims, note, unjudged = [], "", anywhere(store, error)
        say(f"Note: {error}; no claim is judged.", aside=True)
    sections = []
    for place, study in enumerate(studies, 1):
        say(f"{place}/{len(studies)} {plain(study)}", aside=True, quiet=quiet)
        sections.append(study_section(store, study))
    page = report_page(Report(claims, sections, note, __version__, unjudged))
    write_file(out, page)
    if json:
        document = {"schema": 1, "file": str(out), "bytes": len(page)}
        return print_json({**document, "studies": len(sections), "claims": len(claims)})
    held = f"{_studies(len(sections))}, {counted(len(claims), 'claim')}"
    print(f"wrote {plain(str(out))}: {len(page) / 1e6:.1f} MB, {held}")
    return None


def _studies(count: int) -> str:
    return "1 study" if count == 1 else f"{count} studies"
