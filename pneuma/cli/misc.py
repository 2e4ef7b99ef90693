"""The commands without a group: `pneuma report`, `doctor`, and `import tensorboard`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from pneuma.cli import options as opt
from pneuma.cli.output import check_file, command, print_json, say, write_file
from pneuma.cli.study_records import nothing_yet
from pneuma.errors import counted, plain
from pneuma.study.store import Store

SIGNS = {"good": "ok", "note": "note", "broken": "BROKEN"}


def report(
    out: Annotated[Path, opt.path_option("--out", "FILE", "The page to write, ending in .html.")],
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]…", help="Studies; left out: all that are shipped or were run."),
    ] = None,
    results: opt.Results = opt.RESULTS,
    quiet: opt.Quiet = False,
    json: opt.Json = False,
) -> None:
    """Write verdicts, figures, numbers, settings and runs as one HTML page that opens offline."""
    check_file(out, (".html", ".htm"))
    store = Store(results)
    if lacking := nothing_yet(store):
        say(f"Note: {lacking}.", aside=True, quiet=quiet)
    from pneuma.cli.report import gather_report
    from pneuma.figures.report import report_page

    found = gather_report(store, names or [], lambda told: say(plain(told), aside=True, quiet=quiet))
    page = report_page(**found)
    write_file(out, page)
    studies, claims = len(found["studies"]), len(found["claims"])
    if json:
        return print_json(
            {"schema": 1, "file": str(out), "bytes": len(page), "studies": studies, "claims": claims}
        )
    held = f"{studies} {'study' if studies == 1 else 'studies'}, {counted(claims, 'claim')}"
    print(f"wrote {plain(str(out))}: {len(page) / 1e6:.1f} MB, {held}")
    return None


def doctor(results: opt.Results = opt.RESULTS, json: opt.Json = False) -> None:
    """Say what is installed here and whether it works, with the mend for what does not."""
    from pneuma.doctor import BROKEN, examine

    findings = []
    for finding in examine(results):
        findings.append(finding)
        if not json:
            print(f"{SIGNS[finding.state]:<7} {finding.check:<19} {plain(finding.told)}", flush=True)
            if finding.mend:
                print(f"{'':<27} -> {plain(finding.mend)}", flush=True)
    sound = all(finding.state != BROKEN for finding in findings)
    if json:
        print_json({"schema": 1, "ok": sound, "checks": [asdict(finding) for finding in findings]})
    elif sound:
        print("\nAll that Pneuma needs is here. Begin with: pneuma study run activation")
    else:
        print("\nSomething that Pneuma needs is broken: mend what is marked above, then ask again.")
    if not sound:
        raise typer.Exit(1)


def tensorboard(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR…", help="Hold NAME_1/, NAME_2/, … with event files, or are one."),
    ],
    name: Annotated[
        opt.Text, opt.option("--name", "NAME", "The study's name (default: the folder's).")
    ] = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Import TensorBoard logs: of a folder NAME_1, NAME is the condition and the number the seed."""
    from pneuma.study.imported import import_tensorboard

    done = import_tensorboard(folders, Store(results), name)
    for note in done.notes:
        say(plain(f"Note: {note}."), aside=True)
    if json:
        rows = [
            {
                **{key: getattr(run, key) for key in ("run_id", "condition", "seed")},
                **{"status": "done", "imported": run.new, "steps": run.steps, "points": len(run.points)},
                "superseded": int(run.points["superseded"].sum()),
                "damage": run.provenance["damage"],
            }
            for run in done.runs
        ]
        return print_json({"schema": 1, "study": done.study, "runs": rows, "notes": done.notes})
    new, points = sum(run.new for run in done.runs), sum(len(run.points) for run in done.runs)
    kept = len(done.runs) - new
    print(f"{done.study}: {len(done.runs)} runs, {points:,} points; {new} imported now, {kept} were stored.")
    print("Returns are means of 100 episodes.")
    print(f"Draw it with: {command('study', 'plot', done.study, '--results', results)}")
    return None
