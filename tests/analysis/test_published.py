"""Published tables tell nothing of the machine that made them."""

from __future__ import annotations

from pathlib import Path

from pneuma.engines.records import METRIC_COLUMNS
from pneuma.study.measure import stored_row
from pneuma.study.published import Published, encode_published
from pneuma.study.store import Store

from .. import hand_made


def test_the_users_own_files_are_named_without_their_folders(tmp_path: Path) -> None:
    store, run_id = Store(tmp_path), "a0" * 8
    updates = [{**dict.fromkeys(METRIC_COLUMNS, 0.5), "step": 1000}]
    fields = {"seed": 0, "reward": ["/home/me/st/rw.py:f"], "level": "/home/me/isles", "env_module": "a.b"}
    hand_made.save_run(store, run_id, [], updates, [], 1000, "done", fields)
    data = encode_published([stored_row(store, run_id)], {})
    kept = Published(tmp_path / "x.parquet", data).row(run_id).fields
    assert (kept["reward"], kept["level"], kept["env_module"]) == (["rw.py:f"], "isles", "a.b")
