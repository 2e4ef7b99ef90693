"""The record of a search: what a replay keeps, who is kept out, and what is not read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import optuna
import pytest
from optuna.storages.journal import JournalFileBackend

from pneuma.errors import UserError
from pneuma.search.optuna_study import frozen_trials, new_journal
from pneuma.search.storage import Searched, read_record, save_record
from pneuma.search.trials import Task, Told
from pneuma.study.store import Store

from .conftest import MakeTask, solve


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.check_writable()
    return store


def save(store: Store, task: Task, told: list[Told]) -> Searched:
    save_record(store, task, told)
    return read_record(store, "formula")


def test_a_search_is_read_as_it_was_searched(make_task: MakeTask, store: Store) -> None:
    when = '[space.gamma]\nlow = 0.8\nhigh = 0.9\nwhen = { betas = [[0.9, 0.9]], activation = "relu" }\n'
    task = make_task(8, more='[pruner]\nname = "median"\n' + when, start='start = ["table-6-1"]')
    over = {"betas": (0.9, 0.95)}
    task = replace(task, search=task.search.with_settings(over), over=over)
    assert save(store, task, solve(task)) == Searched(task, tuple(solve(task)))
    make_task(8)  # writes the file anew
    with pytest.raises(UserError, match="the search had other .*space.* than its file has now"):
        read_record(store, "formula")


def test_a_replay_loses_nothing(make_task: MakeTask, store: Store) -> None:
    told = solve(make_task(8))
    whole = save(store, make_task(8), told)
    assert [save(store, make_task(8), told[:count]) for count in (0, 4)] == [whole] * 2
    assert save(store, make_task(4), told[:4]) == whole


def test_a_published_record_is_read_where_the_search_was_not_run(
    make_task: MakeTask, store: Store, tmp_path: Path
) -> None:
    whole = save(store, make_task(8), solve(make_task(8)))
    clone = Store(tmp_path / "clone")
    clone.check_writable()
    data = (store.root / "searches" / "formula.json").read_bytes()
    clone.write(clone.root / "published" / "searches" / "formula.json", data)
    assert read_record(clone, "formula") == whole
    save_record(clone, make_task(8), [])  # a search that has only begun hides nothing
    assert read_record(clone, "formula") == whole


def test_optunas_file_holds_the_trials_that_ended_whatever_was_there(
    make_task: MakeTask, tmp_path: Path
) -> None:
    task, path = make_task(8), tmp_path / "formula.journal"
    told = solve(task)
    mine = tmp_path / "thesis.txt"
    mine.write_text("years of work")
    path.symlink_to(mine)
    for _ in range(2):
        study = new_journal(path, task.search)
        study.add_trials(frozen_trials(told, task.search))
    storage = optuna.storages.JournalStorage(JournalFileBackend(str(path)))
    trials = optuna.load_study(study_name=None, storage=storage).trials
    assert [(t.number, t.params, t.values, t.user_attrs["runs"]) for t in trials] == [
        (t.number, dict(t.params), list(t.values), list(t.run_ids)) for t in told
    ]
    assert mine.read_text() == "years of work"
