"""A study's words and looks in figures: headline, labels and colours of conditions."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping
from typing import Any

from pneuma.analysis.answer import Answer
from pneuma.analysis.study_data import StudyData
from pneuma.figures.style import MARKERS, MOST_IN_A_PANEL

LINES = ("-", "--", "-.", ":")
"""They distinguish conditions of one colour."""


def headline_of(answer: Answer, subject: str = "") -> str:
    """Return title and what is shown; default: the thesis's figure to which the study's corresponds."""
    drawing = answer.drawing
    return ": ".join(filter(None, [drawing["title"], subject or after_thesis(drawing["figure"])]))


def after_thesis(figure: str) -> str:
    counterpart = re.match(r"fig-(\d)-(\d)(?!\d)", figure)
    if counterpart is None:
        return ""
    return f"after the thesis's Fig. {counterpart[1]}.{counterpart[2]}"


def looks_of(drawing: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return colour, marker, line and label of each condition of a drawing (`drawing_of`).

    Colours are those of the style sheet in the files' order, except for those that a file names; a part of a
    study keeps the colours of the whole. Conditions that differ only in crossed factors have one colour:
    `tanh` is blue under every limit. Of many conditions those that have runs are coloured, in their order.
    """
    conditions = drawing["conditions"]
    named_colours = set(conditions["color"])
    if conditions["group"].nunique() > MOST_IN_A_PANEL:
        shown_conditions = drawing["runs"]["condition"].unique()
        conditions = conditions.set_index("condition", drop=False).loc[shown_conditions]
    free_colours = (f"C{colour_number}" for colour_number in itertools.count())
    group_colours: dict[str, str] = {}
    looks: dict[str, dict[str, Any]] = {}
    used_colours: list[str] = []
    for row in conditions.to_dict("records"):
        colour = row["color"] or group_colours.get(row["group"])
        while colour is None or (colour in named_colours and not row["color"]):
            colour = next(free_colours)
        if not row["color"]:
            group_colours[row["group"]] = colour
        looks[row["condition"]] = {
            "color": colour,
            "marker": MARKERS[len(looks) % len(MARKERS)],
            "linestyle": LINES[used_colours.count(colour) % len(LINES)],
            "label": row["label"] or None,
        }
        used_colours.append(colour)
    return looks


def fits_panel(study_data: StudyData) -> bool:
    return study_data.runs["condition"].nunique() <= MOST_IN_A_PANEL


def capital(sentence: str) -> str:
    """Return words that begin a sentence; the others stay, as HP."""
    return sentence[:1].upper() + sentence[1:]
