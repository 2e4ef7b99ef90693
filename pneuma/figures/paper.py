"""Everything in `paper_figures/`: `make figures` runs this, and nothing else writes there.

    python -m pneuma.figures.paper FOLDER

Beside the figures it writes an index: which command drew each, from what.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pneuma.figures.environment import draw_level, draw_mailman, draw_screens

COMMAND = "make figures"


def draw_all(folder: Path) -> list[Path]:
    """Draw every figure and the index; return the files written."""
    sources = {
        "pneuma/Mailman-v0": draw_mailman(folder),
        "pneuma/Pneuma-v0, level thesis": [*draw_screens(folder), *draw_level(folder)],
    }
    index = [
        {"file": path.name, "command": COMMAND, "from": source, "runs": []}
        for source, paths in sources.items()
        for path in sorted(paths)
    ]
    path = folder / "index.json"
    path.write_text(json.dumps({"schema": 1, "figures": index}, indent=2) + "\n", encoding="utf-8")
    return [*(path for paths in sources.values() for path in paths), path]


if __name__ == "__main__":
    for written in draw_all(Path(sys.argv[1])):
        print(f"wrote {written}")
