"""What was read once and is kept while there is room, so that memory does not grow with a study's runs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Made = TypeVar("Made")

LAST_KEPT = 3
"""Of what there is no room for, so many stay: all tables of the run that is looked at."""


class Kept(Generic[Made]):
    """Things by key, each made when it is first asked for.

    What came first stays. Studies are gone through run by run and then again from the start, and to let the
    oldest go would then mean to keep nothing that is asked for again.

    Args:
        room_bytes: how much is kept at most, beside the last few.
    """

    def __init__(self, room_bytes: int) -> None:
        self._room = room_bytes
        self._kept: dict[Hashable, Made] = {}
        self._last: deque[tuple[Hashable, Made]] = deque(maxlen=LAST_KEPT)

    def get(self, key: Hashable, make: Callable[[], Made], size: Callable[[Made], int]) -> Made:
        """Return what belongs to a key, made now where it is not there; `size` tells its bytes."""
        if key in self._kept:
            return self._kept[key]
        for other, made in self._last:
            if other == key:
                return made
        made = make()
        if size(made) <= self._room:
            self._room -= size(made)
            self._kept[key] = made
        else:
            self._last.append((key, made))
        return made
