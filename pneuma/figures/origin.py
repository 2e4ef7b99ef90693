"""Where a figure comes from: one text in its file, under the key that each format has for a description.

Pneuma: Activation function in the arena: after the thesis's Fig. 6.5
activation, tanh, seeds 300..329, ids 0123456789abcdef
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from pneuma.analysis.study_data import StudyData
from pneuma.errors import plain
from pneuma.files import checksum
from pneuma.values import shown_seeds

KEYS = {"png": "Description", "svg": "Description", "pdf": "Subject"}
"""Where each format has the text; XMP maps all three to `dc:description`."""
MOST_IDS = 8
"""With more ids of a condition than this, their number and checksum are written."""


def origin_text(shown: str, runs: Iterable[str] = ()) -> str:
    """Return the text: what is shown, and a line for the runs of each condition.

    It contains no version, so that a picture's bytes change only with what is drawn.
    """
    return "\n".join([f"Pneuma: {plain(shown)}", *runs])


def lines_of_runs(*studies: StudyData) -> list[str]:
    """Return a line for the finished runs of each condition, with the ids of their configurations."""
    lines: list[str] = []
    for data in studies:
        for condition in data.conditions:
            runs = data.runs[data.runs["condition"] == condition]
            if len(runs):
                seeds = runs["seed"].tolist()
                lines.append(line_of_runs(data.study.name, condition, runs["config_id"], seeds))
    return lines


def line_of_runs(study: str, condition: str, ids: Iterable[str], seeds: Sequence[int]) -> str:
    """Return a line for runs, with many ids as one checksum and seeds as ranges."""
    names = sorted(set(ids))
    ids_text = ", ".join(names)
    if len(names) > MOST_IDS:
        ids_text = f"{len(names)} with SHA-256 {checksum(' '.join(names).encode())[:16]}"
    parts = [study, condition]
    if seeds:
        parts.append(f"seeds {shown_seeds(seeds)}")
    parts.append(f"ids {ids_text}")
    return plain(", ".join(filter(None, parts)))
