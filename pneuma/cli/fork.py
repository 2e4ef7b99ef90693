"""`pneuma run fork`: go on from a stored run's checkpoint with one thing changed, beside a control."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from pneuma.cli.options import (
    Json,
    OwnSeeds,
    Quiet,
    Results,
    Settings,
    Trust,
    Workers,
    read_count,
    read_seeds_option,
    read_settings_options,
    read_workers,
)
from pneuma.cli.plain_text import plain
from pneuma.cli.study_run import train
from pneuma.config import FORK_RESETS
from pneuma.study.executors.base import Supervision
from pneuma.study.fork import Change, plan_fork
from pneuma.study.store import Store
from pneuma.study.stored_runs import find_run


def fork(
    name: Annotated[
        str, typer.Argument(metavar="RUN_ID", help="A stored run's id, or its first digits (4 at least).")
    ],
    at: Annotated[
        str, typer.Option("--at", metavar="STEP", help="Go on from the checkpoint nearest before this step.")
    ],
    set_: Settings = None,
    reset: Annotated[
        str, typer.Option("--reset", metavar="|".join(FORK_RESETS), help="What to begin anew at the fork.")
    ] = "",
    seeds: OwnSeeds = "3",
    workers: Workers = None,
    trust: Trust = False,
    results: Results = Path("results"),
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Go on from a run's checkpoint with something changed, and without: fresh random streams for each seed.

    The fork is a study of its own, of the conditions `control` and what was changed: `status`, `plot` and
    `export` take its name.
    """
    store = Store(results)
    settings = read_settings_options(set_)
    parent = find_run(store, name)
    step = read_count("--at", at)
    plan = plan_fork(store, parent, step, Change(settings, reset), read_seeds_option(seeds), trust)
    plan = replace(plan, notes=tuple(plain(note) for note in plan.notes))
    how = Supervision(workers=read_workers(workers))
    return train(plan, store, how, retry_failed=True, json=json, quiet=quiet)
