"""The record of a search: kept while a search is replayed; what is not its shape is not read."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
import pytest

from pneuma.errors import UserError
from pneuma.search.record import (
    known_searches,
    publish_record,
    read_record,
    record_replaced,
    save_record,
)
from pneuma.search.record_shape import are_points
from pneuma.search.recorded import begun_runs, recorded_search
from pneuma.search.spec import Budget
from pneuma.search.trials import Task, make_trial_plan
from pneuma.study.execute import selection_record
from pneuma.study.files import seal
from pneuma.study.plan import Plan
from pneuma.study.store import Store

from .conftest import MakeTask, Solve, flat

Change = Callable[[dict[str, Any]], object]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.check_writable()
    return store


def save(store: Store, task: Task, told: list[Any]) -> dict[str, Any]:
    save_record(store, task, told, "sqlite:///x.db", "x")
    return read_record(store, "formula")


def test_a_replay_loses_nothing(make_task: MakeTask, solve: Solve, store: Store) -> None:
    told = flat(solve(make_task(8)))
    whole = save(store, make_task(8), told)
    assert [save(store, make_task(8), told[:count]) for count in (0, 4, 8)] == [whole] * 3
    assert save(store, make_task(4), told[:4]) == whole
    assert save(store, make_task(12), told[:4]) == {**whole, "trials_asked": 12}


def test_another_search_of_the_name_takes_its_place(make_task: MakeTask, solve: Solve, store: Store) -> None:
    save(store, make_task(8), flat(solve(make_task(8))))
    other = make_task(8, '[sampler]\nname = "random"')
    assert save(store, other, [])["trials"] == []


def test_whoever_puts_another_search_in_its_place_is_told(
    make_task: MakeTask, solve: Solve, store: Store
) -> None:
    assert record_replaced(store, make_task(8), begin_anew=False) == ""
    save(store, make_task(8), flat(solve(make_task(8))))
    assert record_replaced(store, make_task(12), begin_anew=False) == ""
    other = replace(make_task(8), budget=Budget(8, (0, 1), 4096))
    told = record_replaced(store, other, begin_anew=False)
    assert told.startswith("the 8 trials so far had other seeds, steps, and leave the record")


def test_other_versions_put_nothing_in_its_place_unasked(
    make_task: MakeTask, solve: Solve, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    save(store, make_task(8), flat(solve(make_task(8))))
    was = optuna.__version__
    monkeypatch.setattr(optuna, "__version__", "9.9.9")
    with pytest.raises(UserError, match=rf"8 trials \(optuna {was}, now 9.9.9\), .*--replace begins anew"):
        record_replaced(store, make_task(8), begin_anew=False)
    assert "had other optuna, and" in record_replaced(store, make_task(8), begin_anew=True)
    assert len(read_record(store, "formula")["trials"]) == 8


@pytest.mark.parametrize(
    "change",
    [
        lambda r: r.update(trials=[1, 2]),
        lambda r: r.update(trials={}),
        lambda r: r["trials"][0].update(value="\x1b[31mhigh"),
        lambda r: r["trials"][0].update(number=7),
        lambda r: r["trials"][0].update(run_ids=[[]]),
        lambda r: r["trials"][0].pop("note"),
        lambda r: r["trials"][0].update(params={"no such parameter": 1}),
        lambda r: r.update(best=99),
        lambda r: r.update(best=None),
        lambda r: r.update(seeds=5),
        lambda r: r.update(storage=3),
        lambda r: r["identity"].update(objectives=[]),
        lambda r: r["identity"]["objectives"][0].update(over_seeds="most"),
        # what the comments of a promoted study tell must not end one:
        lambda r: r["identity"]["sampler"].update(name='tpe"\nfactors = { evil = 1 }\n#'),
        lambda r: r["trials"][0].update(run_ids=["0123456789abcdef\nevil = 1"]),
        lambda r: r.update(digest="0123456789ab\nevil = 1"),
    ],
)
def test_a_record_of_another_shape_is_damaged(
    make_task: MakeTask, solve: Solve, store: Store, change: Change
) -> None:
    record = save(store, make_task(8), flat(solve(make_task(8))))
    change(record)
    store.write(store.root / "searches" / "formula.json", seal(record))
    with pytest.raises(UserError, match="damaged; `pneuma search run formula` writes it anew"):
        read_record(store, "formula")


def test_a_published_record_is_read_where_the_search_was_not_run(
    make_task: MakeTask, solve: Solve, store: Store, tmp_path: Path
) -> None:
    record = save(store, make_task(8), flat(solve(make_task(8))))
    path = publish_record(store, "formula")
    assert str(tmp_path) not in path.read_text()
    clone = Store(tmp_path / "clone")
    clone.check_writable()
    clone.write(clone.root / "published" / "searches" / path.name, path.read_bytes())
    own = {"path": Path(record["path"]).name, "storage": "", "optuna_study": ""}
    assert read_record(clone, "formula") == {**record, **own}
    assert known_searches(clone) == ["formula"]
    with pytest.raises(UserError, match="is published, and was not run in"):
        publish_record(clone, "formula")
    (clone.root / "published" / "searches" / path.name).write_text(path.read_text().replace("tpe", "cma"))
    with pytest.raises(UserError, match="formula.json: damaged; take it from version control again"):
        read_record(clone, "formula")


def test_what_was_run_here_goes_before_what_is_published(
    make_task: MakeTask, solve: Solve, store: Store
) -> None:
    save(store, make_task(8), flat(solve(make_task(8))))
    publish_record(store, "formula")
    longer = save(store, make_task(12), flat(solve(make_task(12))))
    assert read_record(store, "formula") == longer
    store.write(store.root / "searches" / "formula.json", b"{}")
    with pytest.raises(UserError, match="searches/formula.json: damaged; `pneuma search run"):
        read_record(store, "formula")


def test_a_search_that_has_only_begun_hides_no_published_one(
    make_task: MakeTask, solve: Solve, store: Store
) -> None:
    save(store, make_task(8), flat(solve(make_task(8))))
    publish_record(store, "formula")
    (store.root / "searches" / "formula.json").unlink()
    save_record(store, make_task(8), [], "sqlite:///x.db", "x")
    assert len(read_record(store, "formula")["trials"]) == 8


def test_published_trials_are_gone_on_from_but_not_lost_unasked(
    make_task: MakeTask, solve: Solve, store: Store
) -> None:
    save(store, make_task(8), flat(solve(make_task(8)))[:4])
    with pytest.raises(UserError, match="has 4 of 8 trials; `pneuma search run` it to its end first"):
        publish_record(store, "formula")
    save(store, make_task(8), flat(solve(make_task(8))))
    path = publish_record(store, "formula")
    save(store, make_task(12), flat(solve(make_task(12))))
    publish_record(store, "formula")
    other = make_task(8, '[sampler]\nname = "random"')
    save(store, other, flat(solve(other)))
    longer = path.read_bytes()
    with pytest.raises(UserError, match="holds other trials, or is damaged; --replace"):
        publish_record(store, "formula")
    assert path.read_bytes() == longer
    assert publish_record(store, "formula", replace=True).read_bytes() != longer


def test_a_file_that_changed_is_not_promoted(make_task: MakeTask, solve: Solve, store: Store) -> None:
    task = make_task(8)
    record = save(store, task, flat(solve(task)))
    assert recorded_search(task.search, record) == task.search
    with pytest.raises(UserError, match="its space changed since the search was run"):
        recorded_search(make_task(8, "[space.gamma]\nchoices = [0.9, 0.99]").search, record)


def test_what_was_set_beside_the_file_is_promoted(make_task: MakeTask, solve: Solve, store: Store) -> None:
    task = make_task(8)
    set_ = Task(task.search.with_settings({"gamma": 0.9}), task.budget)
    record = save(store, set_, flat(solve(set_)))
    assert recorded_search(task.search, record).space.fixed == {"gamma": 0.9}
    record["identity"]["fixed"]["reward"] = ["strangers:code"]
    with pytest.raises(UserError, match="would run the reward strangers:code"):
        recorded_search(task.search, record)


def test_a_generation_that_is_begun_is_told(make_task: MakeTask, solve: Solve, store: Store) -> None:
    task, plans = make_task(8), list[Plan]()
    told = flat(solve(task, plans))
    record = save(store, task, told[:4])
    store.save_selection("search-formula", selection_record(make_trial_plan(task, plans[-1].cells)))
    begun = begun_runs(store, json.loads(json.dumps(record)))
    assert (begun.searching, begun.trials, begun.runs, begun.ended) == (False, (4, 5, 6, 7), 8, 0)


@pytest.mark.parametrize(
    "strange", [{}, {"points": 3}, {"points": [{"parameter": "x"}]}, {"points": [], "base": 3}]
)
def test_points_of_another_shape_are_none(strange: dict[str, Any], store: Store) -> None:
    whole = {
        "search": "mine",
        "base": "table-6-2",
        "outcome": "final-return",
        "logarithmic": [],
        "points": [],
    }
    assert are_points(whole)
    if strange:
        assert not are_points({**whole, **strange})
    assert not are_points(strange)
