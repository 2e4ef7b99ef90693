"""What is made of a search's record: its space, the search to promote from, how far its runs are."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pneuma.config import Run, read_settings
from pneuma.errors import UserError
from pneuma.search.record import lock_folder
from pneuma.search.space import Choices, Parameter, Range, Space
from pneuma.search.spec import Budget, Search
from pneuma.search.trials import Task
from pneuma.study.locks import is_held
from pneuma.study.store import Store
from pneuma.study.trust import own_things


@dataclass(frozen=True)
class Begun:
    """The generation that is not told yet.

    Attributes:
        searching: whether a process is at it now.
        trials: their numbers.
        runs, ended: how many they have so far, and how many of these have ended.
    """

    searching: bool
    trials: tuple[int, ...]
    runs: int
    ended: int


def begun_runs(store: Store, record: Mapping[str, Any]) -> Begun:
    """Return how far the trials are that a record does not hold yet."""
    selection = store.selection(f"search-{record['search']}") or {"runs": []}
    told = len(record["trials"])
    numbers, names = set(), set()
    for run in selection["runs"]:
        number = _TRIAL.match(run["condition"])
        if number and int(number[1]) >= told and run["seed"] in record["seeds"]:
            numbers.add(int(number[1]))
            names.add(run["run_id"])
    ended = sum(store.status(name).finished for name in names)
    searching = is_held(lock_folder(store, record["search"]))
    return Begun(searching, tuple(sorted(numbers)), len(names), ended)


_TRIAL = re.compile(r"trial-(\d{1,6})")


def read_space(record: Mapping[str, Any]) -> Space:
    """Return the space of a recorded search, from what its identity holds of it.

    Raises:
        UserError: where the record, which may be a stranger's, holds none.
    """
    try:
        identity = record["identity"]
        parameters = tuple(_read_parameter(own) for own in identity["space"])
        return Space(parameters, identity["fixed"], identity["base"])
    except (KeyError, TypeError, AttributeError):
        raise UserError(
            f"the record of search {record.get('search')} is damaged: run the search again"
        ) from None


def recorded_search(search: Search, record: Mapping[str, Any]) -> Search:
    """Return a search as it was recorded: what was set beside its file with it.

    Raises:
        UserError: where the file, or what the record sets, is not what was searched.
    """
    identity = record["identity"]
    fixed = to_plain(search.space.fixed)
    over = {key: value for key, value in identity["fixed"].items() if fixed.get(key, ...) != value}
    for key, deed in own_things(over).items():
        raise UserError(
            f"the record of search {search.name} would {deed}: write {key} into [run] of its file"
        )
    if over:
        search = search.with_settings(read_settings(Run, over))
    own = Task(search, Budget(1, tuple(record["seeds"]), record["steps"])).identity
    for key in ("base", "fixed", "space", "objectives"):
        if to_plain(own[key]) != identity[key]:
            raise UserError(
                f"{search.path}: its {key} changed since the search was run; `pneuma search run` again first"
            )
    return search


def to_plain(value: object) -> Any:
    """Return a value as it is read back from JSON."""
    return json.loads(json.dumps(value))


def _read_parameter(own: Mapping[str, Any]) -> Parameter:
    domain = Choices(**own["domain"]) if "settings_of" in own["domain"] else Range(**own["domain"])
    return Parameter(own["name"], domain, {name: tuple(values) for name, values in own["when"].items()})
