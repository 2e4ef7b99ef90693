"""The commands `pneuma report`, `figure` and `doctor`, and the groups `import` and `bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pneuma.cli import options as opt
from pneuma.cli.output import check_file, command, print_json, print_rows, print_table, say, write_file
from pneuma.cli.study_records import nothing_yet
from pneuma.errors import counted
from pneuma.study.store import Store

logs = typer.Typer(help="Make a study of old logs.", no_args_is_help=True, rich_markup_mode=None)
logs.callback()(lambda: None)  # keeps the name of a group's only command
bench = typer.Typer(help="Measure speed on this machine.", no_args_is_help=True, rich_markup_mode=None)
bench.callback()(lambda: None)


def report(
    out: Annotated[Path, opt.option("--out", "FILE", "The page to write, ending in .html.")],
    names: Annotated[
        list[str] | None, opt.argument("NAME", "Studies; left out: all that are shipped or were run.")
    ] = None,
    force: opt.Force = False,
    results: opt.Results = opt.RESULTS,
    quiet: opt.Quiet = False,
    json: opt.Json = False,
) -> None:
    """Write verdicts, figures, numbers, settings and runs as one HTML page that opens offline."""
    check_file(out, (".html", ".htm"), force)
    store = Store(results)
    if lacking := nothing_yet(store):
        say(f"Note: {lacking}.", aside=True, quiet=quiet)
    from pneuma.cli.report import gather_report
    from pneuma.figures.report import report_page

    found = gather_report(store, names or [], lambda message: say(message, aside=True, quiet=quiet))
    page = report_page(**found)
    write_file(out, page)
    studies, claims = len(found["studies"]), len(found["claims"])
    if json:
        return print_json({"file": out, "bytes": len(page), "studies": studies, "claims": claims})
    return say(f"wrote {out}: {len(page) / 1e6:.1f} MB; studies: {studies}, claims: {claims}")


def figure(
    file: Annotated[Path, opt.argument("FILE", "A PNG, SVG or PDF that Pneuma drew.")], json: opt.Json = False
) -> None:
    """Say where a figure comes from: the command that draws it, and the runs that it shows."""
    from pneuma.figures.origin import read_origin

    origin = read_origin(file)
    if json:
        return print_json({"file": file, **origin.model_dump()})
    say(origin.command or "drawn by a script")
    say(f"Pneuma {origin.version}")
    if origin.runs:
        print()
        rows = [(one.study, one.condition, one.seeds, ", ".join(one.ids)) for one in origin.runs]
        print_table(("study", "condition", "seeds", "runs"), rows)
    return None


def doctor(results: opt.Results = opt.RESULTS, json: opt.Json = False) -> None:
    """Say what is installed here and whether it works, with the fix for what does not."""
    from pneuma.doctor import BROKEN, examine

    findings = [*examine(results)]
    sound = all(finding.state != BROKEN for finding in findings)
    if json:
        print_json({"ok": sound, "checks": findings})
    else:
        rows = [(each.check, each.state, each.found, each.fix and f"-> {each.fix}") for each in findings]
        print_table([""] * 4, rows)
        begin = "All that Pneuma needs is here. Begin with: pneuma study run activation"
        print(f"\n{begin}" if sound else "\nSomething that Pneuma needs is broken: fix it, then ask again.")
    if not sound:
        raise typer.Exit(1)


@logs.command(short_help="Import Stable-Baselines3's or CleanRL's TensorBoard logs.")
def tensorboard(
    folders: Annotated[
        list[Path], opt.argument("DIR", "Hold NAME_1/, NAME_2/, … with event files, or are one.")
    ],
    name: Annotated[
        opt.Text, opt.option("--name", "NAME", "The study's name (default: the folder's).")
    ] = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Import TensorBoard logs: of a folder NAME_1, NAME is the condition and the number the seed."""
    from pneuma.study.imported import import_tensorboard

    study, runs, notes = import_tensorboard(folders, Store(results), name)
    for note in notes:
        say(f"Note: {note}.", aside=True)
    if json:
        rows = [
            {"run_id": run.run_id, "condition": run.log.condition, "seed": run.log.seed,
             "steps": run.steps, "imported": run.new}
            for run in runs
        ]  # fmt: skip
        return print_json({"study": study, "runs": rows, "notes": notes})
    new, points = sum(run.new for run in runs), sum(len(run.points) for run in runs)
    kept = len(runs) - new
    found = f"{counted(len(runs), 'run')}, {counted(points, 'point')}"
    say(f"{study}: {found}; {new} imported now, {kept} were stored.")
    print("Returns are means of 100 episodes.")
    return say(f"Draw it with: {command('study', 'plot', study, '--results', results)}")


# --- bench -----------------------------------------------------------------------------------------


@bench.command(short_help="Measure the environment in agent steps a second.")
def env(json: opt.Json = False) -> None:
    """Measure the environment's faces in agent steps a second, on one core."""
    from pneuma.bench.env import bench_env

    return print_rows("cases", bench_env(), json)
