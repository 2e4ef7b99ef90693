"""The index of a folder of figures: the command that draws each file, and its runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pneuma.analysis.frames import StudyData
from pneuma.errors import UserError
from pneuma.figures.panels import title_of
from pneuma.files import checksum, read_whole, to_json

INDEX, CONTENTS = "index.json", "README.md"
SCHEMA = 1
MOST_NAMED = 12
"""Most conditions whose runs are listed one by one; with more, their sum is given."""


def index_entries(
    paths: Sequence[Path], command: str, data: StudyData, drawn: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return the index entries for files that show a study."""
    runs = {name: [run.run_id for run in data.of_condition(name)] for name in data.conditions}
    shared = {
        "command": command,
        "from": f"study {data.study}",
        "title": title_of(data),
        "changed": data.changed,
        "environments": data.environments,
        "engines": sorted({str(run["run"].get("engine", "unknown")) for run in data.record["runs"]}),
        **drawn,
        "n": {name: len(ids) for name, ids in runs.items()},
        "runs": runs,
    }
    return [{"file": path.name, "sha256": checksum(path.read_bytes()), **shared} for path in paths]


def read_index(folder: Path) -> list[dict[str, Any]]:
    """Return the entries of a folder's index whose files still exist."""
    path, whole = folder / INDEX, folder.resolve()
    if not path.is_file():
        return []
    try:
        entries = json.loads(read_whole(path))["figures"]
        files = [(folder / entry["file"]).resolve() for entry in entries]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise UserError(f"{path}: is no index of figures; remove it, or name another folder") from None
    return [
        entry
        for entry, file in zip(entries, files, strict=True)
        if file.is_file() and file.is_relative_to(whole)
    ]


def encode_index(entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Encode an index as JSON, sorted by file; a later entry replaces an earlier one."""
    by_file = {entry["file"]: entry for entry in entries}
    return to_json({"schema": SCHEMA, "figures": [by_file[name] for name in sorted(by_file)]})


def encode_contents(entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a page that lists a folder's figures, one section per source."""
    sections: dict[str, list[Mapping[str, Any]]] = {}
    for entry in entries:
        if Path(entry["file"]).suffix != ".svg":  # the same in one more format
            sections.setdefault(entry["from"], []).append(entry)
    head = f"Drawn by `make figures`, which writes this page too. As data, with run ids: `{INDEX}`."
    lines = ["# Figures and tables", "", head, ""]
    for source, figures in sections.items():
        title = " ".join(figures[0].get("title", "").split())
        lines += [f"## {title}", "", f"From {source}.", ""] if title else [f"## {source}", ""]
        lines += [f"- [{entry['file']}]({quote(entry['file'])}){_drawn(entry)}" for entry in figures]
        lines += [""]
    return "\n".join(lines).encode()


def _drawn(entry: Mapping[str, Any]) -> str:
    """Describe what a file shows: its kind, quantities, and number of runs."""
    kind = entry.get("figure", f"table: {entry['table']}" if "table" in entry else "")
    quantities = ", ".join(name.replace("_", " ") for name in entry.get("quantities", ()))
    known = {name: count for name, count in entry.get("n", {}).items() if count}
    runs = "runs: " * bool(known) + ", ".join(f"{name} {count}" for name, count in known.items())
    if len(known) > MOST_NAMED:
        runs = f"{sum(known.values()):,} runs of {len(known)} conditions"
    description = "; ".join(filter(None, [": ".join(filter(None, [kind, quantities])), runs]))
    return f": {description}" if description else ""
