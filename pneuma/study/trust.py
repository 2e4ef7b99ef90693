"""What of a stranger's settings would run code or read files outside of the results folder."""

from __future__ import annotations

from collections.abc import Mapping

from pneuma.config import SHIPPED_CHARACTERS, SHIPPED_LEVELS, Run, read_setting

REWARD, LEVEL, CHARACTERS = "reward", "level", "characters"


def own_things(settings: Mapping[str, object]) -> dict[str, str]:
    """Return what settings name that is not shipped, by key: what would be done with it.

    Nothing is imported or opened to tell.

    Raises:
        UserError: for a value that is not allowed.
    """
    read = {
        key: read_setting(Run, key, settings[key])
        for key in (REWARD, LEVEL, CHARACTERS)
        if settings.get(key) is not None
    }
    custom = [name for name in read.get(REWARD, ()) if ":" in name]
    found = {REWARD: f"run the reward {', '.join(custom)}"} if custom else {}
    level = read.get(LEVEL, "")
    if level and level not in SHIPPED_LEVELS and not level.startswith("random:"):
        found[LEVEL] = f"read the level {level}"
    characters = read.get(CHARACTERS, "")
    if characters and characters not in SHIPPED_CHARACTERS:
        found[CHARACTERS] = f"read the characters {characters}"
    return found
