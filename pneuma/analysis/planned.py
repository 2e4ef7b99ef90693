"""What a plan would train, how long that takes, and how many seeds find a difference."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.environments import by_environment, environment_names
from pneuma.analysis.intervals import LEVEL
from pneuma.analysis.outcomes import primary, with_unit
from pneuma.analysis.power import ENOUGH_RUNS, POWER, seeds_for_means, seeds_table, seeds_text
from pneuma.analysis.study_data import StudyData
from pneuma.config import Run
from pneuma.engines.loop import EPISODES, has_limited_evaluations, planned_evaluations
from pneuma.errors import Hint, UserError, tallied
from pneuma.store.index import RunIndex
from pneuma.store.store import Status
from pneuma.study.identity import config_id
from pneuma.study.plan import Plan
from pneuma.training import execute
from pneuma.training.progress import START_SECONDS, duration, expected_seconds, stored_paces
from pneuma.values import per_cent


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
    missing_runs = execute.missing(plan, statuses)
    execute.check_environments(missing_runs.values())
    paces = stored_paces(index.store, statuses)
    seconds_by_run: dict[str, float | None] = {}
    for run_id, run in missing_runs.items():
        seconds_by_run[run_id] = expected_seconds(paces, run, _steps_left(run, statuses[run_id]))
    state_rows = []
    for cell in plan.cells:
        state = _state(statuses[cell.run_id], cell.run_id in plan.published)
        state_rows.append((cell.run_id, cell.condition, cell.seed, state, seconds_by_run.get(cell.run_id)))
    state_table = pd.DataFrame(
        state_rows, columns=["run_id", "condition", "seed", "state", "expected_seconds"]
    )
    condition_rows = []
    for condition, run in plan.configurations.items():
        states = state_table["state"][state_table["condition"] == condition]
        amount = f"{len(states):>3} x {run.steps:>11,} steps"
        if run.trained_steps > run.steps:
            amount += f" ({run.trained_steps:,} trained)"
        condition_rows.append((condition, amount, tallied(states)))
    legend = [f"{tallied(state_table['state'])}."]
    if missing_runs:
        legend.append(
            f"Time to train: {_expected_time(index, missing_runs, statuses, seconds_by_run, workers)}."
        )
    notes = [f"Note: {note}." for note in plan.notes]
    points = {run.env: len(planned_evaluations(run)) for run in plan.configurations.values()}
    if len(set(points.values())) > 1 and len(points) > 1:
        counts = ", ".join(f"{count} in {env_id}" for env_id, count in points.items())
        notes.append(f"Note: runs so short have another number of evaluations in each environment: {counts}.")
    if any(has_limited_evaluations(run) for run in plan.configurations.values()):
        limit = "fewer where episodes of a random player's length would take over a fifth of a run's steps"
        notes.append(
            f"Note: an evaluation plays up to {EPISODES} episodes, and {limit}; see evaluation_episodes."
        )
    cells = pd.DataFrame(condition_rows, columns=["condition", "runs", "state"])
    return Answer("", {"study": plan.study.name}, {"runs": state_table}, [cells], notes, legend)


def _state(status: Status, is_published: bool) -> str:
    if status.finished:
        return "stored"
    if is_published:
        return "published"
    if status.failed:
        return "failed"
    return "partial" if status.step else "to-train"


def _steps_left(run: Run, status: Status) -> int:
    return run.trained_steps - execute.kept_step(status)


def _expected_time(
    index: RunIndex,
    missing_runs: Mapping[str, Run],
    statuses: Mapping[str, Status],
    seconds_by_run: Mapping[str, float | None],
    workers: int,
) -> str:
    """Return how long runs take, by runs that were trained here, or else by published ones."""
    machine = ""
    expected = [seconds_by_run[run_id] for run_id in missing_runs]
    if None in expected:
        machine = " on the machine that made the published runs"
        expected = []
        for run_id, run in missing_runs.items():
            expected.append(_published_seconds(index, run, _steps_left(run, statuses[run_id])))
    known_seconds = [run_seconds for run_seconds in expected if run_seconds is not None]
    if len(known_seconds) < len(missing_runs):
        return "unknown until a run of each configuration has ended"
    total_seconds = max(sum(known_seconds) / workers, *known_seconds)
    return f"about {duration(total_seconds)}{machine}, with {workers} at once"


def _published_seconds(index: RunIndex, run: Run, steps: int) -> float | None:
    """Return the seconds that steps of a run took on the machine that made the published runs.

    Learning takes as long as there are steps; evaluations are as many in a run of any length. None if no run
    of its configuration is published.
    """
    runs = index.frame.iloc[list(index.positions.get(config_id(run), ()))]
    for run_id in runs["run_id"][runs["where"] != ""]:
        row = index.row(run_id)
        if row is not None and row.wall_seconds:
            evaluation_share = row.provenance.get("evaluation_share")
            evaluating = row.wall_seconds * (evaluation_share if isinstance(evaluation_share, float) else 0.0)
            learning = (row.wall_seconds - evaluating) / row.end
            return START_SECONDS + evaluating * steps / run.trained_steps + learning * steps
    return None


# --- How many seeds -------------------------------------------------------------------------------


def seeds_to_detect(
    study_data: StudyData | None, detect: float, outcome: str, sd: float | None, level: float = LEVEL
) -> Answer:
    """Return how many seeds a condition needs to find a difference.

    Args:
        study_data: an opened study, by whose runs the spread is estimated; None if `sd` gives it.
        detect: the difference.
        outcome: its outcome; default: the study's primary one.
        sd: the standard deviation of runs.
        level: that of the interval which decides.

    Returns:
        The table `seeds` has a row for each condition.

    Raises:
        UserError: if a number is not above 0.
    """
    for option, amount in {"detect": detect, "sd": sd}.items():
        if amount is not None and amount <= 0:
            raise UserError(Hint(option, f"{amount:g}"), ": must be above 0")
    legend = [
        f"Seeds of each condition with which the {100 * level:.4g} % interval of the difference leaves out 0",
        f"in {per_cent(POWER)} of studies, if it is that large.",
    ]
    if study_data is None:
        assert sd is not None
        outcome = outcome or "any outcome"
        detection_table = pd.DataFrame(
            [{"SD": f"{sd:g}", "seeds": seeds_text(seeds_for_means(detect, sd, sd, level=level))}]
        )
        title = f"Seeds to detect {detect:g} of {outcome}"
    else:
        outcome = outcome or primary(study_data)
        tables_by_env = {}
        names = environment_names(study_data)
        for env, env_data in by_environment(study_data).items():
            tables_by_env[names[env]] = seeds_table(env_data, outcome, detect, level)
        detection_table = pd.concat(tables_by_env, names=["environment"]).reset_index(level=0)
        if len(tables_by_env) == 1:
            detection_table = detection_table.drop(columns="environment")
        title = f"{study_data.full_title}: seeds to detect {detect:g} of {with_unit(outcome)}"
        if any(len(study_data.of_condition(condition)) < ENOUGH_RUNS for condition in study_data.conditions):
            legend.append(
                f"With fewer than {ENOUGH_RUNS} runs the SD is a rough estimate: you may need three times "
                "the seeds, or half."
            )
    about = {"outcome": outcome, "detect": detect, "level": level}
    return Answer(title, about, {"seeds": detection_table}, [detection_table], (), legend)
