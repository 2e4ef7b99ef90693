"""Words of the commands that messages and figures give to copy."""

from __future__ import annotations

import os
from pathlib import Path

from pneuma.presets import default_world
from pneuma.study.spec import Study
from pneuma.values import setting_words


def study_words(study: Study) -> list[str]:
    """Return a command's words for a study as it is: its name or file, world and changed fields.

    A file has the shorter of its absolute path and that from the current folder.
    """
    words = [study.name]
    if study.own_path:
        words = [min(os.path.relpath(study.own_path), study.own_path, key=len)]
    if study.world != default_world(study.worlds):
        words += ["--world", study.world]
    return words + setting_words(study.settings)


def results_words(folder: Path) -> list[str]:
    """Return the option that names a results folder, unless it is the default."""
    return [] if folder == Path(os.environ.get("PNEUMA_RESULTS") or "results") else ["--results", str(folder)]
