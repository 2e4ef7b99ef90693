"""What of a stranger's settings would run code or read files outside of the results folder."""

from __future__ import annotations

from collections.abc import Mapping

from pneuma.config import Run, read_field
from pneuma.env_fields import are_own_characters, is_own_level, own_rewards

REWARD, LEVEL, CHARACTERS = "reward", "level", "characters"


def own_things(settings: Mapping[str, object]) -> dict[str, str]:
    """Return what settings name that is not shipped, by key: what would be done with it.

    Nothing is imported or opened to tell.

    Raises:
        UserError: for a value that is not allowed.
    """
    read = {
        key: read_field(Run, key, settings[key])
        for key in (REWARD, LEVEL, CHARACTERS)
        if settings.get(key) is not None
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
