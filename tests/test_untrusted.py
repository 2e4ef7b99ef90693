"""Files of a results folder with sound checksums and wrong contents: reading gives a value or one line."""

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
from pneuma.analysis.export import export_records
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.files import checksum
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
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
    table_path = publish(study_of(store, ONE), clone)
    status_path = store.run_folder(RUN) / "status.json"
    record_paths = [path for path in status_path.parent.iterdir() if path != status_path]
    for paths in ([*record_paths, table_path], [status_path], [store.listing_path("mine")]):
        for path in paths:
            path.unlink()
            os.mkfifo(path)
        assert call("study", "summary", "mine", "--results", store.root).code == 2
        assert "damaged" in call("run", "show", RUN, "--results", store.root).out
    assert call("study", "summary", "mine", "--results", clone.root).code == 2
    os.mkfifo(tmp_path / "mine.toml")
    message = call("study", "plan", tmp_path / "mine.toml", "--results", clone.root).err
    assert "mine.toml: cannot be read: is not a regular file" in message


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


BEYOND = f'{{"unit": {2**62}, "signs": {{"fall": [1, 2]}}}}'
STEPS, SHARES = pa.array([500, 1000]), pa.array([0.5, 0.5])


def _evaluations(**columns: pa.Array) -> Callable[[pa.Table], pa.Table]:
    evaluations = pa.StructArray.from_arrays(list(columns.values()), names=list(columns))
    return _put("evaluations", pa.ListArray.from_arrays(pa.array([0, 2], pa.int32()), evaluations))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_put("return last", "x"), "column return last is invalid"),
        (_put("entropy", pa.array([["x"] * 200])), "column entropy is invalid"),
        (_put("signs", "["), "Expecting value: line 1 column 2 (char 1)"),
        (_put("signs", BEYOND), "the steps of the sign fall are not"),
        (_put("signs", '{"unit": 1, "signs": {"fall": [9, -5]}}'), "the steps of the sign fall are not"),
        (lambda table: table.drop_columns(["evaluations"]), "column evaluations is missing"),
        (_put("config_id", pa.array(["x"])), "column config_id is invalid"),
        (_put("steps", pa.array([0])), "column steps is invalid"),
        (_evaluations(a=SHARES), "column evaluations is invalid"),
        (_evaluations(step=STEPS, share_killed=pa.array(["x", "y"])), "column evaluations is invalid"),
        (_evaluations(step=STEPS, share_killed=pa.array([True, True])), "column evaluations is invalid"),
        (_evaluations(step=pa.array([0, float("inf")])), "column evaluations is invalid"),
        (_evaluations(step=pa.nulls(2, pa.int64())), "column evaluations is invalid"),
        (lambda table: table.append_column("policy", pa.array(["x"])), "column policy is invalid"),
        (_put("fields", '{"steps": 1000, "gamma": ["a"]}'), 'gamma = ["a"]'),
        (_put("fields", '{"steps": 1000, "reward": [{"a": 1}]}'), 'reward = [{"a": 1}]'),
        (_put("fields", f'{{"slots": 1{400 * "0"}}}'), f"the number 1{19 * '0'} … is too large"),
        (_put("provenance", '{"wall_seconds": 1e999}'), "the number 1e999 is not finite"),
        (_put("provenance", '{"wall_seconds": NaN}'), "the number NaN is not finite"),
        (_put("provenance", '{"a": ' + 200_000 * "["), "is nested too deeply"),
        (
            _put("signs", f'{{"unit": 1, "signs": {{"fall": [1{400 * "0"}, 1]}}}}'),
            f"the number 1{19 * '0'} … is too large",
        ),
    ],
)
def test_untrusted_an_invalid_row_is_one_line_that_names_its_file(
    store: Store, tmp_path: Path, change: Any, message: str
) -> None:
    """In a run's own folder, whose other files are missing, and in a published table."""
    clone, sink = Store(tmp_path / "clone"), pa.BufferOutputStream()
    _publish_changed(study_of(store, ONE), clone, {}, change)
    row_table = change(from_ipc(store.read_file(RUN, ROW_FILE)))
    with pa.ipc.new_file(sink, row_table.schema) as writer:
        writer.write_table(row_table)
    store.save_run(RUN, Status("done", 1000), {"run.json": b"{}", ROW_FILE: sink.getvalue().to_pybytes()})
    reasons = {store.run_folder(RUN): "KeyError: 'run'", clone.published_path("mine"): message}
    for results, (path, reason) in zip((store, clone), reasons.items(), strict=True):
        index = RunIndex(results, shipped=False)
        with pytest.raises(UserError):
            open_study(index, Query(study="mine"))
        (problem,) = index.problems
        assert problem.startswith(f"{path}: cannot be read ({reason}") and problem.endswith(")")


@pytest.mark.parametrize("letters", [0, 1001])
def test_untrusted_a_damaged_record_of_a_study_is_named(store: Store, letters: int) -> None:
    """A figure with a name of a million letters takes the whole memory."""
    store.listing_path("mine").write_bytes(b"{}")
    if letters:
        save_listing(store, {("a" * letters, 0): RUN})
    with pytest.raises(UserError, match="study mine: the record of its runs is damaged; import it again"):
        open_study(RunIndex(store, shipped=False), Query(study="mine"))


def test_untrusted_a_published_table_of_another_version_is_one_line(store: Store, tmp_path: Path) -> None:
    clone = Store(tmp_path / "clone")
    _publish_changed(study_of(store, ONE), clone, {"schema": 2})
    index = RunIndex(clone, shipped=False)
    with pytest.raises(UserError, match="unknown study 'mine'"):
        open_study(index, Query(study="mine"))
    assert "mine.parquet: cannot be read (of another version of Pneuma); take it from" in index.problems[0]


# --- The working folder ------------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]


def test_untrusted_every_python_that_is_started_leaves_the_working_folder_off_its_path() -> None:
    commands = []
    for path in [*(ROOT / "pneuma").rglob("*.py"), *(ROOT / "studies").rglob("*.py")]:
        commands += re.findall(r"\bsys\.executable\b.{8}", path.read_text())
    assert len(commands) == 2 and all("-P" in command for command in commands), commands
