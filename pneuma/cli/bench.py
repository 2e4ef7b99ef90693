"""`pneuma bench …`: how fast environment and engines are on this machine, and how far to trust verdicts."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from pneuma.cli import options as opt
from pneuma.cli.output import print_json, say

app = typer.Typer(
    help="Measure speed on this machine, and calibrate the statistics.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command(short_help="Measure the environment in agent steps a second.")
def env(json: opt.Json = False) -> None:
    """Measure the environment's faces in agent steps a second, on one core."""
    from pneuma.bench.env import bench_env

    cases = bench_env()
    if json:
        return print_json({"schema": 1, "cases": cases})
    for case in cases:
        print(
            f"{case['case']:<28} {case['worlds']:>4} worlds {case['agent_steps_per_second']:>12,.0f} steps/s"
        )
    return None


@app.command(short_help="Compare the engines in steps a second.")
def engines(json: opt.Json = False) -> None:
    """Compare the engines in steps a second on one core; takes about two minutes."""
    from pneuma.bench.engines import bench_engines

    report = bench_engines()
    if json:
        return print_json({"schema": 1, **report})
    for case in report["cases"]:
        print(f"{case['case']:<28} {case['engine']:<20} {case['steps_per_second']:>10,.0f} steps/s")
    for case, ratio in report["ratios"].items():
        print(f"{case}: batched over sb3, median of rounds: {ratio:.2f}")
    return None


@app.command(short_help="Simulate lists of claims whose truth is known.")
def calibration(
    lists: Annotated[
        str, opt.option("--lists", "N", "How many lists of claims to simulate in each setting.")
    ] = "2000",
    json: opt.Json = False,
) -> None:
    """Simulate lists of claims whose truth is known; say how often a verdict or an interval is wrong."""
    from pneuma.bench.calibration import bench_calibration

    tables: dict[str, list[dict[str, Any]]] = {"coverage": [], "false_verdicts": []}
    for table, row in bench_calibration(opt.read_count("--lists", lists)):
        tables[table].append(row)
        say(_told(table, row), aside=json)
    return print_json({"schema": 1, **tables}) if json else None


def _told(table: str, row: dict[str, Any]) -> str:
    if table == "coverage":
        covers = f"{row['method']:<16} {row['distribution']:<14} {row['seeds']:>8} seeds"
        return f"{covers}  covers {row['coverage']:.3f}"
    setting = f"{row['truth']:<28} {row['distribution']:<14} {row['seeds']:>8} seeds"
    rate, bound = f"{row['false_rate']:.4f}", f"{row['upper_bound']:.4f}"
    return f"{setting}  false in {rate} of {row['lists']} lists, at most {bound}"
