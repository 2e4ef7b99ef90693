"""Record tables: rows become Parquet and come back as they were."""

from __future__ import annotations

import math
from typing import Any

from pneuma.study.tables import from_parquet, to_parquet

COLUMNS = ("slot", "episode", "step", "return", "length", "kills", "hp", "ending")


def _row(episode: int, **changes: Any) -> dict[str, Any]:
    row = {"slot": 0, "episode": episode, "step": 10**12, "return": 0.1 + 0.2, "length": 50, "kills": 3}
    return {**row, "hp": 12.0, "ending": "killed", **changes}


def test_rows_come_back_as_they_were_with_the_columns_asked_for() -> None:
    rows = [_row(0), _row(1, ending="time-limit", **{"return": -1e-300}), _row(2, kills=0)]
    table = from_parquet(to_parquet(rows, COLUMNS))
    assert tuple(table.column_names) == COLUMNS
    assert table.to_pylist() == rows
    assert from_parquet(to_parquet([_row(0)], ("ending", "step"))).to_pylist() == [
        {"ending": "killed", "step": 10**12}
    ]
    assert from_parquet(to_parquet([{"length": 20.5}], ("length",))).to_pylist() == [{"length": 20.5}]
    (row,) = from_parquet(to_parquet([_row(0, hp=math.nan)], COLUMNS)).to_pylist()
    assert math.isnan(row["hp"])


def test_the_same_rows_give_the_same_bytes() -> None:
    rows = [_row(episode) for episode in range(100)]
    assert to_parquet(iter(rows), COLUMNS) == to_parquet([dict(row) for row in rows], COLUMNS)
    assert to_parquet(rows, COLUMNS) != to_parquet([*rows[:-1], _row(99, kills=4)], COLUMNS)
