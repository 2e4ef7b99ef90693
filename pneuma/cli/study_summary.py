"""`pneuma study summary`, `collapse`, `effects` and `robustness`: what a study's runs come to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import command, print_json, print_table, read_formats, records, say, tell_written
from pneuma.cli.study_records import open_data
from pneuma.cli.study_run import train
from pneuma.errors import UserError, counted, plain
from pneuma.study.executors.base import Supervision
from pneuma.study.fork import plan_cause_forks
from pneuma.study.store import Store
from pneuma.values import shown_level, shown_value

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.crossed import Effects, Map
    from pneuma.analysis.frames import StudyData

PRIMARY = "final-share-killed"
FORK_SEEDS = "3"
COLUMNS = 3
"""Outcomes in the table that is printed unless more is asked for."""


# --- summary --------------------------------------------------------------------------------------


@opt.grouped
def summary(
    name: opt.StudyName,
    outcome: Annotated[
        opt.Several,
        opt.option("--outcome", "NAME", "One of docs/outcomes.md, instead of the usual (repeatable)."),
    ] = None,
    all_: Annotated[
        bool, opt.flag("--all", "Print every statistic of all usual outcomes, not three means.")
    ] = False,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Say what each condition's runs come to: means with 95 % intervals, spread, thresholds, failures."""
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.frames import common_step
    from pneuma.analysis.summaries import summary_table

    table = summary_table(data, outcome) if outcome else summary_table(data)
    if json:
        step = common_step(data)
        left_out = [run.run_id for run in data.runs if run.ends_before(step)]
        document = {"schema": 1, "study": data.study, "at_step": step, "left_out": left_out}
        return print_json({**document, "summary": records(table)})
    print(plain(data.title))
    tell_step(data)
    if outcome or all_:
        _print_statistics(data, table, outcome or ())
    else:
        _print_means(data, table)
    return None


def tell_step(data: StudyData) -> None:
    """Say at what step runs of unlike budgets are compared."""
    from pneuma.analysis.frames import common_step, step_words

    if step := common_step(data):
        print(f"Budgets are unlike: all as they stood at {step:,} steps, {plain(step_words(data))}.")


Cells = dict[tuple[str, str, str], str]
"""A summary's numbers with their intervals, by condition, outcome and statistic."""


def _cells(table: pd.DataFrame) -> Cells:
    from pneuma.analysis.intervals import shown_with_interval

    return {
        (row["condition"], row["outcome"], row["statistic"]): shown_with_interval(
            row["value"], row["low"], row["high"]
        )
        for row in table.to_dict("records")
    }


def _print_means(data: StudyData, table: pd.DataFrame) -> None:
    """Print a line for each condition: the means of the first outcomes that any has, and its failures."""
    from pneuma.analysis.outcomes import find_outcome

    names = list(dict.fromkeys(table["outcome"][table["statistic"] == "mean"]))[:COLUMNS]
    units = [find_outcome(name).unit for name in names]
    heads = [f"{name} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)]
    pairs = [*((name, "mean") for name in names), ("collapsed", "share"), ("diverged", "share")]
    cells = _cells(table)
    print()
    print_table(
        ("condition", "runs", *heads, "collapsed", "diverged"),
        [
            (name, len(data.of_condition(name)), *(cells.get((name, *pair), "–") for pair in pairs))
            for name in data.conditions
        ],
    )
    print("\nMeans, and shares of runs, with 95 % intervals. Medians, spread and other outcomes: --all.")


def _print_statistics(data: StudyData, table: pd.DataFrame, asked: Sequence[str]) -> None:
    """Print a line for each outcome and condition, and why those that were asked for have no value."""
    cells, statistics = _cells(table), list(dict.fromkeys(table["statistic"]))
    runs = dict(zip(zip(table["outcome"], table["condition"], strict=True), table["runs"], strict=True))
    print()
    print_table(
        ("outcome", "condition", "n", *statistics),
        [
            (outcome, name, count, *(cells.get((name, outcome, each), "–") for each in statistics))
            for (outcome, name), count in runs.items()
        ],
    )
    for outcome in asked:
        for name in data.conditions:
            if (outcome, name) not in runs:
                print(f"{plain(outcome)}, {plain(name)}: {_lack(data, name, outcome)}")


def _lack(data: StudyData, condition: str, outcome: str) -> str:
    """Say why no run of a condition has a value."""
    from pneuma.analysis.frames import common_step
    from pneuma.analysis.outcomes import reason

    runs = data.of_condition(condition)
    return reason(data, runs[0], outcome, common_step(data)) if runs else "no run has finished"


# --- collapse -------------------------------------------------------------------------------------


@opt.grouped
def collapse(
    name: opt.StudyName,
    fork: Annotated[
        bool, opt.flag("--fork", "Go on from before each collapse, changing one thing at a time.")
    ] = False,
    run: Annotated[
        opt.Several, opt.option("--run", "RUN_ID", "Fork this collapsed run alone (may be repeated).")
    ] = None,
    fork_seeds: Annotated[
        str, opt.option("--fork-seeds", "N|LIST", "Seeds of the forks of each run.")
    ] = FORK_SEEDS,
    out: opt.FigureFolder = None,
    format: opt.Formats = None,
    workers: opt.Workers = None,
    trust: opt.Trust = False,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> int:
    """Say which runs collapsed, when, by which signs, and how often in each condition."""
    formats = read_formats(format, out)
    if fork and out is not None:
        raise UserError("--out: does not go with --fork; `pneuma study plot` draws the forks")
    of_forks = {"run": run, "fork-seeds": fork_seeds != FORK_SEEDS, "workers": workers, "trust": trust}
    if idle := next((option for option, given in of_forks.items() if given and not fork), None):
        raise UserError(f"--{idle}: goes with --fork alone")
    store = Store(results)
    data = open_data(store, name, selection, world, published=not fork)
    from pneuma.analysis.collapse import diagnoses, incidence

    found, shares = diagnoses(data), incidence(data)
    collapsed = found[found["collapsed"]]
    if fork:
        parents = _parents(data, collapsed, run or ())
        plan = plan_cause_forks(store, data.study, parents, opt.read_seeds_option(fork_seeds), trust=trust)
        plan = replace(plan, notes=tuple(map(plain, plan.notes)))
        how = Supervision(workers=opt.read_workers(workers))
        return train(plan, store, how, retry_failed=True, json=json, quiet=quiet)
    files = []
    if out is not None:
        from pneuma.figures.collapse import draw_collapse
        from pneuma.figures.panels import stem_of

        files = draw_collapse(data, out, stem_of(data, "collapse"), formats)
    if json:
        document = {"schema": 1, "study": data.study, "runs": records(found)}
        print_json({**document, "incidence": records(shares), "figures": list(map(str, files))})
        return 0
    _print_collapses(collapsed, shares)
    if any(store.has_checkpoints(run_id) for run_id in collapsed["run_id"]):
        again = command("study", "collapse", data.study, "--fork", "--results", store.root)
        say(f"To show the cause: {again}", quiet=quiet)
    tell_written(files)
    return 0


def _parents(data: StudyData, collapsed: pd.DataFrame, wanted: Sequence[str]) -> dict[str, int]:
    """Return the collapsed runs that are to be forked, and before what step."""
    steps = dict(zip(collapsed["run_id"], map(int, collapsed["sound_step"]), strict=True))
    if not steps:
        raise UserError(
            f"study {data.study}: none of its {len(data.runs)} runs collapsed, so there is nothing to fork"
        )
    for prefix in wanted:
        if sum(run_id.startswith(prefix) for run_id in steps) != 1 or len(prefix) < 4:
            known = ", ".join(run_id[:8] for run_id in steps)
            raise UserError(f"--run {prefix}: is no collapsed run of study {data.study}; there are {known}")
    return {run_id: step for run_id, step in steps.items() if run_id.startswith(tuple(wanted) or "")}


def _print_collapses(collapsed: pd.DataFrame, shares: pd.DataFrame) -> None:
    """Print the runs that collapsed, and the share of each condition's that did."""
    rows: list[Sequence[object]] = []
    for row in records(collapsed):
        again = f"{row['recovered_step']:,}" if row["recovered_step"] else "never"
        again += " and relearned" * bool(row["relearned"])
        onset = f"{row['onset_step']:,}"
        rows.append((row["condition"], row["seed"], row["run_id"], onset, row["signs"], again))
    if rows:
        print_table(("condition", "seed", "run", "step", "signs", "recovered at step"), rows)
        print()
    rows = []
    for row in records(shares):
        interval = f"{row['low']:.0%} to {row['high']:.0%}" if row["runs"] else "–"
        unknown = f"of {counted(row['unknown'], 'run')} no sign is recorded" if row["unknown"] else ""
        rows.append((row["condition"], f"{row['collapsed']} of {row['runs']} runs", interval, unknown))
    print_table(("condition", "collapsed", "95 % interval", ""), rows)


# --- effects --------------------------------------------------------------------------------------


@opt.grouped
def effects(
    name: opt.StudyName,
    outcome: opt.Outcome = PRIMARY,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Test the main effects and two-way interactions of a crossed study's factors."""
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.crossed import effects_table, study_effects
    from pneuma.analysis.frames import common_step

    found = study_effects(data, outcome)
    table = effects_table(found)
    if not json:
        _print_effects(found, table)
        return tell_step(data)
    rows = [
        {**row, "factors": list(own.factors), "levels": [len(found.means[factor]) for factor in own.factors]}
        for row, own in zip(records(table), found.effects, strict=True)
    ]
    document = {"schema": 1, "study": found.study, "outcome": found.outcome, "cells": found.cells}
    runs = {"runs": found.runs, "runs_without_outcome": found.without, "means": found.means}
    return print_json({**document, **runs, "effects": rows, "at_step": common_step(data)})


def _print_effects(found: Effects, table: pd.DataFrame) -> None:
    from pneuma.analysis.intervals import decimals, shown
    from pneuma.analysis.outcomes import find_outcome

    outcome = find_outcome(found.outcome)
    unit = f" ({outcome.unit})" if outcome.unit else ""
    without = f", and {found.without} without it left out" if found.without else ""
    print(f"{plain(found.title)}: {outcome.words}{unit}, {found.runs} runs in {found.cells} cells{without}\n")
    rows = []
    for row in table.to_dict("records"):
        f = "endless" if row["f"] == float("inf") else shown(row["f"], 2)
        tested = f, shown(row["partial_r2"], 3), f"{row['p']:.4f}", f"{row['p_holm']:.4f}"
        rows.append((row["effect"], row["levels"], f"{row['df']}, {row['df_error']}", *tested))
    print_table(("effect", "levels", "df", "F", "partial R²", "p", "p (Holm)"), rows)
    print(f"\nMeans{unit}, each cell counted alike:")
    for factor, means in found.means.items():
        told = ";  ".join(f"{level} {shown(value, decimals(value))}" for level, value in means.items())
        print(f"  {plain(factor)}: {plain(told)}")
    print("\nPartial R²: share of the variance that the other effects leave. Holm: over this table.")


# --- robustness -----------------------------------------------------------------------------------


@opt.grouped
def robustness(
    name: opt.StudyName,
    contrast: Annotated[
        str,
        opt.option(
            "--contrast",
            "KEY=A:B",
            "A field, its value said to be better, another: activation=tanh:relu.",
        ),
    ],
    outcome: opt.Outcome = PRIMARY,
    out: opt.FigureFolder = None,
    format: opt.Formats = None,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Compare two values of a field in every combination of a study's other factors."""
    formats = read_formats(format, out)
    setting, better, worse = _read_contrast(contrast)
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.crossed import map_table, robustness_map
    from pneuma.analysis.frames import common_step
    from pneuma.analysis.outcomes import find_outcome

    found = robustness_map(data, setting, better, worse, outcome)
    files = []
    if out is not None:
        from pneuma.figures.maps import draw_robustness
        from pneuma.figures.panels import stem_of

        parts = [found.setting, *map(shown_value, found.values), *[outcome] * (outcome != PRIMARY)]
        files = draw_robustness(data, [found], out, stem_of(data, *parts), formats)
    turned = find_outcome(outcome).better == "lower"
    if not json:
        _print_map(found, turned)
        tell_step(data)
        return tell_written(files)
    values = {"setting": found.setting, "better": found.values[0], "worse": found.values[1]}
    document = {"schema": 1, "study": found.study, "contrast": values, "outcome": found.outcome}
    told: dict[str, Any] = {"label": found.label, "turned": turned, "at_step": common_step(data)}
    return print_json(
        {**document, **told, "cells": records(map_table(found)), "figures": list(map(str, files))}
    )


def _read_contrast(text: str) -> tuple[str, Any, Any]:
    """Read KEY=A:B, where either value may have colons of its own, as many as the other."""
    key, _, values = (part.strip() for part in text.partition("="))
    parts = values.split(":")
    pair = [":".join(own).strip() for own in (parts[: len(parts) // 2], parts[len(parts) // 2 :])]
    if not (key and all(pair)) or len(parts) % 2:
        raise UserError(f"--contrast {text}: must be KEY=A:B, as in activation=tanh:relu")
    better, worse = (opt.read_settings_options([f"{key}={value}"])[key] for value in pair)
    return key, better, worse


def _print_map(found: Map, turned: bool) -> None:
    from pneuma.analysis.intervals import shown_with_interval
    from pneuma.analysis.outcomes import find_outcome

    better, worse = map(shown_value, found.values)
    outcome = found.outcome + (" (turned, as less is better)" if turned else "")
    print(f"{plain(found.title)}: {found.setting} {better} against {worse}, {outcome}: {found.label}")
    unit = find_outcome(found.outcome).unit
    rows = []
    for cell in found.cells:
        levels = ", ".join(f"{key} {shown_level(level)}" for key, level in cell.levels) or cell.better
        interval = cell.contrast.interval
        effect = shown_with_interval(cell.contrast.effect, interval.low, interval.high)
        rows.append((levels, effect, f"{cell.p:.3f}", cell.label))
    print_table(("cell", f"difference{f' ({unit})' if unit else ''}", "p (Holm)", ""), rows)
    print("Intervals are each for itself; p and the label are Holm-corrected over the map.")
