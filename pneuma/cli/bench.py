"""`pneuma bench …`: how fast environment and engines are on this machine, and how far to trust verdicts."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.cli.options import (
    Conditions,
    Json,
    Results,
    Seeds,
    Steps,
    print_json,
    read_count,
    read_selection,
    say,
)
from pneuma.study.store import Store

app = typer.Typer(
    help="Measure speed on this machine, and calibrate the statistics.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@app.command(short_help="Measure the environment in agent steps a second.")
def env(json: Json = False) -> None:
    """Measure the environment's faces in agent steps a second, and starting, on one core."""
    from pneuma.bench.env import bench_env

    report = bench_env()
    if json:
        return print_json({"schema": 1, **report})
    for case in report["cases"]:
        print(
            f"{case['case']:<28} {case['worlds']:>4} worlds {case['agent_steps_per_second']:>12,.0f} steps/s"
        )
    print(f"{'import pneuma':<40} {report['import_seconds']:>12.2f} s")
    for cache in ("cold", "warm"):
        seconds = report[f"first_step_{cache}_seconds"]
        print(f"{f'first step, {cache} compile cache':<40} {seconds:>12.2f} s")
    return None


@app.command(short_help="Test whether both engines come to the same.")
def equivalence(
    study: Annotated[
        str, typer.Argument(metavar="STUDY", help="A study run by both engines.")
    ] = "activation",
    preset: Annotated[
        str | None, typer.Option("--preset", metavar="NAME", help="A preset's seeds and steps (else quick).")
    ] = None,
    seeds: Seeds = None,
    steps: Steps = None,
    condition: Conditions = None,
    results: Results = Path("results"),
    json: Json = False,
) -> None:
    """Test whether both engines come to the same results on a study that was run with each."""
    from pneuma.bench.equivalence import compare_engines
    from pneuma.study.plan import Selection

    selection = read_selection(preset, seeds, steps, None, condition, None) or Selection()
    report = compare_engines(Store(results), study, selection)
    if json:
        return print_json({"schema": 1, **report})
    print(f"{report['study']}: {report['seeds']} seeds by each engine, {report['steps']:,} steps a run")
    for row in report["rows"]:
        low, high = row["interval"]
        means = ", ".join(f"{engine} {mean:.4f}" for engine, mean in row["means"].items())
        print(f"{row['condition']}, {row['outcome']}: {means}")
        print(f"    difference {row['difference']:+.4f} (95 % interval {low:+.4f} to {high:+.4f})")
        print(f"    within half a monster: p = {row['p_equivalent']:.2g}")
        different = (
            f"p = {row['p_different']:.2f}, {row['p_different_corrected']:.2f} after Holm's correction"
        )
        print(f"    different at all: {different}")
        ratio = f"{row['deviation_ratio']:.2f} (p = {row['p_spread_different']:.2f})"
        print(f"    ratio of standard deviations {ratio}")
    return None


@app.command(short_help="Compare the engines in steps a second.")
def engines(json: Json = False) -> None:
    """Compare the engines in steps a second on one core; takes about two minutes."""
    from pneuma.bench.engines import WORKERS, bench_engines
    from pneuma.bench.reference import bench_reference

    report = {**bench_engines(), "reference_overhead": bench_reference()["ratios"]}
    if json:
        return print_json({"schema": 1, **report})
    for case in report["cases"]:
        print(f"{case['case']:<28} {case['engine']:<20} {case['steps_per_second']:>10,.0f} steps/s")
    for case, ratio in report["ratios"].items():
        compared = "" if case == WORKERS else ": batched over sb3"
        print(f"{case}{compared}, median of rounds: {ratio:.2f}")
    for case, ratio in report["reference_overhead"].items():
        print(f"{case}: sb3 over Stable-Baselines3 alone, time per step: {ratio:.3f}")
    print(f"peak memory of both engines: {report['peak_megabytes']:.0f} MB")
    return None


@app.command(short_help="Measure each command on thousands of runs.")
def scaling(
    runs: Annotated[
        str, typer.Option("--runs", metavar="N", help="Runs of the study, drawn and not trained.")
    ] = "10_000",
    conditions: Annotated[
        str, typer.Option("--conditions", metavar="N", help="Conditions that share them.")
    ] = "8",
    steps: Annotated[
        str, typer.Option("--steps", metavar="N", help="Steps that each has records of.")
    ] = "51_200",
    folder: Annotated[
        Path | None,
        typer.Option("--folder", exists=True, file_okay=False, help="Where the runs lie meanwhile."),
    ] = None,
    json: Json = False,
) -> None:
    """Store a study of thousands of runs, and measure each command on it: time, and memory at its peak."""
    from pneuma.bench.scaling import bench_scaling

    sizes = (read_count("--runs", runs), read_count("--conditions", conditions), read_count("--steps", steps))
    rows = []
    for row in bench_scaling(*sizes, folder):
        rows.append(row)
        memory = f"{row['peak_megabytes']:>8,.0f} MB"
        say(f"{row['case']:<28} {row['seconds']:>8.1f} s {memory} at the peak", aside=json)
    stored = rows[0]
    size, rate = f"{stored['megabytes']:,.0f} MB", f"{stored['runs_per_second']:.0f} a second"
    say(f"{stored['runs']:,} runs of {size} in all, stored {rate}", aside=json)
    return print_json({"schema": 1, "cases": rows}) if json else None


@app.command(short_help="Simulate lists of claims whose truth is known.")
def calibration(
    lists: Annotated[
        str,
        typer.Option("--lists", metavar="N", help="How many lists of claims to simulate in each setting."),
    ] = "2000",
    json: Json = False,
) -> None:
    """Simulate lists of claims whose truth is known; say how often a verdict or an interval is wrong."""
    from pneuma.bench.calibration import bench_calibration

    tables: dict[str, list[dict[str, Any]]] = {"coverage": [], "false_verdicts": []}
    for table, row in bench_calibration(read_count("--lists", lists)):
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
