"""`pneuma study collapse`: which runs of a study collapsed, and forks from before."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, rows_of
from pneuma.cli.study_run import train
from pneuma.errors import UserError, counted
from pneuma.study.fork import plan_cause_forks

if TYPE_CHECKING:
    import pandas as pd

FORK_SEEDS = 3


def collapse(
    name: opt.Study,
    picked: opt.StoredFilter,
    fork: Annotated[bool, opt.flag("--fork", "Go on from before each collapse, one thing changed.")] = False,
    fork_seeds: Annotated[Any, opt.seeds("With --fork: seeds of each run's forks (default: 3).")] = None,
    workers: opt.Workers = None,
    trust: opt.Trust = False,
    quiet: opt.Quiet = False,
) -> Result:
    """Say which runs collapsed, when, by which signs, and how often in each condition."""
    of_fork = {"--fork-seeds": fork_seeds, "--workers": workers, "--trust": trust, "--quiet": quiet}
    if not fork and (given := [option for option, value in of_fork.items() if value]):
        raise UserError(f"{given[0]} requires --fork")
    data = picked.open(name)
    from pneuma.analysis.collapse import diagnoses, incidence

    found = diagnoses(data)
    shares = incidence(data, found)
    collapsed = found[found["collapsed"]]
    if fork:
        here = {run.run_id for run in data.rows if not run.published}
        collapsed = collapsed[collapsed["run_id"].isin(here)]
        parents = dict(zip(collapsed["run_id"], map(int, collapsed["last_healthy_step"]), strict=True))
        if not parents:
            runs = counted(len(here), "run")
            raise UserError(
                f"study {data.study.name}: none of its {runs} here collapsed: there is nothing to fork"
            )
        plan = plan_cause_forks(
            picked.store, data.study.name, parents, fork_seeds or range(FORK_SEEDS), trust=trust
        )
        return train(plan, picked.store, opt.Place(workers).config(), True, quiet)
    document = {**data.about, "runs": found, "incidence": shares}
    return Result(document, [*_collapse_tables(collapsed, shares)])


def _collapse_tables(collapsed: pd.DataFrame, shares: pd.DataFrame) -> Iterator[str | Table]:
    rows: list[tuple[object, ...]] = []
    for row in rows_of(collapsed):
        about = (row[key] for key in ("condition", "seed", "run_id"))
        rows.append((*about, f"{row['onset_step']:,}", row["signs"]))
    if rows:
        yield Table(("condition", "seed", "run", "step", "signs"), rows)
        yield ""
    rows = []
    for row in rows_of(shares):
        interval = f"{row['low']:.0%} to {row['high']:.0%}" if row["runs"] else "–"
        rows.append((row["condition"], f"{row['collapsed']} of {row['runs']}", interval, row["unknown"]))
    yield Table(("condition", "collapsed", "95 % interval", "without a sign recorded"), rows)
