"""`pneuma search promote`: winners beside their searches' bases as a study, and what they gained."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from pneuma.cli.study_run import train_cells
from pneuma.errors import UserError
from pneuma.study import plan, spec
from pneuma.study.executors.base import Supervision
from pneuma.study.store import Store
from pneuma.worlds import TEXT, in_world, split_world

if TYPE_CHECKING:
    from pneuma.search.promote import Gain, Winner
    from pneuma.search.storage import Searched


def promote(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME…", help="Searches, or their files; several must be tuned alike."),
    ],
    seeds: OwnSeeds = "10",
    steps: Steps = None,
    trial: Annotated[
        str | None, typer.Option("--trial", metavar="N", help="Which trial (default: the best).")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", parser=read_path, help="Write the study to a .toml file; train nothing."
        ),
    ] = None,
    world: WorldName = None,
    workers: Workers = None,
    results: Results = Path("results"),
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Train searches' winners and their bases on fresh seeds, and say how much of the gain was luck."""
    from pneuma.search import promote as promoting

    if trial is not None and (not trial.isdecimal() or len(names) > 1):
        raise UserError(f"--trial {trial}: must be the number of a trial of one search")
    store, fresh = Store(results), read_seeds_option(seeds)
    searches = [recorded(store, name, world) for name in names]
    winners = promoting.find_winners(searches, None if trial is None else int(trial), fresh)
    for name, winner in zip(names, winners, strict=True):
        _refuse_untrusted(winner, name, world)
    budget = searches[0].task.budget.steps if steps is None else read_count("--steps", steps)
    text = promoting.winners_study(winners, fresh, budget).encode()
    chosen = [
        {"search": own.searched.task.search.name, "trial": own.trial.number, "params": own.trial.params}
        for own in winners
    ]
    if out is not None:
        _write_new(out, text)
        told = command("study", "run", out, "--results", results)
        if json:
            print_json({"schema": 1, "study": str(out), "winners": chosen})
        else:
            print(f"wrote {plain(str(out))}\nTrain it with: {told}")
        return 0
    path = store.root / "searches" / f"{_study_name(searches)}.toml"
    store.check_writable()
    store.write(path, text)
    planned = plan.make_plan(spec.load_study(str(path)), plan.Selection(seeds=fresh, steps=budget))
    say(f"wrote {plain(str(path))}", aside=True, quiet=quiet)
    how = Supervision(workers=read_workers(workers))
    _, code = train_cells(planned, store, how, retry_failed=True, json=json, quiet=quiet)
    if code:
        say(f"Not all runs ended: {command('study', 'status', path, '--results', store.root)}", aside=True)
        return code
    found = [promoting.gains(winner, planned, store) for winner in winners]
    ends = [(cell.condition, store.status(cell.run_id).name) for cell in planned.cells]
    diverged = {arm: ends.count((arm, "diverged")) for arm in planned.conditions}
    if json:
        objectives = [{name: asdict(own) for name, own in gains.items()} for gains in found]
        print_json(
            {
                "schema": 1,
                "study": str(path),
                "seeds": list(planned.seeds),
                "run_ids": {
                    arm: [cell.run_id for cell in planned.cells if cell.condition == arm] for arm in diverged
                },
                "diverged": diverged,
                "winners": [
                    {**own, "objectives": gains} for own, gains in zip(chosen, objectives, strict=True)
                ],
            }
        )
        return 0
    for winner, gains in zip(winners, found, strict=True):
        _tell(winner, gains, len(planned.seeds))
    for arm, count in diverged.items():
        if count:
            print(f"{count} of {arm}'s {len(planned.seeds)} runs diverged, and count as in a search")
    return 0


def recorded(store: Store, name: str, world: str | None) -> Searched:
    """Return the search that a person names, as it was recorded."""
    from pneuma.search.storage import read_record
    from pneuma.worlds import check_world

    check_world(world)
    return read_record(store, in_world(Path(name).stem if name.endswith(".toml") else name, world or TEXT))


def _refuse_untrusted(winner: Winner, name: str, world: str | None) -> None:
    """Refuse what an untrusted record would run or read, unless the search's own file says the same."""
    from pneuma.search.spec import load_search
    from pneuma.study.trust import own_things

    space = winner.searched.task.search.space
    for settings in (space.fixed, winner.trial.settings):
        for deed in own_things(settings).values():
            try:
                same = load_search(name, world).space == space
            except UserError:
                same = False
            if not same:
                raise UserError(
                    f"the record of {winner.searched.task.search.name} would {deed}: name the search's file, "
                    "with the space that was searched"
                )


def _write_new(out: Path, text: bytes) -> None:
    if out.suffix != ".toml":
        raise UserError(f"--out {out}: must end in .toml, as study files do")
    check_file(out, (".toml",))
    if out.exists():
        raise UserError(f"--out {out}: is there already; name another, or remove it first")
    write_file(out, text)


def _study_name(searches: Sequence[Searched]) -> str:
    """Return what the study of winners is called; the end of a name tells a study's world."""
    split = [split_world(searched.task.search.name) for searched in searches]
    there = [] if split[0][1] == TEXT else [split[0][1]]
    return "-".join(["promoted", *there, *(name for name, _ in split)])


def _tell(winner: Winner, gains: Mapping[str, Gain], seeds: int) -> None:
    search = winner.searched.task.search
    print(f"Trial {winner.trial.number} of search {search.name} on {seeds} fresh seeds:")
    for objective in search.objectives:
        own = gains[objective.name]
        low, high = own.interval
        print(f"  {objective.over_seeds} over seeds of {plain(objective.outcome)}:")
        print(f"    in the search       {own.seen:.4f}   (base: {_told(own.seen_baseline)})")
        print(f"    on fresh seeds      {own.fresh:.4f}   (base: {_told(own.fresh_baseline)})")
        interval = f"95 % interval {low:+.4f} to {high:+.4f}" if math.isfinite(low) else "no interval"
        print(f"    difference of means {own.difference:+.4f} ({interval})")
        print(
            f"    luck                {own.luck:+.4f}: by how much the search's seeds had flattered it"
            if math.isfinite(own.luck)
            else f"    luck                cannot be told: {own.incomparable}"
        )


def _told(value: float) -> Any:
    return f"{value:.4f}" if math.isfinite(value) else "no value"
