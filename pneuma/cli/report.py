"""The command `pneuma report`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, check_file, nothing_yet, say, write_file
from pneuma.store.store import Store

app = opt.Commands("", "")


@app.command(short_help="Write all evidence as one HTML page.")
def report(
    out: Annotated[Path, opt.option("FILE", "The page to write, ending in .html.")],
    names: Annotated[opt.Several, opt.argument("NAME", "Studies (default: all shipped or run).")] = None,
    force: opt.Force = False,
    results: opt.Results = opt.HERE,
    quiet: opt.Quiet = False,
) -> Result:
    """Write verdicts, figures, numbers, settings and runs as one HTML page that opens offline."""
    check_file(out, (".html", ".htm"), force)
    store, tell = Store(results), partial(say, quiet=quiet)
    if lacking := nothing_yet(store):
        tell(f"Note: {lacking}.")
    from pneuma.figures.report import report_page
    from pneuma.figures.report_data import gather_report

    found = gather_report(store, names or [], tell)
    page = report_page(**found)
    write_file(out, page)
    studies, claims = len(found["studies"]), len(found["claims"])
    told = f"wrote {out}: {len(page) / 1e6:.1f} MB; studies: {studies}, claims: {claims}"
    return Result({"file": out, "bytes": len(page), "studies": studies, "claims": claims}, [told])
