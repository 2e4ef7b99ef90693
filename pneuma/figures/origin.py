"""Where a figure comes from: one text in its file, under the key that each format has for a description.

Pneuma: Activation function in the arena: after the thesis's Fig. 6.5
activation, tanh, seeds 300..329, ids 0123456789abcdef
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from pneuma.errors import printable
from pneuma.files import checksum
from pneuma.seeds import format_seeds

KEYS = {"png": "Description", "svg": "Description", "pdf": "Subject"}
"""Where each format has the text; XMP maps all three to `dc:description`."""
MOST_IDS = 8
"""With more ids of a condition than this, their number and checksum are written."""


def origin_text(subject: str, run_lines: Iterable[str] = ()) -> str:
    """Return the text: what is shown, and a line for the runs of each condition.

    It contains no version, so that a picture's bytes change only with what is drawn.
    """
    return "\n".join([f"Pneuma: {printable(subject)}", *run_lines])


def lines_of_runs(*run_tables: pd.DataFrame) -> list[str]:
    """Return a line for the runs of each condition in `run_table`s, with the ids of their configurations."""
    run_lines: list[str] = []
    for run_table in run_tables:
        for (_, study, condition), runs in run_table.groupby(
            ["environment", "study", "condition"], sort=False
        ):
            run_lines.append(
                line_of_runs(str(study), str(condition), runs["config_id"], runs["seed"].tolist())
            )
    return list(dict.fromkeys(run_lines))


def line_of_runs(study_name: str, condition: str, run_ids: Iterable[str], seeds: Sequence[int]) -> str:
    """Return a line for runs, with many ids as one checksum and seeds as ranges."""
    sorted_ids = sorted(set(run_ids))
    ids_text = ", ".join(sorted_ids)
    if len(sorted_ids) > MOST_IDS:
        ids_text = f"{len(sorted_ids)} with SHA-256 {checksum(' '.join(sorted_ids).encode())[:16]}"
    phrases = [study_name, condition]
    if seeds:
        phrases.append(f"seeds {format_seeds(seeds)}")
    phrases.append(f"ids {ids_text}")
    return printable(", ".join(filter(None, phrases)))
