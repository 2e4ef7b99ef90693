"""`pneuma study summary` and `collapse`: what a study's runs come to, and which of them broke down."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
from pneuma.cli.plain_text import command, plain
from pneuma.cli.study_output import tell_left_out
from pneuma.cli.study_records import study_record
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
    for part in _readable(data, table, outcome or ()):
        print("\n" + part)
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
    if not fork and (idle := _idle(run, fork_seeds, workers, trust)):
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
    figures = [] if out is None else _drawn_collapses(data, out, formats)
    if json:
        document = {"schema": 1, "study": data.study, "runs": records(found)}
        print_json({**document, "incidence": records(incidence(data)), "figures": list(map(str, figures))})
        return 0
    _print_collapses(data, found, incidence(data))
    if any(store.has_checkpoints(run_id) for run_id in found["run_id"][found["collapsed"]]):
        again = command("study", "collapse", data.study, "--fork", "--results", store.root)
        say(f"To show the cause: {again}", quiet=quiet)
    for path in figures:
        print(f"wrote {plain(str(path))}")
    return 0


def tell_step(data: StudyData) -> None:
    """Say at what step runs of unlike budgets are compared."""
    from pneuma.analysis.run_view import common_step, step_words

    if step := common_step(data):
        print(f"Budgets are unlike: all as they stood at {step:,} steps, {plain(step_words(data))}.")


def _idle(run: list[str] | None, fork_seeds: str, workers: str | None, trust: bool) -> str:
    """Return the first option of forks that was given; empty where none was."""
    given = {"run": run, "fork-seeds": fork_seeds != FORK_SEEDS, "workers": workers, "trust": trust}
    return next((name for name, value in given.items() if value), "")


def _drawn_collapses(data: StudyData, out: Path, formats: tuple[str, ...]) -> list[Path]:
    from pneuma.figures.collapse import draw_collapse

    return draw_collapse(data, out, f"{data.figure}-collapse", formats)


def open_data(store: Store, name: str, selection: Any, world: str | None, *, mixed: bool = True) -> StudyData:
    """Open a study's data, as `open_study` does, saying how many runs of the selection are left out."""
    record = study_record(store, name, selection, world)
    from pneuma.analysis.run_index import open_study

    data = open_study(store, record, mixed=mixed)
    tell_left_out(data)
    return data


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
    return {
        run_id: step
        for run_id, step in steps.items()
        if not wanted or any(run_id.startswith(prefix) for prefix in wanted)
    }


# --- For people ------------------------------------------------------------------------------------


def _readable(data: StudyData, table: pd.DataFrame, asked: Sequence[str]) -> Iterable[str]:
    """Yield a block of lines for each outcome, that was asked for or has a value: a condition a line."""
    from pneuma.analysis.outcomes import find_outcome
    from pneuma.analysis.rounding import shown_with_interval

    width = _width(data)
    for outcome in dict.fromkeys([*asked, *table["outcome"]]):
        if outcome in ("runs", "diverged", "collapsed"):
            continue
        found = find_outcome(outcome)
        lines = [f"{outcome}: {found.words}{_beside(data) if found.source == 'times' else ''}"]
        told = dict(iter(table[table["outcome"] == outcome].groupby("condition", sort=False)))
        for condition in data.conditions:
            if condition not in told:
                lines.append(f"  {plain(condition):<{width}} n = 0   {_lack(data, condition, outcome)}")
                continue
            own = told[condition]
            cells = [
                f"{_WORDS.get(row['statistic'], row['statistic'])} "
                f"{shown_with_interval(row['value'], row['low'], row['high'])}"
                for row in own.to_dict("records")
            ]
            lines.append(f"  {plain(condition):<{width}} n = {own['runs'].iloc[0]:<3} {'  '.join(cells)}")
        yield "\n".join(lines)
    yield "\n".join(_failures(data, table))


def _lack(data: StudyData, condition: str, outcome: str) -> str:
    """Say why no run of a condition has a value."""
    from pneuma.analysis.outcomes import reason
    from pneuma.analysis.run_view import common_step

    runs = data.of_condition(condition)
    return reason(data, runs[0], outcome, common_step(data)) if runs else "no run has finished"


def _beside(data: StudyData) -> str:
    """Say how much of a core those runs had whose times are told."""
    from pneuma.analysis.outcomes import QUIET

    shares = [run.records.processor_share for run in data.runs]
    known = [share for share in shares if share is not None]
    if len(known) == len(shares) and min(known, default=1.0) >= QUIET:
        return ""
    told = [f"least {min(known):.0%}"] if known else []
    if len(known) < len(shares):
        told.append(f"of {counted(len(shares) - len(known), 'run')} not recorded")
    return f" (share of a core: {', '.join(told)}; no claim is judged below {QUIET:.0%})"


_WORDS = {"iqm": "IQM", "deviation": "SD", "improvement": "P(better than baseline)", "median": "median"}


def _width(data: StudyData) -> int:
    """Return how wide the column of conditions is."""
    return max(len(plain(condition)) for condition in data.conditions) + 1


def _failures(data: StudyData, table: pd.DataFrame) -> Iterable[str]:
    from pneuma.analysis.rounding import shown_with_interval

    width = _width(data)
    yield "share of runs that diverged, and that collapsed (pneuma study collapse)"
    for condition in data.conditions:
        own = table[(table["condition"] == condition) & (table["statistic"] == "share")]
        cells = [
            f"{row['outcome']} {shown_with_interval(row['value'], row['low'], row['high'])}"
            for row in own.to_dict("records")
        ]
        yield f"  {plain(condition):<{width}} {'  '.join(cells)}"


def _print_collapses(data: StudyData, found: pd.DataFrame, shares: pd.DataFrame) -> None:
    width = _width(data)
    for row in found[found["collapsed"]].to_dict("records"):
        update = "" if _missing(row["onset_update"]) else f"update {row['onset_update']:,}, "
        after = "" if _missing(row["recovered_step"]) else f"; recovered at step {row['recovered_step']:,}"
        again = " and relearned" if row["relearned"] is True else ""
        told = f"{plain(row['condition']):<{width}} seed {row['seed']:<6} {row['run_id']}"
        print(f"{told}  {update}step {row['onset_step']:,}: {row['signs']}{after}{again}")
    for row in shares.to_dict("records"):
        interval = f", 95 % interval {row['low']:.0%} to {row['high']:.0%}" if row["runs"] else ""
        unknown = f"; of {counted(row['unknown'], 'run')} no sign is recorded" if row["unknown"] else ""
        told = f"{row['collapsed']} of {row['runs']} runs collapsed{interval}{unknown}"
        print(f"{plain(row['condition']):<{width}} {told}")


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return rows for `print_json`: None for what there is not."""
    known = table.astype(object).where(table.notna(), None)
    return [{str(key): value for key, value in row.items()} for row in known.to_dict("records")]


def _missing(value: object) -> bool:
    import pandas as pd

    return value is None or value is pd.NA
