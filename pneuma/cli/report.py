"""`pneuma report`: all evidence as one page that opens offline."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pneuma.cli.options import Json, Quiet, Results, print_json, read_path, say
from pneuma.cli.out_files import check_file, write_file
from pneuma.cli.plain_text import plain
from pneuma.cli.study_records import nothing_yet
from pneuma.errors import counted
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
    from pneuma.cli.report_contents import gather_report
    from pneuma.figures.report import report_page

    found = gather_report(store, names or [], lambda told: say(plain(told), aside=True, quiet=quiet))
    page = report_page(found)
    write_file(out, page)
    studies, claims = len(found.studies), len(found.claims)
    if json:
        return print_json(
            {"schema": 1, "file": str(out), "bytes": len(page), "studies": studies, "claims": claims}
        )
    held = f"{studies} {'study' if studies == 1 else 'studies'}, {counted(claims, 'claim')}"
    print(f"wrote {plain(str(out))}: {len(page) / 1e6:.1f} MB, {held}")
    return None
