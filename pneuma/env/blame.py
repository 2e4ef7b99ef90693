"""Where in a user's own reward something went wrong: the file and line that a traceback holds."""

from __future__ import annotations

import traceback
from collections.abc import Iterator, Sequence

from pneuma.errors import UserError


def blame_reward(error: BaseException, rewards: Sequence[str]) -> UserError | None:
    """Return what to tell a user whose reward raised an error, or None if none of them did.

    Args:
        error: what was caught; the errors that led to it are looked at too.
        rewards: names as in a configuration; those of `module:function` are a user's own.
    """
    modules = {name.partition(":")[0]: name for name in rewards if ":" in name}
    for each in _chain(error):
        for frame, line in reversed(list(traceback.walk_tb(each.__traceback__))):
            name = modules.get(frame.f_globals.get("__name__", ""))
            if name:
                said = " ".join(str(each).split())
                told = f"{type(each).__name__}: {said}" if said else type(each).__name__
                return UserError(f"reward {name!r}: {frame.f_code.co_filename}, line {line}: {told}")
    return None


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and those that it was raised from or while handling."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
