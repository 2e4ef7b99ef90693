"""Rows: the same from a run and from its published table, made again if missing; damage is reported."""

from __future__ import annotations

import builtins
import errno
import json
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pneuma.analysis.outcomes import outcome
from pneuma.analysis.runs import open_study
from pneuma.config import make_run
from pneuma.engines.records import METRIC_COLUMNS
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.published import Published, encode_published
from pneuma.store.row_builder import _rounded, row_until, stored_row
from pneuma.store.rows import decode_row, encode_row
from pneuma.store.series import GRID_POINTS
from pneuma.store.store import ROW_FILE, Status, Store
from pneuma.store.tables import from_ipc
from pneuma.study.plan import Query

from .. import hand_made
from ..engines.trained import constant
from .published_runs import CELLS, outcomes_of, publish, republished, save_run

RUN = "a0" * 8


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    for (_, seed), run_id in CELLS.items():
        save_run(store, run_id, seed)
    return store


# --- One run, one row -------------------------------------------------------------------------------


def test_outcomes_do_not_depend_on_other_runs_budgets(tmp_path: Path) -> None:
    """Of a run alone, and of the same run in a study with one of five times its budget."""
    store = Store(tmp_path / "results")
    save_run(store, RUN, 0)
    alone = hand_made.study_of(store, {("a", 0): RUN})
    outcomes = outcomes_of(alone)
    rows = [{"step": 5000, "return": 1.0}], [{"step": 5000}], [{"step": 5000, "share_killed": 0.5}]
    hand_made.save_run(store, "b0" * 8, *rows, 5000, fields={"steps": 5000})
    together = hand_made.study_of(store, {("a", 0): RUN, ("b", 0): "b0" * 8})
    assert (alone.budget, together.budget) == (1000, 5000)
    assert outcomes_of(together)[: len(outcomes)] == outcomes


# --- A row that is no good --------------------------------------------------------------------------


def _another_schema(data: bytes) -> bytes:
    table, sink = from_ipc(data), pa.BufferOutputStream()
    table = table.set_column(table.schema.get_field_index("end"), "end", pa.array(["1000"]))
    with pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())


BAD: dict[str, Callable[[bytes], bytes]] = {
    "damaged": lambda data: data[:500] + bytes([data[500] ^ 1]) + data[501:],
    "cut short": lambda data: data[:-100],
    "of another schema": _another_schema,
}


@pytest.mark.parametrize("kind", ["missing", *BAD])
def test_a_row_that_is_no_good_is_made_anew_from_its_run(store: Store, kind: str) -> None:
    row, path = stored_row(store, RUN), store.run_folder(RUN) / ROW_FILE
    first = path.read_bytes()
    if kind == "missing":
        path.unlink()
    elif kind == "damaged":
        path.write_bytes(BAD[kind](first))
    else:  # the run's status lists its checksum all the same
        files = {name: store.read_file(RUN, name) for name in store.checksums(RUN)}
        store.save_run(RUN, Status("done", 1000), {**files, ROW_FILE: BAD[kind](first)})
    assert store.status(RUN).finished
    assert stored_row(store, RUN).same_numbers(row)
    assert path.read_bytes() == first == store.read_file(RUN, ROW_FILE)


def test_a_row_whose_run_is_damaged_is_used_and_without_it_nothing_is_made_up(store: Store) -> None:
    first = stored_row(store, RUN)
    (store.run_folder(RUN) / "episodes.parquet").write_bytes(b"damaged")
    assert stored_row(store, RUN).same_numbers(first)
    (store.run_folder(RUN) / ROW_FILE).unlink()
    with pytest.raises(UserError, match="episodes.parquet: missing or damaged"):
        stored_row(store, RUN)


def test_a_folder_on_a_read_only_disk_can_be_read(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs without rows, and a disk that takes nothing: rows are made, and not kept."""
    hand_made.save_listing(store, CELLS)
    written: list[str] = []

    def refuse(*what: Any, **_: Any) -> None:
        written.append(str(what))
        raise OSError(errno.EROFS, "Read-only file system")

    def read_only(file: Any, mode: str = "r", *more: Any, **options: Any) -> Any:
        return refuse(file) if {*mode} & {*"wxa+"} else whole(file, mode, *more, **options)

    whole = open
    monkeypatch.setattr(builtins, "open", read_only)
    for name in ("replace", "link", "mkdir", "unlink"):
        monkeypatch.setattr(os, name, refuse)
    data = open_study(RunIndex(store, shipped=False), Query(study="mine"))
    assert len(data.rows) == 4 and np.isfinite(outcome(data.rows[0], "final-return"))
    assert written and not (store.run_folder(RUN) / ROW_FILE).exists()


# --- Published tables -------------------------------------------------------------------------------


def test_the_same_runs_give_the_same_bytes_and_other_programs_can_read_them(
    store: Store, tmp_path: Path
) -> None:
    """A curve is a list of 200 numbers: at step 50, point 10, a mean of the one episode that ended."""
    path = publish(data := hand_made.study_of(store, CELLS), store)
    again = publish(data, Store(tmp_path / "again"))
    assert path.read_bytes() == again.read_bytes()
    frame = pq.read_table(path).to_pandas()
    assert frame["run_id"].tolist() == [*CELLS.values()]
    assert frame["return budget-5%"][2][9] == pytest.approx(2 / 3, rel=0.01)
    assert len(frame["entropy"][0]) == GRID_POINTS
    assert frame["evaluations"][0][3]["share_killed"] == 4 / 11
    assert json.loads(frame["fields"][1]) == {**hand_made.FIELDS, "seed": 0}


def test_the_users_own_files_are_named_without_their_folders(tmp_path: Path) -> None:
    store = Store(tmp_path)
    updates = [{**dict.fromkeys(METRIC_COLUMNS, 0.5), "step": 1000}]
    fields = {"seed": 0, "reward": ["/home/me/st/rw.py:f"], "level": "/home/me/isles", "env_module": "a.b"}
    hand_made.save_run(store, RUN, [], updates, [], 1000, "done", fields)
    data = encode_published([stored_row(store, RUN)], {})
    published = Published(tmp_path / "x.parquet", data).row(RUN).fields
    assert (published["reward"], published["level"], published["env_module"]) == (["rw.py:f"], "isles", "a.b")


def test_only_the_curves_that_are_named_are_published_but_all_outcomes(store: Store, tmp_path: Path) -> None:
    data = hand_made.study_of(store, CELLS)
    published = republished(data, tmp_path, "entropy")
    assert published.quantities == ["entropy"]
    for name in ("final-return", "median-grad-norm", "max-grad-norm", "mean-kl", "final-share-killed"):
        assert outcome(published.rows[0], name) == outcome(data.rows[0], name), name


def test_rows_of_other_columns_join_in_one_table(store: Store, tmp_path: Path) -> None:
    """Runs of DQN have two columns of evaluations more, and counts may be whole in one row alone."""
    save_run(store, "b0" * 8, 0, valued=True, played=50.5)
    again = republished(data := hand_made.study_of(store, CELLS), tmp_path)
    assert outcomes_of(again) == outcomes_of(data)
    assert all(run.same_numbers(row) for run, row in zip(again.rows, data.rows, strict=True))
    assert "q_estimate" in again.rows[1].evaluations_table.column_names
    assert "q_estimate" not in again.rows[0].evaluations_table.column_names


def test_one_flipped_bit_anywhere_or_a_cut_is_noticed(store: Store) -> None:
    path = publish(hand_made.study_of(store, CELLS), store)
    data = path.read_bytes()
    broken = [
        data[:position] + bytes([data[position] ^ (1 << position % 8)]) + data[position + 1 :]
        for position in range(0, len(data), 5003)
    ]
    for wrong in (*broken, *(data[:size] for size in (0, 1, 100, -1))):
        with pytest.raises(UserError, match="damaged"):
            Published(path, wrong)
        path.write_bytes(wrong)
        index = RunIndex(store, shipped=False)
        assert len(open_study(index, Query(study="mine")).runs) == 4  # all of them are here
        (problem,) = index.problems
        assert problem.startswith(f"{path}: cannot be read (damaged); take it from version control again")


def test_a_curve_over_orders_of_size_is_rounded_in_proportion() -> None:
    values = np.array([np.nan, 0.0, 1e-3, 1.0, 1e6, 3e6])
    rounded = _rounded(values, "entropy")
    assert np.isnan(rounded[0]) and rounded[1:] == pytest.approx(values[1:], rel=1 / 512, abs=0)
    assert _rounded(rounded, "entropy").tolist()[1:] == rounded.tolist()[1:]
    assert _rounded(np.array([-1e-5, 0.25, 1.0]), "return").tolist() == [-1 / 256, 0.25, 1]  # a sign stays
    # a range of 512 has steps of 1, one of 512 and a little steps of 2
    assert _rounded(np.array([-0.5, 5.25, 511.5]), "return").tolist() == [-1, 5, 512]
    assert _rounded(np.array([-0.5, 5.25, 511.5 + 2**-43]), "return").tolist() == [-2, 6, 512]
    for odd in ([-5e-324, 5e-324], [-1e308, 1e308], [-3.0, -3.0], [np.nan, np.inf]):
        assert np.array_equal(_rounded(np.array(odd), "return"), odd, equal_nan=True)


def test_a_row_has_the_checksum_of_its_policy_and_older_tables_lack_it(store: Store, tmp_path: Path) -> None:
    policy = constant([0.0, 1.0, 2.0], 4)
    files = {"policy.safetensors": policy.to_bytes()}
    save_run(store, "b0" * 8, 0, policy_files=files)
    row = stored_row(store, "b0" * 8)
    assert row.policy == policy.checksum
    published = republished(hand_made.study_of(store, CELLS), tmp_path).rows
    assert [run.policy for run in published] == [None, policy.checksum, None, None]
    older_rows = [stored_row(store, run_id) for run_id in ("a0" * 8, "a1" * 8)]
    older = Published(tmp_path / "x.parquet", encode_published(older_rows, {}))
    assert older.row("a0" * 8).policy is None and "policy" not in older.row("a0" * 8).table.column_names
    run = make_run({"steps": 1000})
    assert row_until(store, "b0" * 8, run, 500).policy is None  # the policy is that of the end
    wrong = encode_row({**{name: row.cell(name) for name in row.table.column_names}, "policy": "0" * 15})
    with pytest.raises(ValueError, match="column policy is invalid"):
        decode_row(wrong)


# --- Where a run is in several places ---------------------------------------------------------------


def test_a_published_row_that_contradicts_the_run_is_told_by_name_and_the_run_wins(
    store: Store, tmp_path: Path
) -> None:
    other = Store(tmp_path / "other")
    save_run(other, RUN, 5)
    publish(hand_made.study_of(other, {("a", 0): RUN}, name="elsewhere"), store)
    publish(hand_made.study_of(store, CELLS), store)
    index = RunIndex(store, shipped=False)
    notes: list[str] = []
    hand_made.save_listing(store, CELLS)
    data = open_study(index, Query(study="mine"), say=notes.append)
    path = store.published_path("elsewhere")
    assert notes[1:] == [f"Note: {path}: its run {RUN} has other numbers here; those here are used."]
    assert not any(run.published for run in data.rows)
    assert outcome(data.rows[0], "best-return") == pytest.approx(20 / 3)


def test_a_table_lends_its_runs_to_other_studies_and_their_longer_grid(store: Store, tmp_path: Path) -> None:
    """On the longer grid a point has the last value up to it, and none beyond the run's end."""
    published = republished(hand_made.study_of(store, CELLS), tmp_path)
    longer = replace(published, runs=published.runs.assign(steps=2000))
    for quantity in ("return", "entropy"):
        curve = published.curve(published.rows[0], quantity)
        longer_curve = longer.curve(published.rows[0], quantity)
        np.testing.assert_array_equal(longer_curve, [*curve[1::2], *[np.nan] * 100])


def test_rows_of_a_folder_share_tables_and_keep_all_their_numbers(store: Store) -> None:
    """A table each would take three times the memory. A row that cannot be read is none."""
    save_run(store, "b0" * 8, 0, valued=True, played=50.5)
    index = RunIndex(store, shipped=False)
    run_ids = sorted(index.frame.index)
    alone = [stored_row(store, run_id) for run_id in run_ids]
    (store.run_folder(run_ids[0]) / "run.json").write_text("{}")
    (store.run_folder(run_ids[0]) / ROW_FILE).write_bytes(b"")
    rows = index.rows(run_ids)
    assert rows[0] is None and len(index.problems) == 1
    assert len({id(row.shared_table) for row in rows[1:] if row}) == 1
    for row, same in zip(rows[1:], alone[1:], strict=True):
        assert row and row.run_id == same.run_id and row.same_numbers(same)
        assert row.quantities == same.quantities and row.policy == same.policy
        assert row.table.to_pylist()[0].keys() >= {column for column in same.table.column_names}
        for quantity in row.quantities:
            np.testing.assert_array_equal(row.curve(quantity), same.curve(quantity))
        assert row.evaluations_table.to_pydict() == same.evaluations_table.to_pydict()
