"""`pneuma study compare`: two conditions beside each other."""

from __future__ import annotations

import math
from typing import Annotated, Any

import typer

from pneuma.cli import options as opt
from pneuma.cli.output import print_json, print_table, records
from pneuma.cli.study_records import open_data
from pneuma.cli.study_summary import tell_step
from pneuma.errors import plain
from pneuma.study.store import Store


@opt.grouped
def compare(
    name: opt.StudyName,
    a: Annotated[str, typer.Argument(metavar="A", help="A condition.", show_default=False)],
    b: Annotated[str, typer.Argument(metavar="B", help="The condition that A is held against.")],
    outcome: Annotated[
        opt.Several,
        opt.option("--outcome", "NAME", "One of docs/outcomes.md, instead of the usual (repeatable)."),
    ] = None,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Compare two conditions: the difference of their means, and how likely a run of A is better."""
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.summaries import compare_conditions

    table = compare_conditions(data, a, b, outcome) if outcome else compare_conditions(data, a, b)
    if json:
        return print_json({"schema": 1, "study": data.study, "comparisons": records(table)})
    print(plain(f"{data.title}: {a} against {b}"))
    tell_step(data)
    print()
    print_table(
        ("outcome", plain(a), plain(b), f"{plain(a)} - {plain(b)}", "P(better)", "runs", "no value"),
        (_row(row) for row in table.to_dict("records")),
    )
    print("\nMeans, and their difference with a 95 % interval (Welch). P(better): how likely a run of the")
    print("first is better than one of the second. no value: runs that have none and are left out.")
    return None


def _row(row: dict[Any, Any]) -> tuple[object, ...]:
    from pneuma.analysis.intervals import decimals, shown, shown_with_interval

    places = decimals(row["difference"], row["low"], row["high"])
    return (
        f"{row['outcome']} ({row['unit']})" if row["unit"] else row["outcome"],
        shown(row["mean_a"], places),
        shown(row["mean_b"], places),
        shown_with_interval(row["difference"], row["low"], row["high"]),
        "–" if math.isnan(row["p_better"]) else f"{row['p_better']:.2f}",
        f"{row['seeds_a']} and {row['seeds_b']}",
        row["without_value"],
    )
