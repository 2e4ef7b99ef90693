"""`pneuma search promote`, `winners` and `publish`, and the runs of `pneuma search run --sensitivity`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.options import (
    Json,
    OwnSeeds,
    Quiet,
    Results,
    Steps,
    Workers,
    WorldName,
    print_json,
    read_count,
    read_path,
    read_seeds_option,
    read_workers,
    say,
)
from pneuma.cli.out_files import check_file, write_file
from pneuma.cli.plain_text import command, plain
from pneuma.cli.search_run import SearchName, called_by_file, record_name, recorded
from pneuma.cli.study_run import train, train_cells
from pneuma.errors import UserError
from pneuma.study import plan, spec
from pneuma.study.executors.base import Supervision
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.search.promote import Gain
    from pneuma.search.spec import Search
    from pneuma.search.trials import Task


def promote(
    name: SearchName,
    seeds: OwnSeeds = "10",
    steps: Steps = None,
    trial: Annotated[
        str | None, typer.Option("--trial", metavar="N", help="Which trial (default: the best).")
    ] = None,
    world: WorldName = None,
    workers: Workers = None,
    results: Results = Path("results"),
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Train a search's winner and its baseline on fresh seeds, and say how much of its gain was luck."""
    from pneuma.search import promote as promoting

    store = Store(results)
    search, record = _recorded(store, name, world)
    chosen = promoting.winner(record, None if trial is None else _number(trial))
    fresh = read_seeds_option(seeds)
    promoting.refuse_seen_seeds(fresh, record)
    budget = record["steps"] if steps is None else read_count("--steps", steps)
    how = Supervision(workers=read_workers(workers))
    path = store.root / "searches" / f"{_promoted_name(search)}.toml"
    store.check_writable()
    store.write(path, promoting.promoted_study(search, record, chosen).encode())
    planned = plan.make_plan(spec.load_study(str(path)), plan.Selection(seeds=fresh, steps=budget))
    say(f"wrote {plain(str(path))}", aside=True, quiet=quiet)
    _, code = train_cells(planned, store, how, retry_failed=True, json=json, quiet=quiet)
    if code:
        say(f"Not all runs ended: {command('study', 'status', path, '--results', store.root)}", aside=True)
        return code
    gains = promoting.gains(search, record, chosen, planned, store)
    ends = [(cell.condition, store.status(cell.run_id).name) for cell in planned.cells]
    diverged = {arm: ends.count((arm, "diverged")) for arm in planned.conditions}
    if json:
        print_json({**_document(search, chosen, path, planned, gains), "diverged": diverged})
        return 0
    _tell(search, chosen, planned, gains)
    for arm, count in diverged.items():
        if count:
            print(f"  {count} of the {arm}'s {len(planned.seeds)} runs diverged, and count as in a search")
    return 0


def winners(
    names: Annotated[
        list[str], typer.Argument(metavar="NAME", help="Searches that were tuned alike, or their files.")
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", parser=read_path, help="The study file to write, ending in .toml."
        ),
    ],
    world: WorldName = None,
    results: Results = Path("results"),
    json: Json = False,
) -> None:
    """Write a study of several searches' winners, each beside what it was tuned from."""
    from pneuma.search.winners import find_winner, winners_study

    if out.suffix != ".toml":
        raise UserError(f"--out {out}: must end in .toml, as study files do")
    check_file(out, (".toml",))
    if out.exists():
        raise UserError(f"--out {out}: is there already; name another, or remove it first")
    store = Store(results)
    found = [find_winner(*_recorded(store, name, world)) for name in names]
    write_file(out, winners_study(found).encode())
    if json:
        trials = {winner.search.name: winner.trial["number"] for winner in found}
        return print_json({"schema": 1, "study": str(out), "trials": trials})
    print(f"wrote {plain(str(out))}")
    print(f"Train it with: {command('study', 'run', out, '--results', results)}")
    return None


def publish(
    names: Annotated[
        list[str], typer.Argument(metavar="NAME", help="Searches that have ended, or their files.")
    ],
    replace: Annotated[
        bool, typer.Option("--replace", help="Put them in the place of other trials of the same name.")
    ] = False,
    world: WorldName = None,
    results: Results = Path("results"),
    json: Json = False,
) -> None:
    """Write what searches tried and found into RESULTS/published, for version control."""
    from pneuma.search.record import publish_record

    store, paths = Store(results), []
    for name in names:
        called = called_by_file(name, world)
        paths.append(publish_record(store, record_name(name, world), called=called, replace=replace))
    if json:
        return print_json({"schema": 1, "published": [str(path) for path in paths]})
    for path in paths:
        print(f"wrote {plain(str(path))}")
    return None


def run_sensitivity(
    task: Task, store: Store, how: Supervision, retry_failed: bool, json: bool, quiet: bool
) -> int:
    """Train the study of one hyperparameter at a time; return the exit code."""
    from pneuma.search.driver import check_outcomes
    from pneuma.search.sensitivity import left_out, plan_sensitivity, save_points

    check_outcomes(task)
    planned = plan_sensitivity(task)
    if left := left_out(task):
        told = f"left out, as the base has no value of it in the space: {', '.join(left)}"
        say(f"Note: {told}.", aside=True, quiet=quiet)
    code = train(planned, store, how, retry_failed, json, quiet)
    save_points(store, task)
    drawn = command("search", "plot", task.search.name, "--sensitivity", "--results", store.root)
    say(f"Draw it with: {drawn}", aside=True, quiet=quiet)
    return code


def _recorded(store: Store, name: str, world: str | None) -> tuple[Search, dict[str, Any]]:
    """Return a search as it was recorded, and its record."""
    from pneuma.search.recorded import recorded_search
    from pneuma.search.spec import load_search

    record = recorded(store, name, world)
    source = name if name.endswith(".toml") else _source(record, name)
    return recorded_search(load_search(source, world), record), record


def _source(record: Mapping[str, Any], name: str) -> str:
    """Return what to load a recorded search by: a shipped one by its name.

    A file that only a record names may be a stranger's; the person is to name it.
    """
    from pneuma.search.spec import list_searches
    from pneuma.worlds import split_world

    if split_world(name)[0] in list_searches():
        return name
    raise UserError(f"search {name} is no shipped one: name its file, {plain(str(record.get('path')))}")


def _promoted_name(search: Search) -> str:
    """Return what the study of a search's winner is called; the end of a name tells a study's world."""
    from pneuma.worlds import TEXT, split_world

    own, world = split_world(search.name)
    return f"promoted-{own}" if world == TEXT else f"promoted-{world}-{own}"


def _number(text: str) -> int:

    if not text.isdecimal():
        raise UserError(f"--trial {text}: must be the number of a trial")
    return int(text)


def _document(
    search: Search, chosen: Mapping[str, Any], path: Path, planned: plan.Plan, gains: Mapping[str, Gain]
) -> dict[str, Any]:
    return {
        "schema": 1,
        "search": search.name,
        "trial": chosen["number"],
        "params": chosen["params"],
        "study": str(path),
        "seeds": list(planned.seeds),
        "run_ids": {
            name: [c.run_id for c in planned.cells if c.condition == name] for name in planned.conditions
        },
        "objectives": {
            objective.name: {
                **asdict(gains[objective.name]),
                "luck": _flattered(search, objective.name, gains),
            }
            for objective in search.objectives
        },
    }


def _tell(
    search: Search,
    chosen: Mapping[str, Any],
    planned: plan.Plan,
    gains: Mapping[str, Gain],
) -> None:
    print(f"Trial {chosen['number']} of search {search.name} on {len(planned.seeds)} fresh seeds:")
    for objective in search.objectives:
        own = gains[objective.name]
        low, high = own.interval
        print(f"  {objective.over_seeds} over seeds of {objective.outcome}:")
        print(f"    in the search      {own.seen:.4f}" + _beside(own.seen_baseline, "no trial of the search"))
        print(f"    on fresh seeds     {own.fresh:.4f}" + _beside(own.fresh_baseline, "no value"))
        told = (
            f"95 % interval {low:+.4f} to {high:+.4f}"
            if math.isfinite(low)
            else "too few seeds for an interval"
            if math.isfinite(own.difference)
            else "some run has no value"
        )
        print(f"    difference of means {own.difference:+.4f} ({told})")
        flattered = _flattered(search, objective.name, gains)
        print(
            f"    luck               {flattered:+.4f}: by how much the search's seeds had flattered it"
            if math.isfinite(flattered)
            else f"    luck               cannot be told: {own.incomparable or 'some run has no value'}"
        )


def _flattered(search: Search, objective: str, gains: Mapping[str, Gain]) -> float:
    """Return by how much the search's seeds made the winner look better than fresh ones do."""
    (sought,) = (own for own in search.objectives if own.name == objective)
    return gains[objective].luck if sought.direction == "maximize" else -gains[objective].luck


def _beside(baseline: float, lacking: str) -> str:
    known = f"{baseline:.4f})" if math.isfinite(baseline) else f"{lacking})"
    return f"   (baseline: {known}"
