"""The command `pneuma report`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from pneuma.cli import options as opt
from pneuma.cli.hints import write_hint
from pneuma.cli.output import Result, check_file, nothing_yet, say, write_file
from pneuma.store.store import Store

app = opt.Commands("", "")


@app.command(short_help="Write all evidence as one HTML page.")
def report(
    out: Annotated[Path, opt.option("FILE", "The page to write, ending in .html.")],
    names: Annotated[
        opt.Several, opt.argument("NAME", "Studies (default: those run here, or all published).")
    ] = None,
    force: opt.Force = False,
    results: opt.Results = opt.HERE,
    quiet: opt.Quiet = False,
) -> Result:
    """Write verdicts, figures, numbers, settings and runs as one HTML page for offline reading."""
    check_file(out, (".html", ".htm"), force)
    store, say_unless_quiet = Store(results), partial(say, quiet=quiet)
    nothing = nothing_yet(store)
    if nothing:
        say_unless_quiet(f"Note: {nothing}.")
    from pneuma.figures.report import gather_report, report_page
    from pneuma.store.index import RunIndex

    contents = gather_report(RunIndex(store), names or [], say_unless_quiet)
    html_page = report_page(**contents, write=write_hint)
    write_file(out, html_page)
    studies, claims = len(contents["studies"]), len(contents["claims"])
    document = {"file": out, "bytes": len(html_page), "studies": studies, "claims": claims}
    amounts = f"{len(html_page) / 1e6:.1f} MB; studies: {studies}, claims: {claims}"
    return Result(document, [f"wrote {out}: {amounts}"])
