"""Tidy tables of a study, and their forms in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.export import encode_table
from pneuma.analysis.sources import open_study
from pneuma.engines.records import EPISODE_COLUMNS
from pneuma.errors import UserError
from pneuma.study.store import Status, Store
from pneuma.study.tables import to_parquet

DONE, DIVERGED, EMPTY, CRASHED, UNKNOWN = "d0" * 8, "d1" * 8, "e0" * 8, "c0" * 8, "f0" * 8


def _episode(episode: int, **values: Any) -> dict[str, Any]:
    row = {"slot": 0, "episode": episode, "step": 50 * (episode + 1), "return": -1.5, "length": 50}
    return {**row, "kills": 0, "hp": 12.0, "ending": "time-limit", **values}


def _record(*runs: tuple[str, int, str]) -> dict[str, Any]:
    settings = {"env": "pneuma/Pneuma-v0", "slots": 1, "steps": 100}
    return {
        "study": "mine",
        "title": "Mine",
        "figure": "fig-mine",
        "same": [],
        "runs": [{"condition": c, "seed": s, "run_id": name, "run": settings} for c, s, name in runs],
    }


def _save(store: Store, run_id: str, status: str, *rows: dict[str, Any]) -> None:
    store.save_run(run_id, Status(status, 100), {"episodes.parquet": to_parquet(rows, EPISODE_COLUMNS)})


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    _save(store, DONE, "done", _episode(0), _episode(1, ending="killed"))
    _save(store, DIVERGED, "diverged", _episode(0, kills=2))
    _save(store, EMPTY, "diverged")
    _save(store, CRASHED, "crashed", _episode(0))
    return store


def test_rows_stand_in_the_selections_order_with_what_they_belong_to(store: Store) -> None:
    frame = open_study(store, _record(("b", 1, DIVERGED), ("a", 0, DONE))).table("episodes")
    assert list(frame.columns) == ["condition", "seed", "run_id", *EPISODE_COLUMNS]
    assert frame[["condition", "seed", "run_id", "episode", "kills"]].to_numpy().tolist() == [
        ["b", 1, DIVERGED, 0, 2],
        ["a", 0, DONE, 0, 0],
        ["a", 0, DONE, 1, 0],
    ]


def test_a_run_without_rows_leaves_the_others_types_alone(store: Store) -> None:
    frame = open_study(store, _record(("a", 0, EMPTY), ("a", 1, DONE))).table("episodes")
    assert len(frame) == 2
    assert {str(frame[name].dtype) for name in ("slot", "episode", "step", "length", "kills")} == {"int64"}


def test_runs_that_are_not_finished_are_left_out(store: Store) -> None:
    record = _record(("a", 0, CRASHED), ("a", 1, DONE), ("a", 2, UNKNOWN))
    assert set(open_study(store, record).table("episodes")["seed"]) == {1}


def test_a_study_without_a_finished_run_is_told(store: Store) -> None:
    record = {**_record(("a", 0, CRASHED)), "path": "/here/mine.toml"}
    told = (
        "no run of this selection of study mine has finished in .*: run `pneuma study run /here/mine.toml` "
    )
    with pytest.raises(UserError, match=told):
        open_study(store, record).table("episodes")


def test_what_has_no_file_is_begun_again_by_its_own_command(store: Store) -> None:
    with pytest.raises(UserError, match="repeat the command that began it first"):
        open_study(store, {**_record(("a", 0, CRASHED)), "study": "fork-abcdef01-64-1a2b"})


def test_a_damaged_table_is_not_read(store: Store) -> None:
    (store.run_folder(DONE) / "episodes.parquet").write_bytes(b"damaged")
    with pytest.raises(UserError):
        open_study(store, _record(("a", 0, DONE))).table("episodes")


@pytest.mark.parametrize("key", ["study", "figure"])
@pytest.mark.parametrize("name", ["../../out", "/tmp/out", "..", "", "a\\b"])
def test_a_record_whose_names_lead_elsewhere_is_refused(store: Store, key: str, name: str) -> None:
    """They become the names of figures and published tables, and the folder may be a stranger's."""
    with pytest.raises(UserError, match=f"names its {key} .* no file name"):
        open_study(store, {**_record(("a", 0, DONE)), key: name})


# --- In a file -----------------------------------------------------------------------------------


def test_a_csv_file_is_what_a_spreadsheet_reads(store: Store) -> None:
    encoded, rows = encode_table(open_study(store, _record(("a,b", 1, DIVERGED))), "episodes", "csv")
    assert rows == 1
    assert encoded == (
        b"condition,seed,run_id,slot,episode,step,return,length,kills,hp,ending\n"
        b'"a,b",1,d1d1d1d1d1d1d1d1,0,0,50,-1.5,50,2,12.0,time-limit\n'
    )


def test_a_latex_table_is_what_latex_reads(store: Store) -> None:
    encoded, _ = encode_table(open_study(store, _record(("50 %_a&b", 1, DIVERGED))), "episodes", "latex")
    assert encoded.decode().splitlines() == [
        r"\begin{tabular}{lrlrrrrrrrl}",  # l for words, r for numbers
        r"\hline",
        r"condition & seed & run\_id & slot & episode & step & return & length & kills & hp & ending \\",
        r"\hline",
        r"50 \%\_a\&b & 1 & d1d1d1d1d1d1d1d1 & 0 & 0 & 50 & -1.5 & 50 & 2 & 12 & time-limit \\",
        r"\hline",
        r"\end{tabular}",
    ]
