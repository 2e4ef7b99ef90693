"""What a run is called, a hash of all that can change its outcome; and which files of its user's it names."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path

from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run, as_fields, read_field
from pneuma.env_fields import are_own_characters, is_own_level, own_rewards

REWARD, LEVEL, CHARACTERS = "reward", "level", "characters"


def run_id(run: Run) -> str:
    """Return 16 hexadecimal digits that two runs share only if they end with the same bits.

    Hashed are the resolved configuration with its seed and budget, the contents of the user's own
    files (not their paths), and the versions of rules and engine; not the study's name. A field at
    its default is left out, so that a new field leaves old names alone; a default that changes
    must therefore raise a version.
    """
    usual = as_fields(Run())
    own = {key: value for key, value in as_fields(run).items() if value != usual[key]}
    if is_own_level(run.level):
        own["level"] = "of the user's own"
    if are_own_characters(run.characters):
        own["characters"] = "of the user's own"
    identity = {
        "run": own,
        "contents": _contents(run),
        "rules": RULES_VERSION,
        "engine": [run.engine, ENGINE_VERSIONS[run.engine]],
    }
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def _contents(run: Run) -> str:
    """Return a digest of the user's own files that a run reads: level, characters, reward functions.

    What is shipped is part of the rules' version.
    """
    paths: list[Path] = []
    if is_own_level(run.level):
        paths += import_module("pneuma.env.level").level_files(run.level)
    if are_own_characters(run.characters):
        paths += import_module("pneuma.env.characters").character_files(run.characters)
    custom = own_rewards(run.reward)
    if custom:
        paths += import_module("pneuma.env.reward").reward_files(custom)
    digest = hashlib.sha256()
    for path in paths:
        digest.update(f"{path.name}\0{path.stat().st_size}\0".encode() + path.read_bytes())
    return digest.hexdigest() if paths else ""


def own_things(fields: Mapping[str, object]) -> dict[str, str]:
    """Return what untrusted fields name that is not shipped, by key: what would be done with it.

    Nothing is imported or opened to tell.

    Raises:
        UserError: for a value that is not allowed.
    """
    read = {
        key: read_field(Run, key, fields[key])
        for key in (REWARD, LEVEL, CHARACTERS)
        if fields.get(key) is not None
    }
    custom = own_rewards(read.get(REWARD, ()))
    found = {REWARD: f"run the reward {', '.join(custom)}"} if custom else {}
    level = read.get(LEVEL, "")
    if is_own_level(level):
        found[LEVEL] = f"read the level {level}"
    characters = read.get(CHARACTERS, "")
    if are_own_characters(characters):
        found[CHARACTERS] = f"read the characters {characters}"
    return found
