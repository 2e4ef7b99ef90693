"""Commands to be typed, and untrusted texts made safe to print."""

from __future__ import annotations

import shlex

from pneuma.errors import plain

__all__ = ["command", "plain"]


def command(*words: object) -> str:
    """Return a command of Pneuma's, quoted so that it can be typed as it stands."""
    return plain(shlex.join(["pneuma", *map(str, words)]))
