"""Runs that another study has published are taken from its table: a run is the same in every study."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.published import PublishedRuns, published_path, read_published
from pneuma.analysis.published_times import encode_times, times_path
from pneuma.analysis.publishing import encode_study, runs_staying, with_other_studies
from pneuma.analysis.sources import open_study
from pneuma.study.store import Status, Store

from .published_runs import CELLS, RECORD, longer_record, record_of, save_run

EXACT: dict[str, Any] = {}
SMALL: dict[str, Any] = {"curves": ("return", "entropy"), "rounding": True}


def _folder(path: Path, run_ids: list[str]) -> Store:
    store = Store(path)
    for (_, seed), run_id in CELLS.items():
        if run_id in run_ids:
            save_run(store, run_id, seed)
    return store


def _other(path: Path, run_ids: list[str], record: dict[str, Any] = RECORD, **options: Any) -> PublishedRuns:
    """What another study, with conditions of other names, has published of these runs."""
    store = _folder(path, run_ids)
    kept = [run for run in record["runs"] if run["run_id"] in run_ids]
    runs = [{**run, "condition": f"their {run['condition']}"} for run in kept]
    data = open_study(store, {**record_of({}), "study": "other", "runs": runs})
    store.write(published_path(store, "other"), encode_study(data, **options))
    store.write(times_path(store, "other"), encode_times(data))
    return read_published(store, "other")


def _older(table: PublishedRuns) -> PublishedRuns:
    """The same table, as it was before tables told whether they are rounded."""
    table.head = {key: value for key, value in table.head.items() if key != "rounded"}
    return table


@pytest.fixture
def whole(tmp_path: Path) -> Store:
    return _folder(tmp_path / "whole", list(CELLS.values()))


@pytest.mark.parametrize("options", [EXACT, SMALL])
def test_the_table_is_that_of_a_folder_with_all_runs(
    whole: Store, tmp_path: Path, options: dict[str, Any]
) -> None:
    theirs = _other(tmp_path / "theirs", ["a0" * 8, "a1" * 8], **options)
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8, "b1" * 8]), RECORD)
    before = with_other_studies(data, None, [theirs], **options)
    assert runs_staying(data, before) == ["a0" * 8, "a1" * 8]
    assert encode_study(data, **options, published=before) == encode_study(
        open_study(whole, RECORD), **options
    )
    assert before is not None and before.times["a0" * 8]["wall_seconds"] == len("2020-01-01")


def test_what_the_study_has_published_itself_comes_first(whole: Store, tmp_path: Path) -> None:
    """Of three sources each gives what the ones before it lack."""
    own_store = _folder(tmp_path / "own", ["a1" * 8])
    save_run(own_store, "a1" * 8, 1, python="3.12.0")
    own_store.write(published_path(own_store, "mine"), encode_study(open_study(own_store, RECORD)))
    own = read_published(own_store, "mine")
    theirs = _other(tmp_path / "theirs", ["a0" * 8, "a1" * 8, "b0" * 8])
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8, "b1" * 8]), RECORD)
    before = with_other_studies(data, own, [theirs])
    assert before is not None and set(before.finished) == {"a0" * 8, "a1" * 8}
    save_run(whole, "a1" * 8, 1, python="3.12.0")
    assert encode_study(data, published=before) == encode_study(open_study(whole, RECORD))


def test_a_run_that_was_published_unfinished_is_found_where_it_is_finished(
    whole: Store, tmp_path: Path
) -> None:
    part = _folder(tmp_path / "part", ["b0" * 8, "b1" * 8, "a1" * 8])
    part.save_run("a0" * 8, Status("crashed", 100), {})
    data = open_study(part, RECORD)
    part.write(published_path(part, "mine"), encode_study(data))
    theirs = _other(tmp_path / "theirs", ["a0" * 8])
    before = with_other_studies(data, read_published(part, "mine"), [theirs])
    assert runs_staying(data, before) == ["a0" * 8]
    assert encode_study(data, published=before) == encode_study(open_study(whole, RECORD))


ENTROPY = {"curves": ("entropy",)}


@pytest.mark.parametrize(
    ("theirs", "wanted"),
    [(ENTROPY, EXACT), ({"rounding": True}, EXACT), (ENTROPY, {**ENTROPY, "rounding": True})],
)
def test_tables_that_hold_less_or_not_as_exactly_are_passed_over(
    tmp_path: Path, theirs: dict[str, Any], wanted: dict[str, Any]
) -> None:
    other = _other(tmp_path / "theirs", ["a0" * 8], **theirs)
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8]), RECORD)
    assert with_other_studies(data, None, [other], **wanted) is None


def test_a_table_that_holds_more_curves_serves(tmp_path: Path) -> None:
    other = _other(tmp_path / "theirs", ["a0" * 8], rounding=True)
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8]), RECORD)
    before = with_other_studies(data, None, [other], **SMALL)
    both = open_study(_folder(tmp_path / "both", ["a0" * 8, "b0" * 8]), RECORD)
    assert encode_study(data, **SMALL, published=before) == encode_study(both, **SMALL)


@pytest.mark.parametrize("rounding", [False, True])
def test_older_tables_tell_by_their_types_whether_they_are_rounded(tmp_path: Path, rounding: bool) -> None:
    other = _older(_other(tmp_path / "theirs", ["a0" * 8], rounding=rounding))
    assert other.rounds_as(rounding) and not other.rounds_as(not rounding)
    bare = _older(_other(tmp_path / "bare", ["a0" * 8], curves=()))
    assert bare.rounds_as(rounding)


def test_a_table_of_which_nothing_stays_binds_no_one(whole: Store, tmp_path: Path) -> None:
    """Before, the study was published with fewer curves; none of those runs are asked for any more."""
    gone = _folder(tmp_path / "gone", ["a1" * 8])
    before_that = encode_study(open_study(gone, record_of({("a", 1): "a1" * 8})), curves=("entropy",))
    gone.write(published_path(gone, "mine"), before_that)
    fewer = record_of({cell: run_id for cell, run_id in CELLS.items() if cell != ("a", 1)})
    theirs = _other(tmp_path / "theirs", ["a0" * 8])
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8, "b1" * 8]), fewer)
    before = with_other_studies(data, read_published(gone, "mine"), [theirs])
    assert encode_study(data, published=before) == encode_study(open_study(whole, fewer))


def test_a_table_with_more_points_than_its_run_needs_keeps_no_other_from_serving(tmp_path: Path) -> None:
    """Its run is of 2,000 steps and its curves end at 3,000; of the second table both end at 1,000."""
    record = longer_record(1)
    record["runs"][1]["run"]["steps"] = 3000
    longer = _other(tmp_path / "longer", ["b0" * 8, "a1" * 8], record)
    theirs = _other(tmp_path / "theirs", ["a0" * 8])
    ours = longer_record(1)
    ours["runs"] = [run for run in ours["runs"] if run["run_id"] != "b1" * 8]
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8]), ours)
    before = with_other_studies(data, None, [longer, theirs])
    assert runs_staying(data, before) == ["a0" * 8]


def test_a_table_with_other_points_keeps_none_from_being_found(whole: Store, tmp_path: Path) -> None:
    """The first table has the run too, on points of a longer run of its own, and is not taken."""
    longer = _other(tmp_path / "longer", ["a0" * 8, "a1" * 8], longer_record(1))
    theirs = _other(tmp_path / "theirs", ["a0" * 8])
    fewer = record_of({cell: run_id for cell, run_id in CELLS.items() if cell != ("a", 1)})
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8, "b1" * 8]), fewer)
    before = with_other_studies(data, None, [longer, theirs])
    assert encode_study(data, published=before) == encode_study(open_study(whole, fewer))


def test_tables_with_other_points_are_passed_over(tmp_path: Path) -> None:
    """Theirs ends at step 2,000, and the only runs of ours that are anywhere need points up to step 1,000."""
    other = _other(tmp_path / "theirs", ["a0" * 8, "a1" * 8], longer_record(1))
    fewer = record_of({cell: run_id for cell, run_id in CELLS.items() if cell != ("a", 1)})
    data = open_study(_folder(tmp_path / "ours", ["b0" * 8, "b1" * 8]), fewer)
    assert with_other_studies(data, None, [other]) is None
