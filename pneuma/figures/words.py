"""A study's words and looks in figures: headline, labels and colours of conditions."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from pneuma.analysis.study_data import StudyData
from pneuma.figures.style import MARKERS, MOST_IN_A_PANEL
from pneuma.study.spec import CONDITION, Study

LINES = ("-", "--", "-.", ":")
"""They distinguish conditions of one colour."""


def headline_of(study_data: StudyData, subject: str = "") -> str:
    """Return title and what is shown; default: the thesis's figure to which the study's corresponds."""
    return ": ".join(filter(None, [study_data.full_title, subject or after_thesis(study_data.study.figure)]))


def after_thesis(figure: str) -> str:
    counterpart = re.match(r"fig-(\d)-(\d)(?!\d)", figure)
    if counterpart is None:
        return ""
    return f"after the thesis's Fig. {counterpart[1]}.{counterpart[2]}"


def shown_conditions(studies: Iterable[StudyData]) -> list[str]:
    """Return the conditions that have runs in any of some studies."""
    return list(
        dict.fromkeys(
            condition
            for study_data in studies
            for condition in study_data.conditions
            if study_data.of_condition(condition)
        )
    )


def labels_of(studies: Sequence[StudyData], short: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the labels of the conditions that have runs, with the number of runs in each of the studies."""
    labels: dict[str, str] = {}
    for condition in shown_conditions(studies):
        label, run_counts = (short or {}).get(condition, condition), []
        for study_data in studies:
            label = study_data.study.labels.get(condition, label)
            run_counts.append(len(study_data.of_condition(condition)))
        if len(set(run_counts)) == 1:
            run_counts = run_counts[:1]
        labels[condition] = f"{label} ({', '.join(map(str, run_counts))})"
    return labels


def looks_of(studies: Sequence[StudyData]) -> dict[str, dict[str, Any]]:
    """Return colour, marker, line and label of each condition of some studies, the same in all of them.

    Colours are those of the style sheet in the files' order, except for those that a file names; a part of a
    study keeps the colours of the whole. Conditions that differ only in crossed factors have one colour:
    `tanh` is blue under every limit.
    """
    groups: dict[str, str] = {}
    named_colours: dict[str, str] = {}
    for study_data in studies:
        for condition in (*study_data.study.conditions, *study_data.conditions):
            group = groups.setdefault(condition, _group(study_data.study, condition))
            colour = study_data.study.colors.get(condition) or study_data.study.colors.get(group)
            if colour:
                named_colours.setdefault(condition, colour)
    labels = labels_of(studies)
    if len(set(groups.values())) > MOST_IN_A_PANEL:
        groups = {name: groups[name] for name in labels}
    free_colours = (f"C{colour_number}" for colour_number in itertools.count())
    group_colours: dict[str, str] = {}
    looks: dict[str, dict[str, Any]] = {}
    used_colours: list[str] = []
    for condition, group in groups.items():
        colour = named_colours.get(condition) or group_colours.get(group)
        while colour is None or (colour in named_colours.values() and condition not in named_colours):
            colour = next(free_colours)
        if condition not in named_colours:
            group_colours[group] = colour
        looks[condition] = {
            "color": colour,
            "marker": MARKERS[len(looks) % len(MARKERS)],
            "linestyle": LINES[used_colours.count(colour) % len(LINES)],
            "label": labels.get(condition),
        }
        used_colours.append(colour)
    return looks


def _group(study: Study, condition: str) -> str:
    """Return the condition of a crossed study's file that a condition is of, or its last factor's value."""
    levels = study.levels.get(condition, {})
    return levels.get(CONDITION) or [condition, *levels.values()][-1]


def short_names(studies: Sequence[StudyData]) -> tuple[dict[str, str], str]:
    """Return names of conditions in rows, and what they consist of: of crossed ones the factors' values."""
    levels: dict[str, Mapping[str, str]] = {}
    for study_data in studies:
        levels |= {
            condition: study_data.study.levels.get(condition, {}) for condition in study_data.conditions
        }
    factors = {tuple(condition_levels) for condition_levels in levels.values()}
    if len(factors) > 1 or factors == {()}:
        return {}, ""
    names_by_condition = {
        condition: ", ".join(condition_levels.values()) for condition, condition_levels in levels.items()
    }
    return names_by_condition, ", ".join(factors.pop()).replace("_", " ")


def fits_panel(study_data: StudyData) -> bool:
    return study_data.runs["condition"].nunique() <= MOST_IN_A_PANEL


def capital(sentence: str) -> str:
    """Return words that begin a sentence; the others stay, as HP."""
    return sentence[:1].upper() + sentence[1:]
