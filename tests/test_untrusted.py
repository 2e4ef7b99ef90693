"""A results folder may be anybody's: whatever a file of it holds, reading gives a value or one line."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from pneuma.analysis.published import NO_SUM, read_published, with_sum
from pneuma.analysis.publishing import encode_study

from pneuma.analysis.collapse import diagnose
from pneuma.analysis.export import encode_table
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.run_index import open_study
from pneuma.doctor import GOOD, examine
from pneuma.errors import UserError
from pneuma.files import read_json, read_whole
from pneuma.study.store import Status, Store
from pneuma.study.tables import from_parquet

from .analysis.published_runs import RECORD, save_run
from .cli.calls import call
from .hand_made import UNLIKE, put_unlike, record_of

RUN = "a0" * 8
ONE = record_of({("a", 0): RUN})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    save_run(store, RUN, 0)
    store.save_selection("mine", ONE)
    return store


@pytest.mark.parametrize("kind", UNLIKE)
def test_untrusted_what_is_no_ordinary_file_is_never_waited_for_nor_read(store: Store, kind: str) -> None:
    folder = store.run_folder(RUN)
    before = store.selection("mine")
    put_unlike(store.root / "studies" / "mine.json", kind)
    assert before and store.selection("mine") is None and read_json(store.selection_path("mine")) is None
    with pytest.raises(OSError):
        read_whole(store.selection_path("mine"))
    put_unlike(folder / "metrics.parquet", kind)
    assert store.status(RUN).name == "damaged"
    store.write(store.published_path("other"), b"")
    put_unlike(store.published_path("other"), kind)
    with pytest.raises(UserError, match="other.parquet: cannot be read"):
        read_published(store, "other")
    put_unlike(folder / ".lock", kind)
    put_unlike(folder / "status.json", kind)
    assert store.status(RUN).name == "damaged"
    for command in (("study", "status", "mine"), ("run", "list"), ("run", "show", RUN)):
        assert call(*command, "--results", store.root).code in (0, 2)


def test_untrusted_a_table_that_unpacks_to_too_much_is_refused_by_its_footer() -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({"step": pa.array(np.zeros(70_000_000, np.int8))}), sink, compression="zstd")
    data = sink.getvalue().to_pybytes()
    assert len(data) < 1_000_000
    with pytest.raises(ValueError, match="unpacks to more than 512 MB"):
        from_parquet(data)
    for broken in (data[:-9], b"", b"PAR1" * 4):
        with pytest.raises(ValueError, match="no table that can be read"):
            from_parquet(broken)


def _swapped(store: Store, name: str, change: Any) -> None:
    """Seal the run again with one of its tables changed."""
    files = {own: store.read_file(RUN, own) for own in store.checksums(RUN)}
    sink = pa.BufferOutputStream()
    pq.write_table(change(from_parquet(files[f"{name}.parquet"])), sink)
    files[f"{name}.parquet"] = sink.getvalue().to_pybytes()
    store.save_run(RUN, Status("done", 1000), files)


def _put(column: str, values: Any) -> Any:
    def change(table: pa.Table) -> pa.Table:
        own = pa.array([values] * len(table)) if not isinstance(values, pa.Array) else values
        return table.set_column(table.column_names.index(column), column, own)

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("metrics", _put("step", "text")),
        ("metrics", _put("entropy", "text")),
        ("metrics", lambda table: table.drop_columns(["step"])),
        ("metrics", lambda table: table.append_column("step", table["step"])),
        ("episodes", _put("slot", 0.5)),
        ("episodes", _put("ending", 3)),
        ("evaluations", _put("step", {"a": 1})),
    ],
)
def test_untrusted_a_sealed_table_that_makes_no_sense_is_one_line(
    store: Store, name: str, change: Any
) -> None:
    _swapped(store, name, change)
    data = open_study(store, ONE)
    with pytest.raises(UserError, match=rf"{name}.parquet: (column|has no column|has two)"):
        encode_study(data)


@pytest.mark.parametrize(
    ("name", "change"),
    [("metrics", _put("action_3", float("nan"))), ("metrics", _put("entropy", float("inf"))),
     ("metrics", lambda table: table.slice(0, 0)), ("episodes", lambda table: table.slice(0, 0)),
     ("episodes", _put("return", float("nan"))), ("evaluations", lambda table: table.slice(0, 0)),
     ("evaluations", _put("step", -1)), ("episodes", _put("slot", 2**62))],
)  # fmt: skip
def test_untrusted_odd_numbers_are_numbers(store: Store, name: str, change: Any) -> None:
    _swapped(store, name, change)
    data = open_study(store, ONE)
    (run,) = data.runs
    assert diagnose(data, run) is not None
    assert all(isinstance(outcome(data, run, own), float) for own in OUTCOMES)
    assert encode_table(data, "curves", "csv") and encode_study(data)


@pytest.mark.parametrize(
    ("head", "column", "values"),
    [({"budget": "much"}, "", None), ({"windows": ["a"]}, "", None), ({"same": 3}, "", None),
     ({}, "run_id", "../.."), ({}, "settings", "[]"), ({}, "settings", "{"), ({}, "signs", "{}"),
     ({}, "end", None), ({}, "entropy", "x"), ({}, "return budget-5%", [[1.0] * 199]),
     ({}, "outcome final-return", None), ({}, "evaluations", [[{"a": 1.0}]])],
)  # fmt: skip
def test_untrusted_a_published_table_that_makes_no_sense_is_one_line(
    store: Store, head: dict[str, Any], column: str, values: Any
) -> None:
    table = from_parquet(encode_study(open_study(store, ONE)))
    told = {**json.loads(table.schema.metadata[b"pneuma"]), **head}
    if column:
        own = pa.array(values if isinstance(values, list) else [values])
        table = table.set_column(table.column_names.index(column), column, own)
    sink = pa.BufferOutputStream()
    metadata = {"pneuma": json.dumps(told), "pneuma.checksum": NO_SUM}
    pq.write_table(table.replace_schema_metadata(metadata), sink, compression="none")
    store.write(store.published_path("mine"), with_sum(sink.getvalue().to_pybytes()))
    with pytest.raises(UserError, match="mine.parquet: is no published table of a study"):
        read_published(store, "mine")
    assert len(open_study(store, ONE).runs) == 1
    with pytest.raises(UserError, match="mine.parquet: is no"):
        open_study(store, RECORD)


# --- The working folder ------------------------------------------------------------------------------

ROOT = Path(__file__).parents[1]


def test_untrusted_every_python_that_is_started_leaves_the_working_folder_off_its_path() -> None:
    started = []
    for path in [*(ROOT / "pneuma").rglob("*.py"), *(ROOT / "studies").glob("*.py")]:
        tree = [*ast.walk(ast.parse(path.read_text()))]
        lists = [[ast.unparse(item) for item in node.elts] for node in tree if isinstance(node, ast.List)]
        started += [own[1] == "'-P'" for own in lists if own and own[0] == "sys.executable"]
        started += ["-P" in ast.unparse(node) for node in tree
                    if isinstance(node, ast.JoinedStr) and "sys.executable" in ast.unparse(node)]  # fmt: skip
    assert len(started) == 4 and all(started)


@pytest.mark.slow
def test_untrusted_the_doctor_imports_nothing_of_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("gymnasium", "numpy"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'mark')!r}, 'w')\n")
    trial = {finding.check: finding.state for finding in examine(tmp_path / "results")}
    assert trial["a trial"] == GOOD and not (tmp_path / "mark").exists()
