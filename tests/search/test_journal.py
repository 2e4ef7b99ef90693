"""The log of a search: what Optuna finds in it, what a stopped search goes on with, and what is not read."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from pneuma.errors import UserError
from pneuma.search import trials
from pneuma.search.record import Task, log_path, read_record
from pneuma.search.trials import run_search
from pneuma.store.store import PUBLISHED, Store
from pneuma.study.plan import Plan

from .conftest import Formula, MakeTask, record, solve, task_of, told_of

MEDIAN = '[pruner]\nname = "median"\nn_startup_trials = 2\n'


@pytest.fixture(autouse=True)
def _formula(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trials, "Outcomes", lambda *_: Formula())


class Killed(Exception):
    """The process ends."""


def search(task: Task, store: Store, most: int = 99) -> tuple[list[Any], list[str]]:
    """Run a search, which is killed when it trains once more than `most`; return its trials and notes."""
    ended: list[Any] = []
    notes: list[str] = []
    trained = 0

    def train(plan: Plan, until: Mapping[str, int]) -> None:
        nonlocal trained
        trained += 1
        if trained > most:
            raise Killed

    try:
        for found in run_search(task.search, task.budget, store, train, notes.append):
            ended = told_of(found.trials)[: task.budget.trials]
    except Killed:
        pass
    return ended, [note for note in notes if not note.startswith("trial")]


def load(path: Path, name: str = "formula") -> optuna.Study:
    return optuna.load_study(study_name=name, storage=JournalStorage(JournalFileBackend(str(path))))


def test_optuna_opens_the_log(make_task: MakeTask, store: Store) -> None:
    task = make_task(8, more=MEDIAN)
    told, _ = search(task, store)
    study = load(log_path(store, task.search.label))
    states = {"complete": "COMPLETE", "pruned": "PRUNED", "failed": "FAIL"}
    assert [trial.state.name for trial in study.trials] == [states[each.state] for each in told]
    for trial, each in zip(study.trials, told, strict=True):
        assert (trial.params, trial.value) == (each.params, each.values[0])
        assert trial.intermediate_values == each.reports
        assert tuple(trial.user_attrs["run_ids"]) == each.run_ids
        assert trial.user_attrs["seeds"] == [1000, 1001]
    assert study.best_trial.number == record(task).best


def test_choices_are_values_and_lists_their_text(make_task: MakeTask, store: Store) -> None:
    more = (
        '[space.gradient_limit]\nchoices = [0.5, "none"]\n[space.betas]\nchoices = [[0.9, 0.99], [0.9, 0.9]]'
    )
    task = make_task(8, more)
    told, _ = search(task, store)
    path = log_path(store, task.search.label)
    found = [trial.params for trial in load(path).trials]
    assert found == [trial.params for trial in told]
    assert {params["gradient_limit"] for params in found} == {0.5, None}
    assert {params["betas"] for params in found} == {"[0.9, 0.99]", "[0.9, 0.9]"}


def test_a_search_is_read_as_it_was_searched(make_task: MakeTask, store: Store) -> None:
    when = '[space.gamma]\nlow = 0.8\nhigh = 0.9\nwhen = { betas = [[0.9, 0.9]], activation = "relu" }\n'
    task = make_task(8, more=MEDIAN + when, start='start = ["table-6-1"]')
    settings = {"betas": (0.9, 0.95)}
    task = replace(task, search=task.search.with_settings(settings))
    search(task, store)
    found = read_record(store, task.search.name, "text", settings)
    assert (task_of(found), told_of(found.trials), found.under_way) == (task, solve(task), False)
    with pytest.raises(UserError, match="the search had other fixed.betas than its file or --set has now"):
        read_record(store, "formula", "text")
    make_task(8)  # writes its file anew
    with pytest.raises(UserError, match="the search had other .*space.gamma.* than its file"):
        read_record(store, "formula", "text", settings)
    with pytest.raises(UserError, match="search formula-arena was not run in"):
        read_record(store, "formula")


def test_a_published_log_is_read_where_no_search_was_run(make_task: MakeTask, store: Store) -> None:
    """An empty log, as Optuna leaves it where it finds none, is none."""
    task = make_task(8)
    told, _ = search(task, store)
    own = log_path(store, task.search.label)
    published = store.root / PUBLISHED / f"search-{task.search.label}.log"
    published.parent.mkdir()
    shutil.copy(own, published)
    assert not read_record(store, "formula", "text").published
    own.write_bytes(b"")
    found = read_record(store, "formula", "text")
    assert (found.published, found.journal.path, told_of(found.trials)) == (True, published, told)


RANGE = "[space.gamma]\nlow = 0.8\nhigh = 1.0\n[run]\nhorizon = 64\n"


@pytest.mark.parametrize(
    "kinds",
    [
        MEDIAN,
        '[pruner]\nname = "hyperband"',
        '[sampler]\nname = "nsga-ii"\npopulation_size = 4',
        '[sampler]\nname = "cmaes"\npopsize = 5',
    ],
)
def test_what_samplers_and_pruners_know_outlives_kills(make_task: MakeTask, store: Store, kinds: str) -> None:
    """Killed at every round, and a part of the log's last entry lost each time; nothing of it is a pickle."""
    task = make_task(12, more=RANGE + kinds)
    path = log_path(store, task.search.label)
    for kill in range(6):
        search(task, store, most=2)
        path.write_bytes(path.read_bytes()[: -300 * (kill % 2) or None])
        assert task_of(read_record(store, task.search.name, "text")) == task
    told, notes = search(task, store)
    assert told == solve(task) and not notes
    assert "cma:optimizer" not in path.read_text()


def test_what_has_ended_is_trained_no_more_and_a_longer_search_goes_on(
    make_task: MakeTask, store: Store
) -> None:
    told, _ = search(make_task(8), store)
    assert search(make_task(8), store, most=0)[0] == told
    longer, notes = search(make_task(12), store, most=1)
    assert longer[:8] == told and len(longer) == 12 and not notes
    assert search(make_task(4), store, most=0)[0] == told[:4]
    assert len(read_record(store, make_task().search.name, "text").trials) == 12


def test_another_budget_has_a_log_of_its_own(make_task: MakeTask, store: Store) -> None:
    told, _ = search(make_task(8), store)
    other = replace(make_task(8), budget=make_task(8).budget.model_copy(update={"steps": 4096}))
    for _ in range(2):
        anew, notes = search(other, store)
        assert anew == solve(other) and search(make_task(8), store, most=0)[0] == told
    assert not notes
    found = read_record(store, "formula", "text")
    assert task_of(found) == other and found.journal.path == log_path(store, f"formula-text.{other.digest}")


def test_a_trial_that_another_program_asks_for_is_left_to_it(make_task: MakeTask, store: Store) -> None:
    task = make_task(4)
    search(task, store)
    trial = load(log_path(store, task.search.label)).ask()
    told, _ = search(make_task(12), store)
    assert trial.number == 4 and [each.number for each in told] == [0, 1, 2, 3, *range(5, 12)]


def test_what_optuna_enqueues_is_the_next_trial(make_task: MakeTask, store: Store) -> None:
    """With the other parameters suggested; values outside of the space fail, and say so."""
    search(make_task(4), store)
    study = load(log_path(store, make_task().search.label))
    study.enqueue_trial({"learning_rate": 2e-3})
    study.enqueue_trial({"learning_rate": 9.0})
    study.enqueue_trial({"activation": "sine"})
    told, _ = search(make_task(8), store)
    assert told[4].params["learning_rate"] == 2e-3 and {*told[4].params} == {"learning_rate", "activation"}
    assert [each.state for each in told] == ["complete"] * 5 + ["failed"] * 2 + ["complete"]
    assert told[5].note == "was enqueued with learning_rate = 9.0, which is not in its space"


def test_a_study_that_optuna_began_is_gone_on_with(make_task: MakeTask, store: Store) -> None:
    path = log_path(store, make_task().search.label)
    path.parent.mkdir(parents=True)
    storage = JournalStorage(JournalFileBackend(str(path)))
    study = optuna.create_study(study_name="formula", storage=storage, direction="maximize")
    study.enqueue_trial({"learning_rate": 2e-3, "activation": "relu"})
    with pytest.raises(UserError, match="no trial was begun yet"):
        read_record(store, "formula", "text")
    told, _ = search(make_task(4), store)
    assert told[0].params == {"learning_rate": 2e-3, "activation": "relu"}


def test_a_search_starts_warm_with_the_best_trials_of_another(make_task: MakeTask, store: Store) -> None:
    found = search(make_task(8), store)[0]
    Path("formula.toml").rename("other.toml")
    path = log_path(store, "formula-text")
    path.write_text(path.read_text().replace('"formula"', '"other"'))
    path.rename(path.with_name("other-text.log"))
    told, _ = search(make_task(8, start='warm_start = "other"'), store)
    best = sorted(found, key=lambda trial: -trial.values[0])[:4]
    assert [trial.params for trial in told[:4]] == [trial.params for trial in best]
    with pytest.raises(UserError, match="unknown search 'nothing'"):
        search(make_task(8, start='warm_start = "nothing"\nsampler_seed = 1'), store)


def test_processes_that_search_together_find_what_one_would(make_task: MakeTask, store: Store) -> None:
    """Another one goes on with the same search whenever this one trains."""
    task = make_task(12, more=MEDIAN)
    others: list[list[Any]] = []

    def train(plan: Plan, until: Mapping[str, int]) -> None:
        if len(others) < 5:
            others.append([])
            others[-1] = search(task, store, most=len(others))[0]

    *_, found = run_search(task.search, task.budget, store, train, lambda note: None)
    assert told_of(found.trials) == solve(task)


@pytest.mark.parametrize("method", ["read_early", "read"])
def test_what_another_process_tells_meanwhile_is_not_told_again(
    make_task: MakeTask, store: Store, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    """While one reads the values of a trial, of a pause or its end, another ends the whole search."""
    task, others = make_task(8, more=MEDIAN), list[Any]()
    usual = getattr(Formula, method)

    def read(self: Formula, *asked: Any) -> Any:
        if not others:
            others.append([])
            others[0] = search(task, store)[0]
        return usual(self, *asked)

    monkeypatch.setattr(Formula, method, read)
    assert search(task, store)[0] == others[0] == solve(task)


REFUSED: dict[str, tuple[Callable[[str], str], str]] = {
    "an unknown operation": (lambda log: log + '{"op_code": 99}\n', "damaged"),
    "no operation": (lambda log: log + "[1]\n", "damaged"),
    "no log": (lambda log: "dear diary", "damaged"),
    "a later Optuna": (
        lambda log: log.replace(optuna.__version__, "6.1.0") + '{"op_code": 99, "worker_id": "x"}\n',
        "Optuna 6.1.0 wrote it, which .* cannot read; install that",
    ),
    "another study": (
        lambda log: log.replace('"study_name":"formula"', '"study_name":"mine"'),
        "holds mine, not search formula; move it away",
    ),
    "attributes of anybody": (lambda log: log.replace('"pneuma":{', '"pneuma":"mine","x":{'), "damaged"),
    "trials of before, whose choices were text": (
        lambda log: log.replace("[0.5, null]", '[\\"0.5\\", \\"none\\"]'),
        "trial 0 is outside the search's space",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_log_that_is_not_the_search_s_is_refused_and_kept(
    make_task: MakeTask, store: Store, what: str
) -> None:
    task = make_task(4, '[space.gradient_limit]\nchoices = [0.5, "none"]\n')
    search(task, store)
    path, (change, told) = log_path(store, task.search.label), REFUSED[what]
    path.write_text(changed := change(path.read_text()))
    for use in (lambda: read_record(store, task.search.name, "text"), lambda: search(task, store)):
        with pytest.raises(UserError, match=told):
            use()
    assert path.read_text() == changed


def test_a_pipe_is_no_log_and_is_not_waited_for(make_task: MakeTask, store: Store) -> None:
    path = log_path(store, "formula-text")
    path.parent.mkdir(parents=True)
    os.mkfifo(path)
    with pytest.raises(UserError, match="formula-text.log: cannot be written"):
        search(make_task(4), store)
