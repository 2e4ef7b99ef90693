"""What figures say of a study: headline, labels, notes."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pneuma.analysis.outcomes import kinds_of_return
from pneuma.analysis.study_data import StudyData
from pneuma.figures.style import MARKERS, MOST_IN_A_PANEL
from pneuma.study.spec import CONDITION, Study
from pneuma.values import shown_settings

MOST_NAMED = 3
"""Most conditions that a note names."""


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
    engines: dict[str, list[str]] = {}
    for name in data.conditions:
        for engine in data.engines(name):
            engines.setdefault(engine, []).append(name)
    if len(engines) > 1:
        parts = [f"{engine} ({_named(names)})" for engine, names in sorted(engines.items())]
        notes.append(f"Conditions were trained by different engines: {', '.join(parts)}.")
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


def _named(conditions: Sequence[str]) -> str:
    few = len(conditions) <= MOST_NAMED
    return "; ".join(conditions) if few else f"{len(conditions)} conditions"


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
    """Return the colour and marker of each condition, which it keeps where a part of the study is drawn.

    Colours are those of the style sheet in the file's order, but for those that it names. If there are too
    many conditions for one panel, those that differ only in crossed factors look alike, because each has its
    own row: `tanh` looks the same under every limit.
    """
    study, every = data.study, [[*data.study.conditions], data.conditions]
    names = next((each for each in every if 0 < len(each) <= MOST_IN_A_PANEL), every[1])
    many = len(names) > MOST_IN_A_PANEL
    kinds = {name: _kind(study, name) if many else name for name in names}
    own = {
        kind: colour
        for name, kind in kinds.items()
        if (colour := study.colors.get(name) or study.colors.get(_kind(study, name)))
    }
    free = (colour for place in itertools.count() if (colour := f"C{place}") not in own.values())
    looks = {
        kind: {"color": own.get(kind) or next(free), "marker": MARKERS[place % len(MARKERS)]}
        for place, kind in enumerate(dict.fromkeys(kinds.values()))
    }
    return {name: looks[kind] for name, kind in kinds.items()}


def _kind(study: Study, condition: str) -> str:
    """Return the condition of a crossed study's file that a condition is of, or its last factor's value."""
    levels = study.levels.get(condition, {})
    return levels.get(CONDITION) or [condition, *levels.values()][-1]


def short_names(studies: Iterable[StudyData], conditions: Sequence[str]) -> tuple[dict[str, str], str]:
    """Return names of conditions in rows, and what they consist of: of crossed ones the factors' values."""
    every = {name: of for data in studies for name, of in data.study.levels.items()}
    levels = [every.get(name, {}) for name in conditions]
    short = [", ".join(of.values()) for of in levels]
    if len({*map(tuple, levels)}) > 1 or len(levels[0]) < 2 or len({*short}) < len(short):
        return {name: name for name in conditions}, ""
    return dict(zip(conditions, short, strict=True)), ", ".join(levels[0]).replace("_", " ")


def fits_panel(data: StudyData) -> bool:
    return data.runs["condition"].nunique() <= MOST_IN_A_PANEL


def capital(words: str) -> str:
    """Return words that begin a sentence; the others stay, as HP."""
    return words[:1].upper() + words[1:]
