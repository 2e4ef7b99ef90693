"""What a plan would train, how long that takes, and how many seeds find a difference."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from pneuma.analysis.environments import by_environment
from pneuma.analysis.outcomes import primary, with_unit
from pneuma.analysis.power import ENOUGH_RUNS, POWER, seeds_for_means, seeds_table, seeds_text
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import Answer
from pneuma.config import Run
from pneuma.errors import Hint, UserError, tallied
from pneuma.store.index import RunIndex
from pneuma.store.store import Status
from pneuma.study.identity import config_id
from pneuma.study.plan import Plan
from pneuma.training import execute
from pneuma.training.progress import START_SECONDS, duration, expected_seconds, stored_paces
from pneuma.values import per_cent

DETECT_LEGEND = (
    "Seeds of each condition with which the 95 % interval of the difference leaves out 0",
    f"in {per_cent(POWER)} of studies, if it is that large.",
)


def plan_answer(index: RunIndex, plan: Plan, workers: int) -> Answer:
    """Return the state of each of a plan's runs, and how long training takes.

    Args:
        index: the runs of a results folder, and published ones.
        plan: what is to be trained.
        workers: how many runs train at once.

    Returns:
        The table `runs` has the state of each cell and, of those to train, the expected seconds.
    """
    statuses = {cell.run_id: index.store.status(cell.run_id) for cell in plan.cells}
    todo = execute.missing(plan, statuses)
    execute.check_environments(todo.values())
    paces = stored_paces(index.store, statuses)
    seconds: dict[str, float | None] = {}
    for run_id, run in todo.items():
        seconds[run_id] = expected_seconds(paces, run, run.steps - execute.kept_step(statuses[run_id]))
    rows = []
    for cell in plan.cells:
        state = _state(statuses[cell.run_id], cell.run_id in plan.published)
        rows.append((cell.run_id, cell.condition, cell.seed, state, seconds.get(cell.run_id)))
    table = pd.DataFrame(rows, columns=["run_id", "condition", "seed", "state", "expected_seconds"])
    lines = []
    for condition, run in plan.configurations.items():
        states = table["state"][table["condition"] == condition]
        lines.append((condition, f"{len(states):>3} x {run.steps:>11,} steps", tallied(states)))
    legend = [f"{tallied(table['state'])}."]
    if todo:
        legend.append(f"Time to train: {_expected_time(index, todo, statuses, seconds, workers)}.")
    notes = [f"Note: {note}." for note in plan.notes]
    cells = pd.DataFrame(lines, columns=["condition", "runs", "state"])
    return Answer("", {"study": plan.study.name}, {"runs": table}, [cells], notes, legend)


def _state(status: Status, is_published: bool) -> str:
    if status.finished:
        return "stored"
    if is_published:
        return "published"
    if status.failed:
        return "failed"
    return "partial" if status.step else "to-train"


def _expected_time(
    index: RunIndex,
    todo: Mapping[str, Run],
    statuses: Mapping[str, Status],
    seconds: Mapping[str, float | None],
    workers: int,
) -> str:
    """Return how long runs take, by runs that were trained here, or else by published ones."""
    machine = ""
    expected = [seconds[run_id] for run_id in todo]
    if None in expected:
        machine = " on the machine that made the published runs"
        expected = []
        for run_id, run in todo.items():
            expected.append(_published_seconds(index, run, run.steps - execute.kept_step(statuses[run_id])))
    known_seconds = [run_seconds for run_seconds in expected if run_seconds is not None]
    if len(known_seconds) < len(todo):
        return "unknown until a run of each kind has ended"
    total = max(sum(known_seconds) / workers, *known_seconds)
    return f"about {duration(total)}{machine}, with {workers} at once"


def _published_seconds(index: RunIndex, run: Run, steps: int) -> float | None:
    """Return the seconds that steps of a run took on the machine that made the published runs.

    Learning takes as long as there are steps; evaluations are as many in a run of any length. None if no run
    of its configuration is published.
    """
    runs = index.frame.iloc[list(index.places.get(config_id(run), ()))]
    for run_id in runs["run_id"][runs["where"] != ""]:
        row = index.row(run_id)
        if row is not None and row.wall_seconds:
            share = row.provenance.get("evaluation_share")
            evaluating = row.wall_seconds * (share if isinstance(share, float) else 0.0)
            learning = (row.wall_seconds - evaluating) / row.end
            return START_SECONDS + evaluating * steps / run.steps + learning * steps
    return None


# --- How many seeds -------------------------------------------------------------------------------


def seeds_to_detect(data: StudyData | None, detect: float, outcome: str, sd: float | None) -> Answer:
    """Return how many seeds a condition needs to find a difference.

    Args:
        data: an opened study, by whose runs the spread is estimated; None if `sd` gives it.
        detect: the difference.
        outcome: its outcome; default: the study's primary one.
        sd: the standard deviation of runs.

    Returns:
        The table `seeds` has a row for each condition.

    Raises:
        UserError: if a number is not above 0.
    """
    for name, value in {"detect": detect, "sd": sd}.items():
        if value is not None and value <= 0:
            raise UserError(Hint(name, f"{value:g}"), ": must be above 0")
    legend = list(DETECT_LEGEND)
    if data is None:
        assert sd is not None
        outcome = outcome or "any outcome"
        table = pd.DataFrame([{"SD": f"{sd:g}", "seeds": seeds_text(seeds_for_means(detect, sd, sd))}])
        title = f"Seeds to detect {detect:g} of {outcome}"
    else:
        outcome = outcome or primary(data)
        tables = {}
        for env, env_data in by_environment(data).items():
            tables[env] = seeds_table(env_data, outcome, detect)
        table = pd.concat(tables, names=["environment"]).reset_index(level=0)
        if len(tables) == 1:
            table = table.drop(columns="environment")
        title = f"{data.full_title}: seeds to detect {detect:g} of {with_unit(outcome)}"
        if any(len(data.of_condition(condition)) < ENOUGH_RUNS for condition in data.conditions):
            legend.append(
                f"With fewer than {ENOUGH_RUNS} runs the SD is a rough estimate: you may need three times "
                "the seeds, or half."
            )
    about = {"outcome": outcome, "detect": detect}
    return Answer(title, about, {"seeds": table}, [table], (), legend)
