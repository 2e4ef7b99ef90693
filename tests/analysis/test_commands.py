"""`pneuma study collapse`, and exported summaries, over records made by hand."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.study.store import Store

from ..cli.calls import described, printed
from ..hand_made import collapse_record, healthy, learning, one_action, save_collapse


@pytest.fixture
def results(tmp_path: Path) -> Path:
    store = Store(tmp_path / "results")
    cells = {("relu", 0): "a0" * 8, ("relu", 1): "a1" * 8, ("tanh", 0): "b0" * 8, ("tanh", 1): "b1" * 8}
    for own in cells.values():
        save_collapse(store, own, healthy(), learning())
    save_collapse(store, "a1" * 8, one_action(61), learning())
    store.save_selection("mine", collapse_record(cells))
    return store.root


def test_collapse_lists_runs_with_onset_and_signs_and_counts_them(results: Path) -> None:
    document = described("study", "collapse", "mine", "--json", "--results", results)
    assert [run["onset_update"] for run in document["runs"]] == [None, 61, None, None]
    assert [row["collapsed"] for row in document["incidence"]] == [1, 0]


def test_a_spreadsheet_runs_no_name_that_is_exported(tmp_path: Path) -> None:
    store, names = Store(tmp_path / "results"), ("=cmd|' /C calc'!A0", "-2+3", "-0.5", "\x1b]0;a\x07")
    cells = {(name, 0): f"{place:016x}" for place, name in enumerate(names)}
    for own in cells.values():
        save_collapse(store, own, healthy(), learning())
    store.save_selection("mine", collapse_record(cells))
    out = tmp_path / "summary.csv"
    printed("study", "export", "mine", "--table", "summary", "--out", out, "--results", store.root)
    told = dict.fromkeys(line.split(",")[0] for line in out.read_text().splitlines()[1:])
    assert list(told) == ["'=cmd|' /C calc'!A0", "'-2+3", "-0.5", "\\u001b]0;a\\u0007"]
