"""`pneuma study collapse`, `effects` and `robustness`: what happened in a study, and what it depends on."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, draw_files, read_formats, rows_of, wrote
from pneuma.cli.study_notes import what_is_shown, with_unit
from pneuma.cli.study_run import train
from pneuma.errors import UserError, counted
from pneuma.study.executors.base import ExecutorConfig
from pneuma.study.fork import plan_cause_forks
from pneuma.values import shown_level, shown_value

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.crossed import Effects, Map
    from pneuma.analysis.frames import StudyData

FORK_SEEDS = 3

# --- collapse -------------------------------------------------------------------------------------


def collapse(
    picked: opt.Picked,
    name: str = opt.STUDY,
    fork: bool = opt.flag("--fork", "Go on from before each collapse, changing one thing at a time."),
    fork_seeds: Any = opt.seeds("--fork-seeds", "With --fork: seeds of the forks of each run (default: 3)."),
    out: Path | None = opt.FIGURE_FOLDER,
    format: opt.SeveralRead = opt.FORMATS,
    workers: Any = opt.WORKERS,
    trust: bool = opt.TRUST,
    quiet: bool = opt.QUIET,
) -> Result:
    """Say which runs collapsed, when, by which signs, and how often in each condition."""
    if fork and (out or format):
        raise UserError("--out and --format: draw collapses, without --fork")
    of_fork = {"--fork-seeds": fork_seeds, "--workers": workers, "--trust": trust, "--quiet": quiet}
    if not fork and (given := [option for option, value in of_fork.items() if value]):
        raise UserError(f"{given[0]}: is of --fork")
    formats, store = read_formats(format, out, "" if out else "--out"), picked.store
    data = picked.open(name)
    from pneuma.analysis.collapse import diagnoses, incidence

    found = diagnoses(data)
    shares = incidence(data, found)
    collapsed = found[found["collapsed"]]
    if fork:
        here = {run.run_id for run in data.runs if not run.published}
        collapsed = collapsed[collapsed["run_id"].isin(here)]
        parents = dict(zip(collapsed["run_id"], map(int, collapsed["last_healthy_step"]), strict=True))
        if not parents:
            runs = counted(len(here), "run")
            raise UserError(
                f"study {data.study}: none of its {runs} here collapsed: there is nothing to fork"
            )
        plan = plan_cause_forks(store, data.study, parents, fork_seeds or range(FORK_SEEDS), trust=trust)
        return train(plan, store, ExecutorConfig(workers=opt.most_workers(workers)), True, quiet)
    files = []
    if out is not None:
        from pneuma.figures.collapse import collapse_page

        again = picked.again(data, "collapse", name, "--out", "figures", format=formats)
        files = draw_files(store, out, formats, [(collapse_page(data, found), again)])
    document = {**what_is_shown(data), "runs": found, "incidence": shares, "figures": files}
    return Result(document, [*_collapse_tables(collapsed, shares), *wrote(files)])


def _collapse_tables(collapsed: pd.DataFrame, shares: pd.DataFrame) -> Iterator[str | Table]:
    rows: list[tuple[object, ...]] = []
    for row in rows_of(collapsed):
        again = f"{row['recovered_step']:,}" if row["recovered_step"] else "never"
        again += " and relearned" * bool(row["relearned"])
        about = (row[key] for key in ("condition", "seed", "run_id"))
        rows.append((*about, f"{row['onset_step']:,}", row["signs"], again))
    if rows:
        yield Table(("condition", "seed", "run", "step", "signs", "recovered at step"), rows)
        yield ""
    rows = []
    for row in rows_of(shares):
        interval = f"{row['low']:.0%} to {row['high']:.0%}" if row["runs"] else "–"
        rows.append((row["condition"], f"{row['collapsed']} of {row['runs']}", interval, row["unknown"]))
    yield Table(("condition", "collapsed", "95 % interval", "without a sign recorded"), rows)


# --- effects --------------------------------------------------------------------------------------


def effects(picked: opt.Picked, name: str = opt.STUDY, outcome: opt.Text = opt.OUTCOME) -> Result:
    """Test the main effects and two-way interactions of a crossed study's factors."""
    data = picked.open(name)
    from pneuma.analysis.crossed import study_effects
    from pneuma.analysis.frames import common_step

    found = study_effects(data, outcome)
    document = {key: getattr(found, key) for key in ("outcome", "cells", "runs", "means")}
    more = {"runs_without_outcome": found.without, "at_step": common_step(data), "effects": found.table}
    return Result({**what_is_shown(data), **document, **more}, _show_effects(data, found))


def _show_effects(data: StudyData, found: Effects) -> Iterator[str | Table]:
    from pneuma.analysis.frames import step_note
    from pneuma.analysis.intervals import decimals, shown

    without = f", and {found.without} without it left out" if found.without else ""
    runs = f"{counted(found.runs, 'run')} in {counted(found.cells, 'cell')}{without}"
    yield f"{data.full_title}: {with_unit(found.outcome)}, {runs}"
    yield ""
    rows = []
    for row in found.table.to_dict("records"):
        f = "endless" if math.isinf(row["f"]) else shown(row["f"], 2)
        tested = f, shown(row["partial_r2"], 3), f"{row['p']:.4f}", f"{row['p_holm']:.4f}"
        rows.append((row["effect"], row["levels"], f"{row['df']}, {row['df_error']}", *tested))
    yield Table(("effect", "levels", "df", "F", "partial R²", "p", "p (Holm)"), rows)
    yield ""
    yield "Means, with equal weight for each cell:"
    for factor, means in found.means.items():
        listed = ";  ".join(f"{level}: {shown(value, decimals(value))}" for level, value in means.items())
        yield f"  {factor} = {listed}"
    yield ""
    yield "Partial R²: share of the variance that the other effects leave. Holm: over this table."
    yield from filter(None, [step_note(data)])


# --- robustness -----------------------------------------------------------------------------------


def robustness(
    picked: opt.Picked,
    name: str = opt.STUDY,
    contrast: Any = opt.CONTRAST,
    outcome: opt.Text = opt.OUTCOME,
    out: Path | None = opt.FIGURE_FOLDER,
    format: opt.SeveralRead = opt.FORMATS,
) -> Result:
    """Compare two values of a field in every combination of a study's other factors."""
    formats = read_formats(format, out, "" if out else "--out")
    setting, better, worse = contrast
    data = picked.open(name)
    from pneuma.analysis.crossed import robustness_map
    from pneuma.analysis.frames import common_step
    from pneuma.analysis.outcomes import find_outcome

    found = robustness_map(data, setting, better, worse, outcome)
    files = []
    if out is not None:
        from pneuma.figures.maps import contrast_word, robustness_page

        words = "robustness", name, "--contrast", contrast_word(found), "--out", "figures"
        again = picked.again(data, *words, outcome=[found.outcome], format=formats)
        files = draw_files(picked.store, out, formats, [(robustness_page(data, [found]), again)])
    turned = find_outcome(found.outcome).better == "lower"
    values = {"setting": found.setting, "better": found.values[0], "worse": found.values[1]}
    document = {**what_is_shown(data), "contrast": values, "outcome": found.outcome, "label": found.label}
    more = {"turned": turned, "at_step": common_step(data), "cells": found.cells, "figures": files}
    return Result({**document, **more}, [*_show_map(data, found, turned), *wrote(files)])


def _show_map(data: StudyData, found: Map, turned: bool) -> Iterator[str | Table]:
    from pneuma.analysis.frames import step_note
    from pneuma.analysis.intervals import shown_with_interval

    against = " against ".join(map(shown_value, found.values))
    of = found.outcome + (" (turned, as less is better)" if turned else "")
    yield f"{data.full_title}: {found.setting} {against}, {of}: {found.label}"
    rows = []
    for cell in found.cells.to_dict("records"):
        levels = ", ".join(f"{key} {shown_level(cell[key])}" for key in found.factors) or cell["better"]
        effect = shown_with_interval(cell["value"], cell["low"], cell["high"])
        label = f"{cell['label']}: {cell['reason']}" if cell["reason"] else cell["label"]
        rows.append((levels, effect, f"{cell['p']:.4f}", label))
    yield Table(("cell", f"difference of {with_unit(found.outcome)}", "p (Holm)", ""), rows)
    yield "Each interval is at 95 % by itself; p and the label are corrected over the map (Holm)."
    yield from filter(None, [step_note(data)])
