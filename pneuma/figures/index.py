"""The index of a folder of figures: from each file to the command that draws it again, and its runs."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError

INDEX = "index.json"
SCHEMA = 1


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


def read_index(folder: Path) -> list[dict[str, Any]]:
    """Return the entries of a folder's index whose files are still there.

    Raises:
        UserError: where a file of its name is no index.
    """
    path = folder / INDEX
    if not path.is_file():
        return []
    try:
        entries = json.loads(path.read_bytes())["figures"]
        return [entry for entry in entries if "/" not in entry["file"] and (folder / entry["file"]).is_file()]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        raise UserError(f"{path}: is no index of figures; remove it, or name another folder") from None


def encode_index(entries: Sequence[Mapping[str, Any]]) -> bytes:
    """Return an index as JSON, its entries in the order of their files; a later entry replaces an earlier."""
    by_file = {entry["file"]: entry for entry in entries}
    document = {"schema": SCHEMA, "figures": [by_file[name] for name in sorted(by_file)]}
    return (json.dumps(document, indent=2) + "\n").encode()
