"""`pneuma study collapse`, `effects` and `robustness`: what happened in a study, and what it depends on."""

from __future__ import annotations

import math
from typing import Annotated, Any

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
from pneuma.cli.study_records import open_data, told_step, with_unit
from pneuma.cli.study_run import train
from pneuma.errors import UserError, counted
from pneuma.study.executors.base import ExecutorConfig
from pneuma.study.fork import plan_cause_forks
from pneuma.values import shown_level, shown_value

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
        parents = dict(zip(collapsed["run_id"], map(int, collapsed["last_healthy_step"]), strict=True))
        if not parents:
            runs = counted(len(here), "run")
            raise UserError(
                f"study {data.study}: none of its {runs} here collapsed: there is nothing to fork"
            )
        plan = plan_cause_forks(store, data.study, parents, fork_seeds, trust=trust)
        how = ExecutorConfig(workers=opt.most_workers(workers))
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
    runs = f"{counted(found.runs, 'run')} in {counted(found.cells, 'cell')}{without}"
    say(f"{data.full_title}: {with_unit(found.outcome)}, {runs}")
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
    if told := told_step(data):
        say(told)


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
    print_table(("cell", f"difference of {with_unit(found.outcome)}", "p (Holm)", ""), rows)
    print("Each interval is at 95 % by itself; p and the label are corrected over the map (Holm).")
    if told := told_step(data):
        say(told)
    return tell_written(files)
