"""`pneuma study summary` and `collapse`: what a study's runs come to, and which of them broke down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.figure_files import Formats, read_figures_asked
from pneuma.cli.options import (
    Json,
    Quiet,
    Results,
    Selected,
    StudyName,
    Trust,
    Workers,
    WorldName,
    print_json,
    read_path,
    read_seeds_option,
    read_workers,
    say,
    selects,
)
from pneuma.cli.plain_text import command, plain, print_table
from pneuma.cli.study_output import open_data, tell_written
from pneuma.cli.study_run import train
from pneuma.errors import UserError, counted
from pneuma.study.executors.base import Supervision
from pneuma.study.fork import plan_cause_forks
from pneuma.study.store import Store

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.tables import StudyData

RESULTS = Path("results")
FORK_SEEDS = "3"
COLUMNS = 3
"""Outcomes in the table that is printed unless more is asked for."""
COUNTS = ("runs", "diverged", "collapsed")
"""What a summary tells besides outcomes."""


@selects
def summary(
    name: StudyName,
    outcome: Annotated[
        list[str] | None,
        typer.Option(
            "--outcome",
            metavar="NAME",
            help="One of docs/outcomes.md, instead of the usual (may be repeated).",
        ),
    ] = None,
    all_: Annotated[
        bool, typer.Option("--all", help="Print every statistic of all usual outcomes, not three means.")
    ] = False,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Say what each condition's runs come to: means with 95 % intervals, spread, thresholds, failures."""
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.run_view import common_step, ends_before
    from pneuma.analysis.summaries import summary_table

    table = summary_table(data, outcome) if outcome else summary_table(data)
    if json:
        step = common_step(data)
        left_out = [run.run_id for run in data.runs if ends_before(run, step)]
        document = {"schema": 1, "study": data.study, "at_step": step, "left_out": left_out}
        return print_json({**document, "summary": records(table)})
    print(plain(data.title))
    tell_step(data)
    if outcome or all_:
        _print_statistics(data, table, outcome or ())
    else:
        _print_means(data, table)
    return None


@selects
def collapse(
    name: StudyName,
    fork: Annotated[
        bool, typer.Option("--fork", help="Go on from before each collapse, changing one thing at a time.")
    ] = False,
    run: Annotated[
        list[str] | None,
        typer.Option("--run", metavar="RUN_ID", help="Fork this collapsed run alone (may be repeated)."),
    ] = None,
    fork_seeds: Annotated[
        str, typer.Option("--fork-seeds", metavar="N|LIST", help="Seeds of the forks of each run.")
    ] = FORK_SEEDS,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", parser=read_path, help="Draw the collapses into this folder."),
    ] = None,
    format: Formats = None,
    workers: Workers = None,
    trust: Trust = False,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Say which runs collapsed, when, by which signs, and how often in each condition."""
    formats = read_figures_asked(out, format)
    if fork and out is not None:
        raise UserError("--out: does not go with --fork; `pneuma study plot` draws the forks")
    of_forks = {"run": run, "fork-seeds": fork_seeds != FORK_SEEDS, "workers": workers, "trust": trust}
    if idle := next((option for option, given in of_forks.items() if given and not fork), None):
        raise UserError(f"--{idle}: goes with --fork alone")
    store = Store(results)
    data = open_data(store, name, selection, world, mixed=not fork)
    from pneuma.analysis.collapse import diagnoses, incidence

    found = diagnoses(data)
    if fork:
        parents = _parents(data, found, run or ())
        plan = plan_cause_forks(store, data.study, parents, read_seeds_option(fork_seeds), trust=trust)
        plan = replace(plan, notes=tuple(plain(note) for note in plan.notes))
        how = Supervision(workers=read_workers(workers))
        return train(plan, store, how, retry_failed=True, json=json, quiet=quiet)
    files: list[Path] = []
    if out is not None:
        from pneuma.figures.collapse import draw_collapse
        from pneuma.figures.panels import stem_of

        files = draw_collapse(data, out, stem_of(data, "collapse"), formats)
    if json:
        document = {"schema": 1, "study": data.study, "runs": records(found)}
        print_json({**document, "incidence": records(incidence(data)), "figures": list(map(str, files))})
        return 0
    _print_collapses(found[found["collapsed"]], incidence(data))
    if any(store.has_checkpoints(run_id) for run_id in found["run_id"][found["collapsed"]]):
        again = command("study", "collapse", data.study, "--fork", "--results", store.root)
        say(f"To show the cause: {again}", quiet=quiet)
    tell_written(files)
    return 0


def tell_step(data: StudyData) -> None:
    """Say at what step runs of unlike budgets are compared."""
    from pneuma.analysis.run_view import common_step, step_words

    if step := common_step(data):
        print(f"Budgets are unlike: all as they stood at {step:,} steps, {plain(step_words(data))}.")


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return rows for `print_json`: None for what there is not."""
    known = table.astype(object).where(table.notna(), None)
    return [{str(key): value for key, value in row.items()} for row in known.to_dict("records")]


def _parents(data: StudyData, found: pd.DataFrame, wanted: Sequence[str]) -> dict[str, int]:
    """Return the collapsed runs that are to be forked, and before what step.

    Raises:
        UserError: when there is none, or a wanted one did not collapse.
    """
    collapsed = found[found["collapsed"]]
    steps = dict(zip(collapsed["run_id"], map(int, collapsed["sound_step"]), strict=True))
    if not steps:
        raise UserError(
            f"study {data.study}: none of its {len(found)} runs collapsed, so there is nothing to fork"
        )
    for prefix in wanted:
        if sum(run_id.startswith(prefix) for run_id in steps) != 1 or len(prefix) < 4:
            known = ", ".join(run_id[:8] for run_id in steps)
            raise UserError(f"--run {prefix}: is no collapsed run of study {data.study}; there are {known}")
    return {run_id: step for run_id, step in steps.items() if run_id.startswith(tuple(wanted) or "")}


# --- For people ------------------------------------------------------------------------------------


def _print_means(data: StudyData, table: pd.DataFrame) -> None:
    """Print a line for each condition: the means of the first outcomes that any has, and its failures."""
    from pneuma.analysis.outcomes import find_outcome

    means = table[table["statistic"] == "mean"]
    names = list(dict.fromkeys(means["outcome"]))[:COLUMNS]
    units = [find_outcome(name).unit for name in names]
    heads = [f"{name} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)]
    rows = []
    for condition in data.conditions:
        own = table[table["condition"] == condition]
        cells = [_cell(own, name, "mean") for name in names]
        failures = [_cell(own, name, "share") for name in ("collapsed", "diverged")]
        rows.append((condition, len(data.of_condition(condition)), *cells, *failures))
    print()
    print_table(("condition", "runs", *heads, "collapsed", "diverged"), rows)
    print("\nMeans, and shares of runs, with 95 % intervals. Medians, spread and other outcomes: --all.")


def _print_statistics(data: StudyData, table: pd.DataFrame, asked: Sequence[str]) -> None:
    """Print a table for each outcome that was asked for or has a value, and one of failures."""
    from pneuma.analysis.outcomes import find_outcome

    for outcome in dict.fromkeys([*asked, *table["outcome"]]):
        if outcome in COUNTS:
            continue
        found = find_outcome(outcome)
        print(f"\n{outcome}: {found.words}{_core_share(data) if found.source == 'times' else ''}")
        own = table[table["outcome"] == outcome]
        statistics = list(dict.fromkeys(own["statistic"]))
        rows: list[Sequence[object]] = []
        for condition in data.conditions:
            told = own[own["condition"] == condition]
            if told.empty:
                rows.append((condition, 0, _lack(data, condition, outcome)))
            else:
                cells = [_cell(told, outcome, statistic) for statistic in statistics]
                rows.append((condition, told["runs"].iloc[0], *cells))
        print_table(("condition", "n", *(_HEADS.get(name, name) for name in statistics or [""])), rows)
    print("\nshare of runs that diverged, and that collapsed (pneuma study collapse)")
    shares = table[table["statistic"] == "share"]
    heads = list(dict.fromkeys(shares["outcome"]))
    print_table(
        ("condition", *heads),
        (
            (name, *(_cell(shares[shares["condition"] == name], head, "share") for head in heads))
            for name in data.conditions
        ),
    )


_HEADS = {"iqm": "IQM", "deviation": "SD", "improvement": "P(better than baseline)"}


def _cell(table: pd.DataFrame, outcome: str, statistic: str) -> str:
    """Return a statistic of a condition with its interval; – for none."""
    from pneuma.analysis.rounding import shown_with_interval

    own = table[(table["outcome"] == outcome) & (table["statistic"] == statistic)]
    if own.empty:
        return "–"
    row = own.iloc[0]
    return shown_with_interval(row["value"], row["low"], row["high"])


def _lack(data: StudyData, condition: str, outcome: str) -> str:
    """Say why no run of a condition has a value."""
    from pneuma.analysis.outcomes import reason
    from pneuma.analysis.run_view import common_step

    runs = data.of_condition(condition)
    return reason(data, runs[0], outcome, common_step(data)) if runs else "no run has finished"


def _core_share(data: StudyData) -> str:
    """Say how much of a core those runs had whose times are told, where one had too little."""
    from pneuma.analysis.outcomes import QUIET

    shares = [run.records.processor_share for run in data.runs]
    known = [share for share in shares if share is not None]
    if len(known) == len(shares) and min(known) >= QUIET:
        return ""
    told = f"least {min(known):.0%}" if known else "not recorded"
    return f" (share of a core: {told}; no claim is judged below {QUIET:.0%})"


def _print_collapses(collapsed: pd.DataFrame, shares: pd.DataFrame) -> None:
    """Print the runs that collapsed, and the share of each condition's that did."""
    if len(collapsed):
        print_table(
            ("condition", "seed", "run", "step", "signs", "recovered at step"),
            (
                (
                    row["condition"],
                    row["seed"],
                    row["run_id"],
                    f"{row['onset_step']:,}",
                    row["signs"],
                    f"{row['recovered_step']:,}{' and relearned' * bool(row['relearned'])}"
                    if row["recovered_step"]
                    else "never",
                )
                for row in records(collapsed)
            ),
        )
        print()
    rows = []
    for row in records(shares):
        interval = f"{row['low']:.0%} to {row['high']:.0%}" if row["runs"] else "–"
        unknown = f"of {counted(row['unknown'], 'run')} no sign is recorded" if row["unknown"] else ""
        rows.append((row["condition"], f"{row['collapsed']} of {row['runs']} runs", interval, unknown))
    print_table(("condition", "collapsed", "95 % interval", ""), rows)
