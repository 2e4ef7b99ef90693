"""Texts of a stranger's, made safe to print, and commands to be typed."""

from __future__ import annotations

import shlex


def plain(text: str) -> str:
    """Return a text without control characters, which could drive a terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)


def command(*words: object) -> str:
    """Return a command of Pneuma's, quoted so that it can be typed as it stands."""
    return plain(shlex.join(["pneuma", *map(str, words)]))
