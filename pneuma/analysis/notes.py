"""Notes without which an answer or its figure may mislead."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from pneuma.analysis.intervals import LEAST_RUNS, has_two_modes
from pneuma.analysis.outcomes import find_outcome, kinds_of_return
from pneuma.analysis.study_data import StudyData
from pneuma.errors import counted
from pneuma.store.quantities import WINDOWS
from pneuma.store.series import GRID_POINTS, SLACK, WINDOW_POINTS
from pneuma.values import format_settings

TRAILING_WINDOW = WINDOWS[1]
BUDGET_AVERAGE = "mean of the last 5 % of the budget at each point"
FEW_EPISODES = 10
"""With fewer, the last point of a return is noted to average few."""
ENOUGH_FOR_FAILURES = 10
"""With fewer runs, those that fail now and then are likely to be missing."""
FAILURES_MISSED = (
    "If one run in ten fails, 95 % intervals of 5, 10 and 30 runs cover the mean in 41, 65 and 91 % of "
    "studies."
)
MOST_NAMED = 3
"""Most conditions that a note names."""


def notes_on_runs(
    study_data: StudyData, shows_returns: bool = False, beside: StudyData | None = None
) -> list[str]:
    """Return notes for any figure of a study, the most important first.

    Args:
        study_data: the study.
        shows_returns: whether the figure is of returns.
        beside: a study whose returns are drawn too.
    """
    notes = [f"{' and '.join(conditions)} have identical settings." for conditions in study_data.duplicates]
    engines: dict[str, list[str]] = {}
    end_notes: list[str] = []
    missing_conditions: list[str] = []
    for condition in study_data.conditions:
        for engine in study_data.engines(condition):
            engines.setdefault(engine, []).append(condition)
        runs = study_data.of_condition(condition)
        if not runs:
            missing_conditions.append(condition)
            continue
        longest = max(run.budget for run in runs)  # other conditions may go further
        complete_count = sum(run.status == "done" and run.end >= longest for run in runs)
        if complete_count < len(runs):
            end_notes.append(f"{complete_count} of {len(runs)} runs of {condition} reach the end.")
    if len(engines) > 1:
        engine_texts = [f"{engine} ({_named(conditions)})" for engine, conditions in sorted(engines.items())]
        notes.append(f"The conditions were trained by different engines: {', '.join(engine_texts)}.")
    units = kinds_of_return(study_data)
    if beside:
        units |= kinds_of_return(beside)
    if shows_returns and len(units) > 1:
        notes.append("Returns with different rewards or numbers of players cannot be compared.")
    notes += end_notes
    if missing_conditions:
        notes.append(f"No runs of {_named(missing_conditions)}.")
    return notes


def notes_on_ends(study_data: StudyData) -> list[str]:
    """Return where runs end, unless all end alike, apart from budgets that earlier versions rounded up."""
    least_steps, most_steps = study_data.runs["steps"].min(), study_data.runs["steps"].max()
    if most_steps <= least_steps * (1 + SLACK):
        return []
    return [f"Runs end at {least_steps:,} to {most_steps:,} steps, and each counts at its own end."]


def notes_on_outcomes(study_data: StudyData, outcomes: Sequence[str]) -> list[str]:
    """Return what makes the values of some outcomes doubtful."""
    notes: list[str] = []
    if any(find_outcome(outcome).column for outcome in outcomes):
        notes += notes_on_zero_xp(study_data)
    if "final-return" in outcomes:
        notes += notes_on_few_episodes(study_data)
    return notes


def notes_on_few_episodes(study_data: StudyData) -> list[str]:
    """Return how many runs' last returns average few episodes, if any do."""
    last_counts = [run.statistic("episodes", "last") for run in study_data.rows]
    episode_counts = sorted(episodes for episodes in last_counts if 0 < episodes < FEW_EPISODES)
    if not episode_counts:
        return []
    amounts = f"{episode_counts[0]:.0f}"
    if episode_counts[0] < episode_counts[-1]:
        amounts += f" to {episode_counts[-1]:.0f}"
    return [f"final-return of {counted(len(episode_counts), 'run')} averages few episodes: {amounts}."]


def notes_on_zero_xp(study_data: StudyData) -> list[str]:
    """Return which evaluations began with 0 XP although XP is never reset; the engines' earlier versions did.

    They recorded no checksum of the policy.
    """
    rows = study_data.rows
    zero_count = sum(run.policy is None and run.fields.get("xp_scope") == "forever" for run in rows)
    if not zero_count:
        return []
    runs = "" if zero_count == len(rows) else f" of {zero_count} of {len(rows)} runs"
    return [f"Evaluations{runs} begin with 0 XP, unlike training."]


def notes_on_few_runs(data_by_env: Mapping[str, StudyData]) -> list[str]:
    """Return that intervals over environments are of few runs, if they are."""
    for env_data in data_by_env.values():
        if any(len(env_data.of_condition(condition)) < LEAST_RUNS for condition in env_data.conditions):
            return [f"Bootstrap intervals are too narrow if an environment has fewer than {LEAST_RUNS} runs."]
    return []


def notes_on_failing_runs(outcome: str, values_by_name: Mapping[str, np.ndarray]) -> list[str]:
    """Return what makes intervals of means doubtful: few runs, or runs of two kinds, as if some failed.

    Args:
        outcome: its name.
        values_by_name: its finite values, (runs,), by the names of conditions.
    """
    notes: list[str] = []
    few = [name for name, values in values_by_name.items() if 0 < len(values) < ENOUGH_FOR_FAILURES]
    if few:
        notes.append(f"Note: fewer than {ENOUGH_FOR_FAILURES} runs of {_named(few)}. {FAILURES_MISSED}")
    two_kinds = [
        name
        for name, values in values_by_name.items()
        if name not in few and not np.isin(values, (0, 1)).all() and has_two_modes(values)
    ]
    if two_kinds:
        notes.append(f"Note: by {outcome} runs of {_named(two_kinds)} are of two kinds. {FAILURES_MISSED}")
    return notes


def averaging(study_data: StudyData, window: str | None = None) -> str:
    """Return what a point of a study's returns averages, in a window; by default in the study's first."""
    if study_data.averaged_over == 1:
        return "as logged"
    if study_data.averaged_over or (window or study_data.windows[0]) == TRAILING_WINDOW:
        return f"mean of the last {study_data.averaged_over or 100} episodes"
    return BUDGET_AVERAGE


def notes_on_windows(study_data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return over how many steps points average if runs in a figure have several budgets."""
    budgets = {run.budget for run in (*study_data.rows, *(beside.rows if beside else ()))}
    if not budgets or max(budgets) <= min(budgets) * (1 + SLACK):
        return []
    steps = " or ".join(
        f"{WINDOW_POINTS * budget / GRID_POINTS:,.0f}" for budget in (min(budgets), max(budgets))
    )
    return [f"Budgets differ, so points average {steps} steps, and curves of longer runs lag more."]


def _named(conditions: Sequence[str]) -> str:
    if len(conditions) <= MOST_NAMED:
        return "; ".join(conditions)
    return counted(len(conditions), "condition")


def merge_notes(studies: Mapping[str, StudyData], notes: Mapping[str, Iterable[str]]) -> list[str]:
    """Return the notes on several studies once each, after the titles of those that a note is on.

    First come changed fields, which the headline of a single study has.

    Args:
        studies: by title.
        notes: on each of them.
    """
    titles_by_note: dict[str, list[str]] = {}
    for title, study_data in studies.items():
        if len(studies) > 1 and study_data.study.settings:
            settings_note = f"runs with {format_settings(study_data.study.settings)}."
            titles_by_note.setdefault(settings_note, []).append(title)
        for note in dict.fromkeys(notes[title]):
            titles_by_note.setdefault(note, []).append(title)
    merged: list[str] = []
    for note, titles in titles_by_note.items():
        if len(titles) < len(studies):
            if note[1].islower():  # and no abbreviation
                note = note[0].lower() + note[1:]
            note = f"{' and '.join(titles).replace(' and The ', ' and the ')}: {note}"
        merged.append(note)
    return merged
