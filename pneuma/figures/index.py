"""The index of a folder of figures: from each file to the command that draws it again, and its runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.figures.captions import title_of

INDEX, CONTENTS = "index.json", "README.md"
SCHEMA = 1
MOST_NAMED = 12
"""Conditions whose runs are counted one by one for people; of more there is a sum."""


def index_entries(
    paths: Sequence[Path], command: str, data: StudyData, drawn: Mapping[str, Any]
) -> list[dict[str, Any]]:
    """Return what the index tells of files that show a study.

    Args:
        paths: the files, already written.
        command: what draws them again.
        data: the study.
        drawn: how they are drawn, such as the band.
    """
    conditions = {name: [run.run_id for run in data.of_condition(name)] for name in data.conditions}
    engines = {str(run["run"].get("engine", "unknown")) for run in data.record["runs"]}
    shared = {
        "command": command,
        "from": f"study {data.study}",
        "title": title_of(data),
        "environments": data.environments,
        "engines": sorted(engines),
        **drawn,
        "n": {name: len(runs) for name, runs in conditions.items()},
        "runs": conditions,
    }
    return [
        {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), **shared}
        for path in paths
    ]


def encode_contents(entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a page of a folder's figures for people, a section to a source, its figures in their order."""
    sections: dict[str, list[Mapping[str, Any]]] = {}
    for entry in entries:
        sections.setdefault(entry["from"], []).append(entry)
    head = f"Drawn by `make figures`, which writes this page too. As data, with run ids: `{INDEX}`."
    lines = ["# Figures and tables", "", head, ""]
    for source, own in sections.items():
        title = " ".join(own[0].get("title", "").split())
        lines += [f"## {title}", "", f"From {source}.", ""] if title else [f"## {source}", ""]
        lines += [
            f"- [{entry['file']}]({quote(entry['file'])}){_drawn(entry)}"
            for entry in own
            if not _is_twin(entry)
        ]
        lines += [""]
    return "\n".join(lines).encode()


def _is_twin(entry: Mapping[str, Any]) -> bool:
    """Tell whether a file is another's in one more format."""
    return Path(entry["file"]).suffix in (".svg", ".tex", ".csv")


def _drawn(entry: Mapping[str, Any]) -> str:
    """Say what a file shows: which figure or table, of which quantities, and of how many runs."""
    kind = entry.get("figure", f"table: {entry['table']}" if "table" in entry else "")
    quantities = ", ".join(name.replace("_", " ") for name in entry.get("quantities", ()))
    told = "; ".join(filter(None, [": ".join(filter(None, [kind, quantities])), _runs(entry.get("n", {}))]))
    return f": {told}" if told else ""


def _runs(counts: Mapping[str, int]) -> str:
    known = {name: count for name, count in counts.items() if count}
    if len(known) > MOST_NAMED:
        return f"{sum(known.values()):,} runs of {len(known)} conditions"
    return "runs: " + ", ".join(f"{name} {count}" for name, count in known.items()) if known else ""


def read_index(folder: Path) -> list[dict[str, Any]]:
    """Return the entries of a folder's index whose files are still there.

    Raises:
        UserError: where a file of its name is no index.
    """
    entries = read_entries(folder)
    return [entry for entry in entries if "/" not in entry["file"] and (folder / entry["file"]).is_file()]


def read_entries(folder: Path) -> list[dict[str, Any]]:
    """Return all entries of a folder's index; none where it has no index.

    Raises:
        UserError: where a file of its name is no index.
    """
    path = folder / INDEX
    if not path.is_file():
        return []
    try:
        entries: list[dict[str, Any]] = json.loads(path.read_bytes())["figures"]
        if not all(isinstance(entry["file"], str) for entry in entries):
            raise ValueError
        return entries
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise UserError(f"{path}: is no index of figures; remove it, or name another folder") from None


def encode_index(entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Return an index as JSON, its entries in the order of their files; a later entry replaces an earlier."""
    by_file = {entry["file"]: entry for entry in entries}
    document = {"schema": SCHEMA, "figures": [by_file[name] for name in sorted(by_file)]}
    return (json.dumps(document, indent=2) + "\n").encode()
