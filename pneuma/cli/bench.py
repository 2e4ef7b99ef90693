"""`pneuma bench …`: how fast the environment and the engines are on this machine."""

from __future__ import annotations

import typer

from pneuma.cli.options import Json, print_json

app = typer.Typer(help="Measure speed on this machine.", no_args_is_help=True, rich_markup_mode=None)


@app.command()
def env(json: Json = False) -> None:
    """Measure the environment's faces in agent steps a second, saving and starting, on one core."""
    from pneuma.bench.env import bench_env

    report = bench_env()
    if json:
        return print_json({"schema": 1, **report})
    for case in report["cases"]:
        print(
            f"{case['case']:<28} {case['worlds']:>4} worlds {case['agent_steps_per_second']:>12,.0f} steps/s"
        )
    print(f"{'saving and restoring':<40} {report['save_and_restore_microseconds']:>12.1f} µs")
    for what, key in (
        ("import pneuma", "import_seconds"),
        ("first step, empty compile cache", "first_step_cold_seconds"),
        ("first step, warm compile cache", "first_step_warm_seconds"),
    ):
        print(f"{what:<40} {report[key]:>12.2f} s")
    return None


@app.command()
def engines(json: Json = False) -> None:
    """Compare an engine's time per step with Stable-Baselines3 alone, on worlds that cost nothing."""
    from pneuma.bench.engines import bench_engines

    report = bench_engines()
    if json:
        return print_json({"schema": 1, **report})
    for case in report["cases"]:
        print(f"{case['case']:<28} {case['engine']:<20} {case['steps_per_second']:>10,.0f} steps/s")
    for case, ratio in report["ratios"].items():
        print(f"{case}: sb3 over Stable-Baselines3 alone, time per step, median of pairs: {ratio:.3f}")
    return None
