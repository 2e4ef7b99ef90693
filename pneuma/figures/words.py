"""What figures say of a study: headline, labels, notes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pneuma.analysis.outcomes import kinds_of_return
from pneuma.analysis.study_data import StudyData
from pneuma.figures.style import MOST_IN_A_PANEL, condition_styles
from pneuma.values import shown_settings


def headline_of(data: StudyData, shown: str = "") -> str:
    """Return title and what is shown; default: the thesis's figure to which the study's corresponds."""
    return ": ".join(filter(None, [data.full_title, shown or after_thesis(data.study.figure)]))


def after_thesis(figure: str) -> str:
    counterpart = re.match(r"fig-(\d)-(\d)(?!\d)", figure)
    return f"after the thesis's Fig. {counterpart[1]}.{counterpart[2]}" if counterpart else ""


def notes_of(data: StudyData, returns: bool = False, beside: StudyData | None = None) -> list[str]:
    """Return notes for any figure of a study, or one of returns, the most important first.

    Returns of `beside` are drawn with it. Imported logs do not tell their reward.
    """
    notes = [f"{' and '.join(names)} are one configuration." for names in data.same]
    engines = sorted({engine for name in data.conditions for engine in data.engines(name)})
    if len(engines) > 1:
        notes.append(f"Trained by several engines ({', '.join(engines)}), which are not compared.")
    units = kinds_of_return(data) | (kinds_of_return(beside) if beside else set())
    if returns and len(units) > 1:
        notes.append("Returns of unlike rewards, or of more players, cannot be compared.")
    parents = {run.fields.get("parent") for run in data.rows} - {None, ""}
    if parents and len(parents) < max(len(data.of_condition(name)) for name in data.conditions):
        notes.append(f"Runs are forks of {len(parents)} alone: intervals take them for independent.")
    if absent := [name for name in data.conditions if not data.of_condition(name)]:
        notes.append(f"Not trained: {'; '.join(absent)}.")
    for name in data.conditions:
        runs = data.of_condition(name)
        longest = max((run.budget for run in runs), default=0)  # other conditions may go further
        at_end = sum(run.status == "done" and run.end >= longest for run in runs)
        if at_end < len(runs):
            notes.append(f"{at_end} of {len(runs)} runs of {name} reach the end.")
    return notes


def merge_notes(columns: Mapping[str, tuple[StudyData, Iterable[str]]]) -> list[str]:
    """Return the notes on several columns once each, after the columns that a note is on if not on all.

    First come changed fields, which the headline of a study alone has.
    """
    found: dict[str, list[str]] = {}
    for title, (data, notes) in columns.items():
        settings = data.study.settings if len(columns) > 1 else {}
        changed = f"runs with {shown_settings(settings)}." if settings else ""
        for note in filter(None, [changed, *notes]):
            found.setdefault(note, []).append(title)
    return [
        note if len(titles) == len(columns) else f"{' and '.join(_within(titles))}: {note}"
        for note, titles in found.items()
    ]


def _within(titles: Sequence[str]) -> list[str]:
    """Return titles as they stand in a sentence that begins with the first one."""
    return [*titles[:1], *(re.sub("^The ", "the ", title) for title in titles[1:])]


def label_of(data: StudyData, condition: str, name: str = "") -> str:
    return f"{name or data.study.labels.get(condition, condition)} ({len(data.of_condition(condition))})"


def styles_of(data: StudyData) -> dict[str, dict[str, Any]]:
    """Return the styles of conditions, which they keep where a part of the study is drawn, if it is small."""
    trained = [name for name in data.conditions if data.of_condition(name)]
    few = [
        names for names in ([*data.study.conditions], data.conditions) if 0 < len(names) <= MOST_IN_A_PANEL
    ]
    return condition_styles([*few, trained][0])


def fits_panel(data: StudyData) -> bool:
    return data.runs["condition"].nunique() <= MOST_IN_A_PANEL


def capital(words: str) -> str:
    """Return words that begin a sentence; the others stay, as HP."""
    return words[:1].upper() + words[1:]


def format_counts(counts: Iterable[int]) -> str:
    """Return counts as '10', or as '6 to 10' if they differ."""
    known = sorted({*counts})
    return str(known[0]) if len(known) == 1 else f"{known[0]} to {known[-1]}"
