"""`pneuma import …`: old logs as studies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.hints import command, write_hint
from pneuma.cli.output import Result, check_file, say, write_file
from pneuma.errors import UserError, counted, write_hints
from pneuma.store.store import Store
from pneuma.study.command_words import results_words

if TYPE_CHECKING:
    from pneuma.imports.logs import Import, Log

app = opt.Commands("import", "Import logs of other programs as a study.")


@app.command(short_help="Import Stable-Baselines3's or CleanRL's TensorBoard logs.")
def tensorboard(
    folders: Annotated[
        list[Path], opt.argument("DIR", "Folders of runs NAME_1/, NAME_2/, …, or one run's folder.")
    ],
    name: Annotated[str | None, opt.option("NAME", "The study's name (default: the folder's).")] = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """Import TensorBoard logs. A folder NAME_1 holds condition NAME, seed 1."""
    from pneuma.imports.tensorboard import import_tensorboard

    return _imported(import_tensorboard(folders, Store(results), name), results)


_CONDITION = "A column, or one condition for all rows (default: the file's name without _SEED)."
_SEED = "A column, or one seed for all rows (default: SEED in a file name NAME_SEED)."
_AVERAGED = (
    "Episodes averaged in each return; 1 if it is a single episode's (default: keep returns as they are)."
)


@app.command(short_help="Import CSV tables or Stable-Baselines3 monitor files.")
def csv(
    files: Annotated[
        list[Path], opt.argument("FILE", "CSV files of tidy rows, or Stable-Baselines3 monitor files.")
    ],
    step: Annotated[str, opt.option("COLUMN", "Column with agent steps.")] = "",
    value: Annotated[
        opt.Several,
        opt.option("COLUMN[=QUANTITY]", "Column with values of the return, or of QUANTITY (repeatable)."),
    ] = None,
    condition: Annotated[str, opt.option("COLUMN|TEXT", _CONDITION)] = "",
    seed: Annotated[str, opt.option("COLUMN|N", _SEED)] = "",
    averaged_over: Annotated[Any, opt.count(_AVERAGED)] = None,
    name: Annotated[str | None, opt.option("NAME", "The study's name (default: the file's).")] = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """Import runs from CSV files, whose rows hold step, value, condition and seed. A monitor file is one run.

    Several monitor files given with one --condition and --seed are the environments of one run. Without
    options, the command lists a file's columns. QUANTITY is return, length, evaluated_return, success or a
    metric of updates.
    """
    from pneuma.imports.csv_files import Columns, import_csv

    columns = Columns(step, tuple(value or ()), condition, seed, averaged_over)
    return _imported(import_csv(files, columns, Store(results), name), results)


@app.command(short_help="Write an entry of rl-baselines3-zoo as a study.")
def zoo(
    file: Annotated[Path, opt.argument("FILE", "A file of the zoo's hyperparameters, as ppo.yml.")],
    env: Annotated[str, opt.option("ID", "The environment, whose entry is taken.")],
    out: Annotated[Path, opt.option("FILE", "The study's file to write, ending in .toml.")],
) -> Result:
    """Write an entry of rl-baselines3-zoo as a study, with a note on each key that cannot be kept."""
    from pneuma.imports.zoo import zoo_study

    check_file(out, (".toml",))
    if out.exists():
        raise UserError(f"--out {out}: already exists; choose another name")
    study_text, notes = zoo_study(file, env)
    write_file(out, study_text.encode())
    lines = [f"wrote {out}: {command('study', 'plan', str(out))} shows its runs"]
    return Result({"file": out, "notes": notes}, lines, notes=[f"Note: {note}." for note in notes])


def _imported(imported: Import, results: Path) -> Result:
    study, logs, messages = imported
    notes = [write_hints(message, write_hint) for message in messages]
    for note in notes:
        say(f"Note: {note}.")
    run_rows: list[dict[str, object]] = []
    new_count = point_count = 0
    for log in logs:
        identity = {"run_id": log.run_id, "condition": log.condition, "seed": log.seed}
        run_rows.append({**identity, "steps": log.steps, "imported": log.new})
        new_count += log.new
        point_count += len(log.points)
    amounts = f"{counted(len(logs), 'run')}, {counted(point_count, 'point')}"
    lines = [
        f"{study}: {amounts}; {new_count} imported now, {len(logs) - new_count} were stored.",
        _averaging(logs),
        f"Draw it with: {command('study', 'plot', study, *results_words(results))}",
    ]
    return Result({"study": study, "runs": run_rows, "notes": notes}, lines)


def _averaging(logs: list[Log]) -> str:
    """Return of how many episodes the runs' returns are means."""
    episode_counts = {log.provenance.get("averaged_over", 100) for log in logs}
    if None in episode_counts:
        return (
            "Returns are kept as in the file. If they are single episodes', --averaged-over 1 averages them."
        )
    episodes = max(100, *episode_counts)
    if episodes == 100:
        return "Returns are means of 100 episodes."
    return f"Returns are means of {episodes} episodes, and so smoother than those of runs trained here (100)."
