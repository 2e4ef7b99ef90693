"""The record of a search: what a replay keeps, and what is not read."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pneuma.errors import UserError
from pneuma.search.storage import RecordedSearch, read_record, save_record
from pneuma.search.trials import EndedTrial, Task
from pneuma.study.store import Store

from .conftest import MakeTask, solve


def save(store: Store, task: Task, told: list[EndedTrial]) -> RecordedSearch:
    save_record(store, task, told)
    return read_record(store, task.search.file, "text")


def test_a_search_is_read_as_it_was_searched(make_task: MakeTask, store: Store) -> None:
    when = '[space.gamma]\nlow = 0.8\nhigh = 0.9\nwhen = { betas = [[0.9, 0.9]], activation = "relu" }\n'
    task = make_task(8, more='[pruner]\nname = "median"\n' + when, start='start = ["table-6-1"]')
    over = {"betas": (0.9, 0.95)}
    task = replace(task, search=task.search.with_settings(over), over=over)
    assert save(store, task, solve(task)) == RecordedSearch(task, tuple(solve(task)))
    file = make_task(8).search.file  # writes it anew
    with pytest.raises(UserError, match="the search had other .*space.* than its file has now"):
        read_record(store, file, "text")
    with pytest.raises(UserError, match="search formula-arena was not run in"):
        read_record(store, file)


def test_a_replay_loses_nothing(make_task: MakeTask, store: Store) -> None:
    told = solve(make_task(8))
    whole = save(store, make_task(8), told)
    assert [save(store, make_task(8), told[:count]) for count in (0, 4)] == [whole] * 2
    assert save(store, make_task(4), told[:4]) == whole
