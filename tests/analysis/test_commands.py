"""`pneuma study collapse`, and exported summaries, over records made by hand."""

from __future__ import annotations

from pathlib import Path

from pneuma.study.store import Store

from ..cli.calls import printed
from ..hand_made import collapse_record, healthy, learning, save_collapse


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
