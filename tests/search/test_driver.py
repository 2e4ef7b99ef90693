"""What a search is refused for before anything is trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.search import driver
from pneuma.search.driver import check_outcomes, run_search
from pneuma.search.record import lock_folder
from pneuma.study.locks import RunLock
from pneuma.study.store import Store

from .conftest import MakeTask

CMA_ES = '[sampler]\nname = "cma-es"\n'
SECOND = '[objectives.deep]\noutcome = "final-return"'


@pytest.mark.parametrize(("threshold", "least"), [(0.1, 5), (0.0625, 6), (0.01, 8)])
def test_wilcoxon_wants_as_many_seeds_as_can_give_a_trial_up(
    make_task: MakeTask, threshold: float, least: int
) -> None:
    """By hand: before the last of n seeds, n - 1 pairs, whose least p-value is 2^-(n-1)."""
    task = make_task(more=f'[pruner]\nname = "wilcoxon"\nthreshold = {threshold}')
    for seeds in range(2, 12):
        asked = replace(task, budget=replace(task.budget, seeds=tuple(range(seeds))))
        assert (0.5 ** (seeds - 1) < threshold) == (seeds >= least)
        if seeds >= least:
            check_outcomes(asked)
            continue
        with pytest.raises(UserError, match=f"wilcoxon: {seeds} seeds cannot .* it needs {least} at least"):
            check_outcomes(asked)


def test_a_world_that_cannot_be_made_is_refused_before_anything_is_written(
    make_task: MakeTask, tmp_path: Path
) -> None:
    store = Store(tmp_path / "results")
    task = make_task(more='[space.level]\nchoices = ["thesis", "/nowhere"]')
    with pytest.raises(UserError, match="/nowhere"):
        run_search(task, store, None, lambda plan: pytest.fail("trained"), lambda *_: None)
    assert not store.root.exists()


def test_cma_es_wants_one_objective_and_its_package(
    make_task: MakeTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_outcomes(make_task(more=CMA_ES))
    with pytest.raises(UserError, match="sampler cma-es: goes with one objective alone"):
        check_outcomes(make_task(more=CMA_ES, second=SECOND))
    monkeypatch.setattr(driver, "find_spec", lambda name: None)
    with pytest.raises(UserError, match=r"pip install '.\[cmaes\]'"):
        check_outcomes(make_task(more=CMA_ES))
    check_outcomes(make_task())


def test_no_two_processes_search_in_one_folder(make_task: MakeTask, tmp_path: Path) -> None:
    store, task = Store(tmp_path / "results"), make_task()
    with RunLock(lock_folder(store, task.search.name)) as mine:
        assert mine
        with pytest.raises(UserError, match=f"search {task.search.name}: another process searches in .* now"):
            run_search(task, store, None, lambda plan: pytest.fail("trained"), lambda *_: None)
