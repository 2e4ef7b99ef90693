"""What a run is called: a hash of everything that can change its outcome."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run, as_settings


def run_id(run: Run) -> str:
    """Return 16 hexadecimal digits that two runs share only if they end with the same bits.

    Hashed are the resolved configuration with its seed and budget, the contents of a level folder
    of the user's own, and the versions of rules and engine; not the study's name. A setting that is
    None is left out, so that a new optional setting leaves old names alone.
    """
    identity = {
        "run": {key: value for key, value in as_settings(run).items() if value is not None},
        "contents": _contents(Path(run.level)),
        "rules": RULES_VERSION,
        "engine": ENGINE_VERSIONS[run.engine],
    }
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def _contents(folder: Path) -> str:
    """Return a digest of a user's level folder; shipped levels are part of the rules' version."""
    if not (folder / "level.toml").is_file():
        return ""
    digest = hashlib.sha256()
    for path in sorted(folder.iterdir()):
        if path.is_file():
            digest.update(f"{path.name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
    return digest.hexdigest()
