"""`pneuma import …`: old logs as studies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, command, say
from pneuma.errors import counted
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.imports.logs import ImportedRun

app = opt.Commands("import", "Make a study of old logs.")


@app.command(short_help="Import Stable-Baselines3's or CleanRL's TensorBoard logs.")
def tensorboard(
    folders: Annotated[list[Path], opt.argument("DIR", "Hold NAME_1/, … with event files, or are one.")],
    name: Annotated[str | None, opt.option("NAME", "The study's name (default: the folder's).")] = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """Import TensorBoard logs: of a folder NAME_1, NAME is the condition and the number the seed."""
    from pneuma.imports.tensorboard import import_tensorboard

    return _imported(import_tensorboard(folders, Store(results), name), results)


@app.command(short_help="Import CSV files: wandb's exports, Stable-Baselines3's, or any other.")
def csv(
    files: Annotated[
        list[Path], opt.argument("FILE", "Of wandb, a monitor.csv, progress.csv, or NAME_SEED.csv.")
    ],
    step: Annotated[str, opt.option("COLUMN", "The column of agent steps, where a file does not tell.")] = "",
    returns: Annotated[
        str, opt.option("COLUMN", "That of returns, or of RUN - COLUMN.", name="--return")
    ] = "",
    averaged_over: Annotated[Any, opt.count("Episodes that a return averages, if a file is silent.")] = None,
    name: Annotated[str | None, opt.option("NAME", "The study's name (default: the file's).")] = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """Import returns from CSV files: of NAME_1, NAME is the condition and the number the seed."""
    from pneuma.imports.csv_files import import_csv

    return _imported(import_csv(files, Store(results), name, step, returns, averaged_over), results)


def _imported(found: tuple[str, list[ImportedRun], list[str]], results: Path) -> Result:
    study, runs, notes = found
    for note in notes:
        say(f"Note: {note}.")
    rows = [
        {"run_id": run.run_id, "condition": run.condition, "seed": run.seed, "steps": run.log.steps,
         "imported": run.new}
        for run in runs
    ]  # fmt: skip
    new, points = sum(run.new for run in runs), sum(len(run.log.points) for run in runs)
    amount = f"{counted(len(runs), 'run')}, {counted(points, 'point')}"
    episodes = max(100, *(run.log.provenance.get("averaged_over", 100) for run in runs))
    means = "" if episodes == 100 else "; those of runs trained here are of 100, and less smooth"
    shown = [
        f"{study}: {amount}; {new} imported now, {len(runs) - new} were stored.",
        f"Returns are means of {episodes} episodes{means}.",
        f"Draw it with: {command('study', 'plot', study, '--results', results)}",
    ]
    return Result({"study": study, "runs": rows, "notes": notes}, shown)
