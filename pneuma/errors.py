"""The one error a person is meant to see, the nearest right name to a wrong one, and counts in words.

Every layer raises `UserError` for a mistake made outside the code (a key, a value, a file, an
option); the command line prints it as one line and leaves with exit code 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UserError(Exception):
    """A mistake in a command or a file, told in one line that says what to mend."""


def install_extra(name: str) -> str:
    """Return how to install one of the extras; from its folder, for the index has another `pneuma`."""
    return f"pip install '.[{name}]' in Pneuma's folder"


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: 1 run, 2 runs, 10,000 runs."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def nearest_name(word: str, names: Iterable[str]) -> str:
    """Return ' (did you mean X?)' for the closest of `names`, or an empty string when none is near."""
    close = difflib.get_close_matches(word.lower(), list(names), n=1, cutoff=0.6)
    return f" (did you mean {close[0]}?)" if close else ""


def unknown_name(what: str, word: str, names: Iterable[str]) -> UserError:
    """Build the error for a name that is none of `names`, with the nearest right one."""
    known = list(names)
    return UserError(f"unknown {what} {word!r}{nearest_name(word, known)}; known are {', '.join(known)}")
