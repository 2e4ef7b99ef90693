"""Everything in `paper_figures/`: `make figures` runs this, and nothing else writes there.

    python -m pneuma.figures.paper FOLDER [RESULTS]

The environment's own figures, and of every published study in RESULTS/published its curves in the
thesis's layout and in Pneuma's, its summary, and its numbers as tables. Beside them an index: which
command drew each, from which runs.
"""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pneuma.analysis.export import encode_table
from pneuma.analysis.sources import open_published
from pneuma.analysis.tables import StudyData, tell_figures_apart
from pneuma.figures import FIGURE_LAYOUTS
from pneuma.figures.curves import draw_study, settle
from pneuma.figures.environment import draw_level, draw_mailman, draw_screens
from pneuma.figures.index import INDEX, encode_index, index_entries
from pneuma.figures.summary import draw_summary, shown_outcome

COMMAND = "make figures"
RESULTS = Path("results")
TABLES = "tables"
TABLE_FORMATS = {"latex": ".tex", "markdown": ".md", "csv": ".csv"}


def draw_all(folder: Path, results: Path = RESULTS) -> list[Path]:
    """Draw every figure, write every table and the index; return the files written.

    Raises:
        UserError: when a published table is damaged.
    """
    entries = _environment(folder)
    studies = open_published(results)
    tell_figures_apart(studies)
    for data in studies:
        entries += _study(data, folder)
    index = folder / INDEX
    index.write_bytes(encode_index(entries))
    return [*(folder / entry["file"] for entry in entries), index]


def _environment(folder: Path) -> list[dict[str, Any]]:
    sources = {
        "pneuma/Mailman-v0": draw_mailman(folder),
        "pneuma/Pneuma-v0, level thesis": [*draw_screens(folder), *draw_level(folder)],
    }
    return [
        {"file": path.name, "command": COMMAND, "from": source, "runs": {}}
        for source, paths in sources.items()
        for path in sorted(paths)
    ]


def _study(data: StudyData, folder: Path) -> list[dict[str, Any]]:
    entries = []
    for layout in FIGURE_LAYOUTS:
        if "return" in data.quantities:
            drawn = {"figure": "curves", **asdict(settle(data, layout=layout))}
            entries += index_entries(draw_study(data, folder, layout=layout), COMMAND, data, drawn)
    drawn = {"figure": "summary", "size": "page", "outcome": shown_outcome(data)}
    entries += index_entries(draw_summary(data, folder), COMMAND, data, drawn)
    tables = folder / TABLES
    tables.mkdir(parents=True, exist_ok=True)
    for form, suffix in TABLE_FORMATS.items():
        path = tables / f"{data.study}{suffix}"
        path.write_bytes(encode_table(data, "summary", form)[0])
        (entry,) = index_entries([path], COMMAND, data, {"table": "summary", "format": form})
        entries.append({**entry, "file": f"{TABLES}/{path.name}"})
    return entries


def main(folder: Path, results: Path = RESULTS) -> None:
    """Draw all and say so."""
    written = draw_all(folder, results)
    for path in written:
        print(f"wrote {path}")
    if not any(path.parent.name == TABLES for path in written):
        print(f"no study is published in {results / 'published'}: its figures and tables are still to come")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
