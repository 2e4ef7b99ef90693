"""What ends an evaluation early: a stop that was asked for, or an episode that does not end."""

from __future__ import annotations

from collections.abc import Callable

from pneuma.config import Run
from pneuma.errors import OwnCodeError

LONGEST_EPISODE = 50_000
"""Most steps of an episode of an evaluation, where the environment may set no limit."""

IsStopping = Callable[[], bool]
"""Returns whether training was asked to stop."""


class Stopped(BaseException):
    """Training was asked to stop in the middle of an evaluation, or of an update that is lost.

    As KeyboardInterrupt, it passes through a user's own code. An evaluation is played again when its run
    resumes.
    """


def never() -> bool:
    return False


def check_stop(is_stopping: IsStopping) -> None:
    """Raise `Stopped` if training was asked to stop."""
    if is_stopping():
        raise Stopped


def check_length(run: Run, steps: int) -> None:
    """Refuse an episode of an evaluation that still runs after so many steps."""
    if steps >= LONGEST_EPISODE:
        problem = f"{run.env}: an episode does not end in {LONGEST_EPISODE:,} steps"
        raise OwnCodeError(f"{problem}: set env_kwargs = {{ max_episode_steps = N }}")
