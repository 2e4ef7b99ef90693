"""`pneuma import …`: old logs as studies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.hints import command
from pneuma.cli.output import Result, say
from pneuma.errors import counted
from pneuma.store.store import Store
from pneuma.study.spec import results_words

if TYPE_CHECKING:
    from pneuma.imports.logs import Import, Log

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


_CONDITION = "A column, or the condition of all rows (default: as the file is called, without _SEED)."
_SEED = "A column, or the seed of all rows (default: the number in the file's name NAME_SEED)."
_AVERAGED = "Episodes that a return averages; 1 where each is one episode's (default: as they are)."


@app.command(short_help="Import tables of tidy rows, or Stable-Baselines3's monitors.")
def csv(
    files: Annotated[list[Path], opt.argument("FILE", "CSV files of tidy rows, or monitors.")],
    step: Annotated[str, opt.option("COLUMN", "The column of agent steps.")] = "",
    value: Annotated[
        opt.Several, opt.option("COLUMN[=QUANTITY]", "A column of values: the return, or another quantity.")
    ] = None,
    condition: Annotated[str, opt.option("COLUMN|TEXT", _CONDITION)] = "",
    seed: Annotated[str, opt.option("COLUMN|N", _SEED)] = "",
    averaged_over: Annotated[Any, opt.count(_AVERAGED)] = None,
    name: Annotated[str | None, opt.option("NAME", "The study's name (default: the file's).")] = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """Import runs from CSV files: of each row step, value, condition and seed. A monitor is one run.

    With condition and seed, several monitors are one run's environments. Without options the command lists
    the columns of a file. QUANTITY is return, length, evaluated_return, success or a metric of updates.
    """
    from pneuma.imports.csv_files import Columns, import_csv

    columns = Columns(step, tuple(value or ()), condition, seed, averaged_over)
    return _imported(import_csv(files, columns, Store(results), name), results)


def _imported(imported: Import, results: Path) -> Result:
    study, logs, notes = imported
    for note in notes:
        say(f"Note: {note}.")
    runs: list[dict[str, object]] = []
    new = points = 0
    for log in logs:
        identity = {"run_id": log.run_id, "condition": log.condition, "seed": log.seed}
        runs.append({**identity, "steps": log.steps, "imported": log.new})
        new += log.new
        points += len(log.points)
    amount = f"{counted(len(logs), 'run')}, {counted(points, 'point')}"
    lines = [
        f"{study}: {amount}; {new} imported now, {len(logs) - new} were stored.",
        _averaging(logs),
        f"Draw it with: {command('study', 'plot', study, *results_words(results))}",
    ]
    return Result({"study": study, "runs": runs, "notes": notes}, lines)


def _averaging(logs: list[Log]) -> str:
    """Return of how many episodes the runs' returns are means."""
    averaged = {log.provenance.get("averaged_over", 100) for log in logs}
    if None in averaged:
        return "Returns are as in the file; --averaged-over 1 averages single episodes as runs trained here."
    episodes = max(100, *averaged)
    if episodes == 100:
        return "Returns are means of 100 episodes."
    return (
        f"Returns are means of {episodes} episodes; those of runs trained here are of 100, and less smooth."
    )
