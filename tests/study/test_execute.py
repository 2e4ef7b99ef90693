"""Executing a plan in real worker processes: what they leave behind, and what is trained when.

One tiny study is trained once for the whole module, in two folders by two ways.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from pneuma.analysis.stored_studies import study_record

from pneuma.errors import UserError
from pneuma.study.execute import (
    CellResult,
    OnProgress,
    execute,
    prepare,
)
from pneuma.study.executors.base import Supervision
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store

from .begun import outcome
from .tiny import TINY, tiny_plan


@dataclass(frozen=True)
class Executed:
    """What one call of `execute` was asked and gave."""

    plan: Plan
    store: Store
    results: list[CellResult]
    seeds: list[int]


def _run(plan: Plan, store: Store, workers: int, on_progress: OnProgress) -> list[CellResult]:
    todo = prepare(plan, store)[0]
    return execute(plan, todo, store, Supervision(workers, checkpoint_seconds=0.2), on_progress)


def _execute(plan: Plan, folder: Path, workers: int) -> Executed:
    store, seeds = Store(folder / "results"), list[int]()
    results = _run(plan, store, workers, lambda cell, event: seeds.append(cell.seed))
    return Executed(plan, store, results, seeds)


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> Executed:
    """Seeds 0 and 1, by two workers at once."""
    folder = tmp_path_factory.mktemp("together")
    return _execute(tiny_plan(folder), folder, workers=2)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Executed, Executed]:
    """Seed 1 alone, then seeds 0 and 1, by one worker."""
    folder = tmp_path_factory.mktemp("alone")
    first = _execute(tiny_plan(folder, seeds=(1,), conditions=("one",)), folder, workers=1)
    return first, _execute(tiny_plan(folder, conditions=("one",)), folder, workers=1)


# --- What a run leaves behind ------------------------------------------------------------------------


def test_one_configuration_is_trained_once_for_two_conditions(together: Executed) -> None:
    assert [(own.status.name, own.status.step, own.trained) for own in together.results] == [
        ("done", 256, True)
    ] * 4
    names = [cell.run_id for cell in together.plan.cells]
    assert names[0] == names[1] and names[2] == names[3]
    assert together.store.runs() == sorted({*names})


# --- The same run, the same bits ---------------------------------------------------------------------


def test_a_run_ends_with_the_same_bits_alone_in_company_and_with_any_number_of_workers(
    together: Executed, alone: tuple[Executed, Executed]
) -> None:
    """In the other folder seed 1 was trained alone, and seed 0 by a single worker."""
    files = outcome(together.store.root)
    assert files == outcome(alone[1].store.root)
    assert len({*files.values()}) == len(files) == 2 * 5  # no file is as the other seed's


# --- What is trained, and when -----------------------------------------------------------------------


def test_only_what_is_missing_is_trained(together: Executed, alone: tuple[Executed, Executed]) -> None:
    first, second = alone
    assert [(own.cell.seed, own.trained) for own in first.results] == [(1, True)]
    assert [(own.cell.seed, own.trained) for own in second.results] == [(0, True), (1, False)]
    assert {*second.seeds} == {0}
    again = _run(together.plan, together.store, 2, lambda cell, event: pytest.fail("something happened"))
    assert [(own.status.name, own.trained) for own in again] == [("done", False)] * 4


def test_files_of_one_name_do_not_share_their_records(tmp_path: Path) -> None:
    """The record is kept by the file's name alone, and would show one file's runs for the other's."""
    paths = [tmp_path / folder / "mine.toml" for folder in ("a", "b", "searches", "results/searches")]
    for path in paths:
        path.parent.mkdir(parents=True)
        path.write_text(TINY)
    first, second = (make_plan(load_study(str(path)), Selection()) for path in paths[:2])
    store = Store(tmp_path / "results")
    prepare(first, store)
    prepare(first, store)
    with pytest.raises(UserError, match="are of .*a/mine.toml; give the file another name"):
        prepare(second, store)
    store.check_same_file({"path": str(paths[2])}, paths[3])  # of a search's winners, in a copied folder
    with pytest.raises(UserError, match="are of .*a/mine.toml"):
        study_record(store, str(paths[1]))
    paths[0].rename(tmp_path / "moved.toml")  # or it was this one all along
    prepare(second, store)
    assert study_record(store, str(paths[1]))["path"] == str(paths[1])
