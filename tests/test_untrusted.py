"""A results folder may be anybody's: whatever a file of it holds, reading gives a value or one line."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pneuma.analysis.collapse import diagnose
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.answers.export import export_records
from pneuma.errors import UserError
from pneuma.files import checksum
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.rows import decode_row
from pneuma.store.store import ROW_FILE, Status, Store
from pneuma.store.tables import from_ipc, from_parquet
from pneuma.study.plan import Query

from .analysis.published_runs import publish, save_run
from .cli.calls import call
from .hand_made import save_listing, study_of

RUN = "a0" * 8
ONE = {("a", 0): RUN}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    save_run(store, RUN, 0)
    save_listing(store, ONE)
    return store


def _change_table(store: Store, name: str, change: Callable[[pa.Table], pa.Table]) -> None:
    """Store the run again with one of its tables changed, under checksums that are right."""
    files = {file: store.read_file(RUN, file) for file in store.checksums(RUN)}
    sink = pa.BufferOutputStream()
    pq.write_table(change(from_parquet(files[f"{name}.parquet"])), sink)
    files[f"{name}.parquet"] = sink.getvalue().to_pybytes()
    store.save_run(RUN, Status("done", 1000), files)


def _put(column: str, value: Any) -> Callable[[pa.Table], pa.Table]:
    """Return a function that puts a value into all cells of a column."""

    def change(table: pa.Table) -> pa.Table:
        cells = value if isinstance(value, pa.Array) else pa.array([value] * len(table))
        return table.set_column(table.column_names.index(column), column, cells)

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("metrics", _put("entropy", "text")),
        ("metrics", lambda table: table.drop_columns(["step"])),
        ("metrics", lambda table: table.append_column("step", table["step"])),
        ("evaluations", _put("step", {"a": 1})),
    ],
)
def test_untrusted_a_checksummed_table_that_makes_no_sense_is_one_line(
    store: Store, name: str, change: Any
) -> None:
    _change_table(store, name, change)
    index = RunIndex(store, shipped=False)
    with pytest.raises(UserError, match="study mine has no finished run in"):
        open_study(index, Query(study="mine"))
    (problem,) = index.problems
    assert problem.startswith(f"{store.run_folder(RUN)}: cannot be read (") and "\n" not in problem


@pytest.mark.parametrize(
    ("name", "change"),
    [("metrics", _put("entropy", float("inf"))), ("metrics", lambda table: table.slice(0, 0)),
     ("episodes", lambda table: table.slice(0, 0)), ("episodes", _put("return", float("nan"))),
     ("evaluations", lambda table: table.slice(0, 0)), ("evaluations", _put("step", -1)),
     ("episodes", _put("slot", 2**62))],
)  # fmt: skip
def test_untrusted_odd_numbers_are_numbers(store: Store, name: str, change: Any) -> None:
    _change_table(store, name, change)
    data = study_of(store, ONE)
    (run,) = data.rows
    assert diagnose(run) is not None
    assert all(isinstance(outcome(run, outcome_name), float) for outcome_name in OUTCOMES)
    assert len(export_records(data, "curves", store).table) and encode_published([run], {})


def test_untrusted_a_pipe_in_the_place_of_a_file_is_not_waited_for(store: Store, tmp_path: Path) -> None:
    clone = Store(tmp_path / "clone")
    table = publish(study_of(store, ONE), clone)
    status = store.run_folder(RUN) / "status.json"
    records = [path for path in status.parent.iterdir() if path != status]
    for paths in ([*records, table], [status], [store.listing_path("mine")]):
        for path in paths:
            path.unlink()
            os.mkfifo(path)
        assert call("study", "summary", "mine", "--results", store.root).code == 2
        assert "damaged" in call("run", "show", RUN, "--results", store.root).out
    assert call("study", "summary", "mine", "--results", clone.root).code == 2


def _publish_changed(
    data: StudyData, store: Store, about: dict[str, Any], change: Callable[[pa.Table], pa.Table] | None = None
) -> None:
    """Publish a study of one run with something changed, under a checksum that is right."""
    path = publish(data, store)
    table = from_parquet(path.read_bytes())
    if change:
        table = change(table)
    about = {**json.loads(table.schema.metadata[b"pneuma"]), **about}
    no_checksum = "sha256:" + "0" * 64
    metadata = {"pneuma": json.dumps(about), "pneuma.checksum": no_checksum}
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata(metadata), sink, compression="none")
    changed = sink.getvalue().to_pybytes()
    store.write(path, changed.replace(no_checksum.encode(), f"sha256:{checksum(changed)}".encode()))


@pytest.mark.parametrize(
    ("about", "change"),
    [({"schema": 2}, None), ({"listing": {"runs": 3}}, None), ({"listing": 3}, None),
     ({}, _put("run_id", "../..")), ({}, _put("status", "planned"))],
)  # fmt: skip
def test_untrusted_a_published_table_that_makes_no_sense_is_one_line(
    store: Store, about: dict[str, Any], change: Any, tmp_path: Path
) -> None:
    clone = Store(tmp_path / "clone")
    _publish_changed(study_of(store, ONE), clone, about, change)
    index = RunIndex(clone, shipped=False)
    with pytest.raises(UserError) as refused:
        open_study(index, Query(study="mine"))
    lines = [str(refused.value), *index.problems]
    assert all("\n" not in line for line in lines) and any("mine" in line for line in lines)
    _publish_changed(study_of(store, ONE), store, about, change)
    assert len(open_study(RunIndex(store, shipped=False), Query(study="mine")).runs) == 1


def _one(values: Any) -> pa.Array:
    """A cell that is a list."""
    return pa.ListArray.from_arrays(pa.array([0, len(values)], pa.int32()), values)


def _evaluations(**columns: pa.Array) -> pa.Array:
    return _one(pa.StructArray.from_arrays([*columns.values()], names=[*columns]))


STEPS, SHARES, TIMES = pa.array([500, 1000]), pa.array([0.5, 0.5]), pa.array([0, 0], pa.timestamp("s"))
ENDLESS, HUGE = pa.array([500, float("inf")]), "1" + 400 * "0"
ODD_CELLS: dict[str, tuple[str, pa.Array]] = {
    "no configuration's id": ("config_id", pa.array(["x"])),
    "no steps": ("steps", pa.array([0])),
    "no end": ("end", pa.nulls(1, pa.int64())),
    "a return of text": ("return last", pa.array(["x"])),
    "a curve of text": ("entropy", _one(pa.array(["x"] * 200))),
    "a curve of lists": ("entropy", _one(pa.array([[1.0]] * 200))),
    "a curve of nothing": ("entropy", _one(pa.nulls(200))),
    "evaluations of nothing": ("evaluations", _evaluations(a=SHARES)),
    "evaluations of text": ("evaluations", _evaluations(step=STEPS, share_killed=pa.array(["x", "y"]))),
    "evaluations of yes": ("evaluations", _evaluations(step=STEPS, share_killed=pa.array([True, True]))),
    "evaluations of times": ("evaluations", _evaluations(step=TIMES, share_killed=SHARES)),
    "evaluations without end": ("evaluations", _evaluations(step=ENDLESS, share_killed=SHARES)),
    "evaluations at no step": ("evaluations", _evaluations(step=pa.nulls(2), share_killed=SHARES)),
    "a list of parents": ("fields", pa.array([json.dumps({"steps": 1000, "parent": ["a"]})])),
    "a table in a list": ("fields", pa.array([json.dumps({"steps": 1000, "reward": [{"a": 1}]})])),
}
for _name, _text in {
    "fields": '{"steps": 1000, "slots": @}', "provenance": '{"wall_seconds": @}',
    "signs": '{"unit": 1, "signs": {"no entropy": [@, 1]}}',
}.items():  # fmt: skip
    for _number in (HUGE, "1e999", "NaN", "["):  # which no run can have, or what is no document
        ODD_CELLS[f"{_name} with {_number[:5]}"] = _name, pa.array([_text.replace("@", _number)])


@pytest.mark.parametrize("kind", ODD_CELLS)
def test_untrusted_a_row_that_makes_no_sense_is_one_line_that_names_its_place(
    store: Store, tmp_path: Path, kind: str
) -> None:
    """In a run's own folder, and in a published table."""
    column, cell = ODD_CELLS[kind]
    clone, change = Store(tmp_path / "clone"), _put(column, cell)
    _publish_changed(study_of(store, ONE), clone, {}, change)
    row, sink = change(from_ipc(store.read_file(RUN, ROW_FILE))), pa.BufferOutputStream()
    with pa.ipc.new_file(sink, row.schema) as writer:
        writer.write_table(row)
    data = sink.getvalue().to_pybytes()
    with pytest.raises(ValueError, match=f"column {column} is invalid"):
        decode_row(data)
    store.save_run(RUN, Status("done", 1000), {"run.json": b"{}", ROW_FILE: data})
    for place, name in ((store, store.run_folder(RUN)), (clone, clone.published_path("mine"))):
        index = RunIndex(place, shipped=False)
        with pytest.raises(UserError):
            open_study(index, Query(study="mine"))
        (problem,) = index.problems
        assert problem.startswith(f"{name}: cannot be read (") and "\n" not in problem


# --- The working folder ------------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]


def test_untrusted_every_python_that_is_started_leaves_the_working_folder_off_its_path() -> None:
    commands = []
    for path in [*(ROOT / "pneuma").rglob("*.py"), *(ROOT / "studies").glob("*.py")]:
        commands += re.findall(r"\bsys\.executable\b.{8}", path.read_text())
    assert len(commands) == 2 and all("-P" in command for command in commands), commands
