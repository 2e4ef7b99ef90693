"""What `reset` may be told beside a seed, the same for every face: `start`, and `reset_mask` of batches.

A key like one of these is taken for a slip and refused; any other is left to the wrappers around the
environment, which is who Gymnasium's users mean with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os.path import commonprefix
from typing import Any

import numpy as np

from pneuma.env.worlds import Worlds


def read_options(options: Mapping[str, Any] | None, known: Sequence[str] = ("start",)) -> Mapping[str, Any]:
    """Return the options, or an empty mapping for none.

    Raises:
        TypeError: for what is no mapping.
        ValueError: for a key that looks like a slip of one of `known`.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise TypeError(f"options must be a mapping such as {{'start': 0}}, not {options!r}")
    for key in options:
        meant = [name for name in known if isinstance(key, str) and key not in known and _is_slip(key, name)]
        if meant:
            raise ValueError(f"unknown option {key!r} (did you mean {meant[0]}?)")
    return options


def _is_slip(word: str, name: str) -> bool:
    """Tell whether a word is a name but for a letter too many, too few or wrong, or two that changed places.

    What is less alike is a wrapper's: `stage` and `state` are no `start`.
    """
    alike = len(commonprefix([word.lower(), name]))
    left, right = word.lower()[alike:], name[alike:]
    swapped = left[:2] == right[1::-1] and left[2:] == right[2:]
    return swapped or left[1:] == right or left == right[1:] or left[1:] == right[1:]


def chosen_starts(state: Worlds, start: object) -> np.ndarray | None:
    """Return the start places asked for, shape (N,), or None for the usual ones.

    Args:
        state: the worlds.
        start: None; the index of a start place; or one for each world, of which those that are None,
            or any, may be the usual ones.

    Raises:
        TypeError: for what is no whole number, or not one for each world.
        ValueError: for a place that the level does not have.
    """
    if start is None:
        return None
    listed = isinstance(start, Sequence | np.ndarray) and not isinstance(start, str) and np.ndim(start) > 0
    asked = list(start) if listed else [start] * len(state)  # type: ignore[call-overload]
    if len(asked) != len(state):
        raise TypeError(f"start = {start!r}: one index, or one for each of {len(state)} worlds")
    places = len(state.level.starts)
    usual = state.usual_starts.tolist()
    chosen = [own if one is None else _place(one, places) for one, own in zip(asked, usual, strict=True)]
    return np.array(chosen, np.int64)


def _place(one: Any, places: int) -> int:
    whole = isinstance(one, int | np.integer) and not isinstance(one, bool)
    if not whole and not (isinstance(one, np.ndarray) and one.ndim == 0 and one.dtype.kind in "iu"):
        raise TypeError(f"start = {one!r} is not the index of a start place: a whole number")
    if not 0 <= one < places:
        raise ValueError(f"start {one!r}: the level has places 0 to {places - 1}")
    return int(one)
