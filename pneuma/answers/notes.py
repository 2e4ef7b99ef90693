"""Notes without which a figure of a study may mislead."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from pneuma.analysis.outcomes import kinds_of_return
from pneuma.analysis.study_data import StudyData
from pneuma.errors import counted
from pneuma.values import shown_settings

MOST_NAMED = 3
"""Most conditions that a note names."""


def notes_on_runs(data: StudyData, returns: bool = False, beside: StudyData | None = None) -> list[str]:
    """Return notes for any figure of a study, the most important first.

    Args:
        data: the study.
        returns: whether the figure is of returns.
        beside: a study whose returns are drawn too.
    """
    notes = [f"{' and '.join(names)} have identical settings." for names in data.same]
    engines: dict[str, list[str]] = {}
    ends: list[str] = []
    missing: list[str] = []
    for name in data.conditions:
        for engine in data.engines(name):
            engines.setdefault(engine, []).append(name)
        runs = data.of_condition(name)
        if not runs:
            missing.append(name)
            continue
        longest = max(run.budget for run in runs)  # other conditions may go further
        at_end = sum(run.status == "done" and run.end >= longest for run in runs)
        if at_end < len(runs):
            ends.append(f"{at_end} of {len(runs)} runs of {name} reach the end.")
    if len(engines) > 1:
        engine_texts = [f"{engine} ({_named(names)})" for engine, names in sorted(engines.items())]
        notes.append(f"The conditions were trained by different engines: {', '.join(engine_texts)}.")
    units = kinds_of_return(data)
    if beside:
        units |= kinds_of_return(beside)
    if returns and len(units) > 1:
        notes.append("Returns with different rewards or numbers of players cannot be compared.")
    notes += ends
    if missing:
        notes.append(f"No runs of {_named(missing)}.")
    return notes


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
    for title, data in studies.items():
        if len(studies) > 1 and data.study.settings:
            titles_by_note.setdefault(f"runs with {shown_settings(data.study.settings)}.", []).append(title)
        for note in dict.fromkeys(filter(None, notes[title])):
            titles_by_note.setdefault(note, []).append(title)
    merged: list[str] = []
    for note, titles in titles_by_note.items():
        if len(titles) < len(studies):
            if note[1].islower():  # and no abbreviation
                note = note[0].lower() + note[1:]
            note = f"{' and '.join(titles).replace(' and The ', ' and the ')}: {note}"
        merged.append(note)
    return merged
