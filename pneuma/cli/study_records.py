"""The runs that a command reads, and what it says of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, TypeVar

from pneuma.cli.options import Chosen
from pneuma.cli.output import say
from pneuma.errors import UserError
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

Read = TypeVar("Read")
Name = TypeVar("Name")


def open_data(picked: Chosen, name: str) -> StudyData:
    """Open the runs of a study that are asked for, and say what is shown and what else is stored."""
    from pneuma.analysis.asked import open_study
    from pneuma.analysis.run_index import RunIndex

    return open_study(RunIndex(picked.store), name, picked.selection, picked.world, partial(say, aside=True))


def nothing_yet(store: Store) -> str:
    """Return a message if no run is stored or published here; empty otherwise."""
    if store.runs() or store.published(shipped=False):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def each_study(names: Iterable[Name], read: Callable[[Name], Read]) -> list[Read]:
    """Read studies that the user did not name; print a note for those that cannot be read.

    Raises:
        UserError: when none can be read; the error of the first.
    """
    found, errors = [], []
    for name in names:
        try:
            found.append(read(name))
        except UserError as error:
            errors.append(error)
    if errors and not found:
        raise errors[0]
    for unread in errors:
        say(f"Note: {unread}.", aside=True)
    return found


def told_step(data: StudyData) -> str:
    """Return at which step runs are compared, if their budgets differ; empty otherwise."""
    from pneuma.analysis.frames import common_step, step_words

    step = common_step(data)
    return f"Budgets differ: all values are those at step {step:,}, {step_words(data)}." if step else ""


def with_unit(outcome: str) -> str:
    from pneuma.analysis.outcomes import find_outcome

    unit = "" if outcome == "diverged" else find_outcome(outcome).unit  # a run's status
    return f"{outcome} ({unit})" if unit else outcome
