"""The commands `pneuma report` and `figure`, and the group `import`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, check_file, command, say, write_file
from pneuma.cli.study_notes import nothing_yet
from pneuma.errors import counted
from pneuma.study.store import Store

logs = opt.Commands("Make a study of old logs.")
logs.callback()(lambda: None)  # keeps the name of a group's only command


def report(
    out: Path = opt.option("--out", "FILE", "The page to write, ending in .html.", default=opt.REQUIRED),
    names: opt.Several = opt.argument(
        "NAME", "Studies; left out: all that are shipped or were run.", default=None
    ),
    force: bool = opt.FORCE,
    results: Path = opt.RESULTS,
    quiet: bool = opt.QUIET,
) -> Result:
    """Write verdicts, figures, numbers, settings and runs as one HTML page that opens offline."""
    check_file(out, (".html", ".htm"), force)
    store, tell = Store(results), partial(say, aside=True, quiet=quiet)
    if lacking := nothing_yet(store):
        tell(f"Note: {lacking}.")
    from pneuma.cli.report import gather_report
    from pneuma.figures.report import report_page

    found = gather_report(store, names or [], tell)
    page = report_page(**found)
    write_file(out, page)
    studies, claims = len(found["studies"]), len(found["claims"])
    told = f"wrote {out}: {len(page) / 1e6:.1f} MB; studies: {studies}, claims: {claims}"
    return Result({"file": out, "bytes": len(page), "studies": studies, "claims": claims}, [told])


def figure(file: Path = opt.argument("FILE", "A PNG that Pneuma drew.")) -> Result:
    """Say where a figure comes from: the command that draws it, and the runs that it shows."""
    from pneuma.figures.origin import read_origin

    origin = read_origin(file)
    shown: list[str | Table] = [origin.command or "drawn by a script", f"Pneuma {origin.version}"]
    if origin.runs:
        rows = [(one.study, one.condition, one.seeds, ", ".join(one.ids)) for one in origin.runs]
        shown += ["", Table(("study", "condition", "seeds", "runs"), rows)]
    return Result({"file": file, **origin.model_dump()}, shown)


@logs.command(short_help="Import Stable-Baselines3's or CleanRL's TensorBoard logs.")
def tensorboard(
    folders: list[Path] = opt.argument("DIR", "Hold NAME_1/, NAME_2/, … with event files, or are one."),
    name: opt.Text = opt.option("--name", "NAME", "The study's name (default: the folder's)."),
    results: Path = opt.RESULTS,
) -> Result:
    """Import TensorBoard logs: of a folder NAME_1, NAME is the condition and the number the seed."""
    from pneuma.study.imported import import_tensorboard

    study, runs, notes = import_tensorboard(folders, Store(results), name)
    for note in notes:
        say(f"Note: {note}.", aside=True)
    rows = [
        {"run_id": run.run_id, "condition": run.log.condition, "seed": run.log.seed, "steps": run.steps,
         "imported": run.new}
        for run in runs
    ]  # fmt: skip
    new, points = sum(run.new for run in runs), sum(len(run.points) for run in runs)
    found = f"{counted(len(runs), 'run')}, {counted(points, 'point')}"
    shown = [
        f"{study}: {found}; {new} imported now, {len(runs) - new} were stored.",
        "Returns are means of 100 episodes.",
        f"Draw it with: {command('study', 'plot', study, '--results', results)}",
    ]
    return Result({"study": study, "runs": rows, "notes": notes}, shown)
