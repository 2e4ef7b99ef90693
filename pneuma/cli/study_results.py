"""`pneuma study collapse`: which runs of a study collapsed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, rows_of

if TYPE_CHECKING:
    import pandas as pd


def collapse(name: opt.Study, picked: opt.RunFilter) -> Result:
    """Say which runs collapsed, when, by which signs, and how often in each condition."""
    data = picked.open(name)
    from pneuma.analysis.collapse import diagnoses, incidence

    found = diagnoses(data)
    shares = incidence(data, found)
    collapsed = found[found["collapsed"]]
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
