"""`pneuma import …`: make a study of what other programs wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pneuma.cli.options import Json, Results, print_json, say
from pneuma.cli.plain_text import command, plain
from pneuma.study.store import Store

app = typer.Typer(help="Make a study of old logs.", no_args_is_help=True, rich_markup_mode=None)

RESULTS = Path("results")


@app.callback()
def _group() -> None:
    """Make a study of old logs."""


@app.command(short_help="Import Stable-Baselines3's or CleanRL's TensorBoard logs.")
def tensorboard(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR…", help="Hold NAME_1/, NAME_2/, … with event files, or are one."),
    ],
    name: Annotated[
        str | None, typer.Option("--name", metavar="NAME", help="The study's name (default: the folder's).")
    ] = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Import TensorBoard logs: of a folder NAME_1, NAME is the condition and the number the seed."""
    from pneuma.study.imported import import_tensorboard

    done = import_tensorboard(folders, Store(results), name)
    for note in done.notes:
        say(plain(f"Note: {note}."), aside=True)
    if json:
        rows = [
            {
                "run_id": run.run_id,
                "condition": run.condition,
                "seed": run.seed,
                "status": "done",
                "imported": run.new,
                "steps": run.steps,
                "points": len(run.points),
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
