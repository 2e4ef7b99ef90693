"""The one error a person is meant to see, the nearest right name to a wrong one, counts, and safe texts.

Every layer raises `UserError` for a mistake made outside the code (a key, a value, a file, an
option); the command line prints it as one line and leaves with exit code 2.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

NEAR = 0.6
"""How alike a name must be to be offered in place of a wrong one."""
SHORTEST_BEGINNING = 4
"""Letters of a word that can be told to be a name's beginning."""


class UserError(Exception):
    """A mistake in a command or a file, told in one line that says what to mend."""


def install_extra(name: str) -> str:
    """Return how to install one of the extras; from its folder, for the index has another `pneuma`."""
    return f"pip install '.[{name}]' in Pneuma's folder"


def plain(text: str) -> str:
    """Return a text with each character that cannot be seen written as its code, as JSON does.

    For terminals and figures: titles and names may come from untrusted files, and control characters could
    drive a terminal, reverse the direction of writing, or make an SVG that is no XML.
    """
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in text)


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: 1 run, 2 runs, 10,000 runs."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def nearest_name(word: str, names: Iterable[str]) -> str:
    """Return ' (did you mean X?)' for the closest of `names`, or an empty string when none is near.

    The beginning of a long name, misspelt, is near as well: `final-shre` of `final-share-killed`.
    """
    known = list(names)
    likeness = {name: _likeness(str(word).lower(), name) for name in known}
    best = max(known, key=likeness.__getitem__, default="")
    return f" (did you mean {best}?)" if likeness.get(best, 0.0) >= NEAR else ""


def unknown_name(what: str, word: str, names: Iterable[str]) -> UserError:
    """Build the error for a name that is none of `names`, with the nearest right one."""
    known = list(names)
    between = "; " if any("," in name for name in known) else ", "
    return UserError(f"unknown {what} {word!r}{nearest_name(word, known)}; known are {between.join(known)}")


def _likeness(word: str, name: str) -> float:
    """Return how alike a word and a name are, from 0 to 1; alike beginnings count a little less."""
    whole = difflib.SequenceMatcher(None, name, word).ratio()
    if len(word) < SHORTEST_BEGINNING:
        return whole
    return max(whole, 0.9 * difflib.SequenceMatcher(None, name[: len(word) + 1], word).ratio())
