"""`pneuma study summary`, `compare`, `collapse`, `effects` and `robustness`: results of a study."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import complete
from pneuma.cli import options as opt
from pneuma.cli.output import (
    draw_files,
    print_json,
    print_table,
    read_formats,
    rows_of,
    say,
    tell_written,
)
from pneuma.cli.study_records import open_data
from pneuma.cli.study_run import train
from pneuma.errors import UserError, counted, nearest_name
from pneuma.study.executors.base import Supervision
from pneuma.study.fork import plan_cause_forks
from pneuma.study.spec import list_studies
from pneuma.study.store import Store
from pneuma.values import shown_level, shown_value

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

COLUMNS = 3
"""Outcomes that `summary` prints by default."""


def _tell_step(data: StudyData) -> None:
    from pneuma.analysis.frames import common_step, step_words

    if step := common_step(data):
        say(f"Budgets differ: all values are those at step {step:,}, {step_words(data)}.")


FEW_EPISODES = 10
"""With fewer, the last point of a return is said to average few."""


def _tell_episodes(data: StudyData, outcomes: Iterable[str]) -> None:
    """Say how many runs' last returns average few episodes."""
    counts = sorted(run.row.last_episodes for run in data.runs if 0 < run.row.last_episodes < FEW_EPISODES)
    if counts and "final-return" in outcomes:
        between = f"{counts[0]:.0f} to {counts[-1]:.0f}" if counts[0] < counts[-1] else f"{counts[0]:.0f}"
        say(f"final-return of {counted(len(counts), 'run')} is a mean of few episodes: {between}.")


def _with_unit(outcome: str) -> str:
    from pneuma.analysis.outcomes import find_outcome

    unit = "" if outcome == "diverged" else find_outcome(outcome).unit  # a run's status
    return f"{outcome} ({unit})" if unit else outcome


# --- summary --------------------------------------------------------------------------------------


@opt.grouped
def summary(
    name: opt.StudyName,
    picked: opt.Chosen,
    outcome: opt.Outcomes = None,
    all_: Annotated[bool, opt.flag("--all", "Tell all statistics of the usual outcomes.")] = False,
    json: opt.Json = False,
) -> None:
    """Summarize each condition: means with 95 % intervals; with --outcome, all statistics."""
    data = open_data(picked, name)
    from pneuma.analysis.frames import common_step
    from pneuma.analysis.intervals import shown_with_interval
    from pneuma.analysis.summaries import summary_table

    table = summary_table(data, outcome or ())
    if json:
        step = common_step(data)
        left_out = [run.run_id for run in data.runs if run.ends_before(step)]
        return print_json({"study": data.study, "at_step": step, "left_out": left_out, "summary": table})
    say(data.full_title)
    _tell_step(data)
    print()
    cells = {
        (row["condition"], row["outcome"], row["statistic"]): shown_with_interval(
            row["value"], row["low"], row["high"]
        )
        for row in table.to_dict("records")
    }
    measured = list(dict.fromkeys(table["outcome"][table["statistic"] == "mean"]))
    every = [name for name in dict.fromkeys(table["outcome"]) if name != "runs"]
    if outcomes_shown := every if all_ else outcome:
        statistics = list(dict.fromkeys(statistic for _, name, statistic in cells if name in outcomes_shown))
        heads = ["outcome", "condition", "n", *statistics]
        runs = table.groupby(["outcome", "condition"])["runs"].first()
        rows: list[tuple[object, ...]] = []
        for name, condition in product(outcomes_shown, data.conditions):
            if (name, condition) in runs:
                shown = (cells.get((condition, name, each), "–") for each in statistics)
                rows.append((_with_unit(name), condition, runs[name, condition], *shown))
        print_table(heads, rows)
        for name, condition in product(outcome or (), data.conditions):
            if (name, condition) not in runs:
                say(f"{name}, {condition}: {_lack(data, condition, name)}")
        return _tell_episodes(data, outcomes_shown)
    names = measured[:COLUMNS]
    shares = ("collapsed", "diverged")
    pairs = [*((name, "mean") for name in names), *((name, "share") for name in shares)]
    rows = []
    for condition in data.conditions:
        shown = (cells.get((condition, *pair), "–") for pair in pairs)
        rows.append((condition, len(data.of_condition(condition)), *shown))
    print_table(("condition", "runs", *map(_with_unit, names), *shares), rows)
    lacking = " –: no run has it." * any("–" in row for row in rows)
    return print(
        f"\nMeans, and shares of runs, with 95 % intervals.{lacking} More: --outcome NAME, or --all."
    )


def _lack(data: StudyData, condition: str, outcome: str) -> str:
    """Return why no run of a condition has a value."""
    from pneuma.analysis.frames import common_step
    from pneuma.analysis.outcomes import reason

    runs = data.of_condition(condition)
    return reason(data, runs[0], outcome, common_step(data)) if runs else "no run has finished"


# --- compare --------------------------------------------------------------------------------------


@opt.grouped
def compare(
    name: opt.StudyName,
    a: Annotated[
        str, opt.argument("A", "A condition; or, alone, another study or a variant.", complete.conditions)
    ],
    picked: opt.Chosen,
    b: Annotated[
        str | None, opt.argument("B", "The condition that A is compared with.", complete.conditions)
    ] = None,
    outcome: opt.Outcomes = None,
    plot: Annotated[bool, opt.flag("--plot", "Draw the differences too.")] = False,
    out: opt.PlotFolder = None,
    format: opt.Formats = None,
    json: opt.Json = False,
) -> None:
    """Compare two conditions: the difference of their means, and how likely a run of A is better.

    Without B, each condition of NAME is compared with that of the same name of the study or variant A.
    """
    formats = read_formats(format, out, "" if plot else "--plot")
    selected = replace(picked.selection, conditions=(a, b) if b else picked.selection.conditions)
    data, heads = open_data(replace(picked, selection=selected), name), [a, b or ""]
    pairs = {"": (a, b or "")}
    if b is None:
        from pneuma.analysis.frames import join_studies

        if others := [condition for condition in data.conditions if condition != a and a in data.conditions]:
            raise UserError(
                f"{a} is a condition of {name}: name the one to compare it with, such as {others[-1]}"
            )
        if (hint := nearest_name(a, data.conditions)) and not _is_study(picked.store, a):
            raise UserError(f"{a} is neither a condition of {name}{hint} nor a study")
        other = open_data(replace(picked, selection=replace(selected, conditions=(), settings=None)), a)
        heads = [data.study, other.study]
        data, pairs = join_studies(data, other)
        if not pairs:
            raise UserError(f"{name} and {a} have no condition of one name to compare; name two conditions")
    import pandas as pd

    from pneuma.analysis.frames import figure_basename
    from pneuma.analysis.intervals import decimals, shown, shown_with_interval
    from pneuma.analysis.summaries import compare_conditions

    tables = {condition: compare_conditions(data, *pair, outcome or ()) for condition, pair in pairs.items()}
    table = pd.concat(tables.values(), ignore_index=True)
    files = []
    if plot:
        from pneuma.figures.summary import draw_comparison

        narrowed = [word for word in data.narrowed if word not in heads]  # these are named below
        basename = figure_basename(replace(data, narrowed=narrowed), "compare", *(heads if b else heads[1:]))
        words = ["compare", name, a, *([b] if b else []), "--plot"]
        again = opt.drawing_command(words, picked, {"outcome": outcome or (), "format": formats})
        files = draw_files(
            picked.store, out, lambda folder: draw_comparison(data, table, folder, basename, formats, again)
        )
    if json:
        return print_json({"study": data.study, "comparisons": table, "figures": files})
    say(f"{data.full_title}: {heads[0]} against {heads[1]}")
    _tell_step(data)
    _tell_engines(data, [*pairs.values()])
    print()
    rows = []
    compared = [(condition, row) for condition, each in tables.items() for row in each.to_dict("records")]
    for condition, row in compared:
        difference = row["difference"], row["low"], row["high"]
        digits = {} if math.isnan(row["low"]) else {"low": row["low"], "high": row["high"]}
        means = (shown(row[key], decimals(row[key], **digits)) for key in ("mean_a", "mean_b"))
        better = "–" if math.isnan(row["p_better"]) else f"{row['p_better']:.2f}"
        runs = f"{row['seeds_a']} and {row['seeds_b']}", row["without_value"]
        rows.append(
            (condition, _with_unit(row["outcome"]), *means, shown_with_interval(*difference), better, *runs)
        )
    print_table(("", "outcome", *heads, "difference", "P(better)", "runs", "no value"), rows)
    print("\nMeans, and their difference with a 95 % interval (Welch). P(better): the probability that a run")
    print("of the first is better than one of the second. no value: runs without one, which are left out.")
    _tell_episodes(data, [row["outcome"] for _, row in compared])
    return tell_written(files)


def _tell_engines(data: StudyData, pairs: Sequence[tuple[str, str]]) -> None:
    """Say where what is compared was trained by different engines; claims refuse that."""
    for pair in pairs:
        engines = [", ".join(sorted(data.engines(name))) or "not known" for name in pair]
        if engines[0] != engines[1]:
            return say(f"Note: trained by different engines ({' and '.join(engines)}).")
    return None


def _is_study(store: Store, name: str) -> bool:
    from pneuma.analysis.run_index import RunIndex

    return name.endswith(".toml") or name in (*list_studies(), *RunIndex(store).listings())


# --- collapse -------------------------------------------------------------------------------------


@opt.grouped
def collapse(
    name: opt.StudyName,
    picked: opt.Chosen,
    fork: Annotated[
        bool, opt.flag("--fork", "Go on from before each collapse, changing one thing at a time.")
    ] = False,
    fork_seeds: Annotated[
        Any, opt.seeds("--fork-seeds", "With --fork: seeds of the forks of each run.")
    ] = "3",
    out: opt.FigureFolder = None,
    format: opt.Formats = None,
    workers: opt.Workers = None,
    trust: opt.Trust = False,
    json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> int:
    """Say which runs collapsed, when, by which signs, and how often in each condition."""
    if fork and (out or format):
        raise UserError("--out and --format: draw collapses, without --fork")
    if workers and not fork:
        raise UserError("--workers: is of --fork")
    formats, store = read_formats(format, out, "" if out else "--out"), picked.store
    data = open_data(picked, name)
    from pneuma.analysis.collapse import diagnoses, incidence
    from pneuma.analysis.frames import figure_basename

    found = diagnoses(data)
    shares = incidence(data, found)
    collapsed = found[found["collapsed"]]
    if fork:
        here = {run.run_id for run in data.runs if not run.row.published}
        collapsed = collapsed[collapsed["run_id"].isin(here)]
        parents = dict(zip(collapsed["run_id"], map(int, collapsed["sound_step"]), strict=True))
        if not parents:
            runs = counted(len(here), "run")
            raise UserError(
                f"study {data.study}: none of its {runs} here collapsed: there is nothing to fork"
            )
        plan = plan_cause_forks(store, data.study, parents, fork_seeds, trust=trust)
        how = Supervision(workers=opt.most_workers(workers))
        return train(plan, store, how, retry_failed=True, json=json, quiet=quiet)
    files = []
    if out is not None:
        from pneuma.figures.collapse import draw_collapse

        basename = figure_basename(data, "collapse")
        again = opt.drawing_command(["collapse", name, "--out", "figures"], picked, {"format": formats})
        files = draw_files(
            store, out, lambda folder: draw_collapse(data, folder, basename, formats, command=again)
        )
    if json:
        print_json({"study": data.study, "runs": found, "incidence": shares, "figures": files})
        return 0
    rows: list[tuple[object, ...]] = []
    for row in rows_of(collapsed):
        again = f"{row['recovered_step']:,}" if row["recovered_step"] else "never"
        again += " and relearned" * bool(row["relearned"])
        about = (row[key] for key in ("condition", "seed", "run_id"))
        rows.append((*about, f"{row['onset_step']:,}", row["signs"], again))
    if rows:
        print_table(("condition", "seed", "run", "step", "signs", "recovered at step"), rows)
        print()
    rows = []
    for row in rows_of(shares):
        interval = f"{row['low']:.0%} to {row['high']:.0%}" if row["runs"] else "–"
        rows.append((row["condition"], f"{row['collapsed']} of {row['runs']}", interval, row["unknown"]))
    print_table(("condition", "collapsed", "95 % interval", "without a sign recorded"), rows)
    tell_written(files)
    return 0


# --- effects --------------------------------------------------------------------------------------


@opt.grouped
def effects(
    name: opt.StudyName,
    picked: opt.Chosen,
    outcome: opt.Outcome = None,
    json: opt.Json = False,
) -> None:
    """Test the main effects and two-way interactions of a crossed study's factors."""
    data = open_data(picked, name)
    from pneuma.analysis.crossed import study_effects
    from pneuma.analysis.frames import common_step

    found = study_effects(data, outcome)
    if json:
        document = {key: getattr(found, key) for key in ("outcome", "cells", "runs", "means")}
        more = {"runs_without_outcome": found.without, "at_step": common_step(data), "effects": found.table}
        return print_json({"study": data.study, **document, **more})
    from pneuma.analysis.intervals import decimals, shown

    without = f", and {found.without} without it left out" if found.without else ""
    say(f"{data.full_title}: {_with_unit(found.outcome)}, {found.runs} runs in {found.cells} cells{without}")
    print()
    rows = []
    for row in found.table.to_dict("records"):
        f = "endless" if math.isinf(row["f"]) else shown(row["f"], 2)
        tested = f, shown(row["partial_r2"], 3), f"{row['p']:.4f}", f"{row['p_holm']:.4f}"
        rows.append((row["effect"], row["levels"], f"{row['df']}, {row['df_error']}", *tested))
    print_table(("effect", "levels", "df", "F", "partial R²", "p", "p (Holm)"), rows)
    print("\nMeans, with equal weight for each cell:")
    for factor, means in found.means.items():
        listed = ";  ".join(f"{level}: {shown(value, decimals(value))}" for level, value in means.items())
        say(f"  {factor} = {listed}")
    print("\nPartial R²: share of the variance that the other effects leave. Holm: over this table.")
    return _tell_step(data)


# --- robustness -----------------------------------------------------------------------------------


@opt.grouped
def robustness(
    name: opt.StudyName,
    contrast: opt.Contrast,
    picked: opt.Chosen,
    outcome: opt.Outcome = None,
    out: opt.FigureFolder = None,
    format: opt.Formats = None,
    json: opt.Json = False,
) -> None:
    """Compare two values of a field in every combination of a study's other factors."""
    formats, store = read_formats(format, out, "" if out else "--out"), picked.store
    setting, better, worse = contrast
    data = open_data(picked, name)
    from pneuma.analysis.crossed import robustness_map
    from pneuma.analysis.frames import common_step, figure_basename
    from pneuma.analysis.outcomes import find_outcome, primary

    found = robustness_map(data, setting, better, worse, outcome)
    files = []
    if out is not None:
        from pneuma.figures.maps import contrast_word, draw_robustness

        other = [found.outcome] if found.outcome != primary(data) else []
        basename = figure_basename(data, found.setting, *map(shown_value, found.values), *other)
        words = ["robustness", name, "--contrast", contrast_word(found), "--out", "figures"]
        again = opt.drawing_command(words, picked, {"outcome": other, "format": formats})
        files = draw_files(
            store,
            out,
            lambda folder: draw_robustness(data, [found], folder, basename, formats, command=again),
        )
    turned = find_outcome(found.outcome).better == "lower"
    if json:
        values = {"setting": found.setting, "better": found.values[0], "worse": found.values[1]}
        document = {"study": data.study, "contrast": values, "outcome": found.outcome, "label": found.label}
        more = {"turned": turned, "at_step": common_step(data), "cells": found.cells, "figures": files}
        return print_json({**document, **more})
    from pneuma.analysis.intervals import shown_with_interval

    against = " against ".join(map(shown_value, found.values))
    of = found.outcome + (" (turned, as less is better)" if turned else "")
    say(f"{data.full_title}: {found.setting} {against}, {of}: {found.label}")
    rows = []
    for cell in found.cells.to_dict("records"):
        levels = ", ".join(f"{key} {shown_level(cell[key])}" for key in found.factors) or cell["better"]
        effect = shown_with_interval(cell["value"], cell["low"], cell["high"])
        label = f"{cell['label']}: {cell['reason']}" if cell["reason"] else cell["label"]
        rows.append((levels, effect, f"{cell['p']:.4f}", label))
    print_table(("cell", f"difference of {_with_unit(found.outcome)}", "p (Holm)", ""), rows)
    print("Each interval is at 95 % by itself; p and the label are corrected over the map (Holm).")
    _tell_step(data)
    return tell_written(files)
