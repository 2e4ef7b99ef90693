"""Published tables: the same bytes from the same runs, read in place of the runs, and damage noticed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from pneuma.analysis.published import read_published
from pneuma.analysis.publishing import encode_study, rounded

from pneuma.analysis.run_index import RunIndex, open_study
from pneuma.errors import UserError
from pneuma.study.store import Status, Store

from .published_runs import CELLS, RECORD, SETTINGS, save_run


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    for (_, seed), run_id in CELLS.items():
        save_run(store, run_id, seed)
    return store


def _publish(store: Store, record: dict[str, Any] = RECORD, **options: Any) -> Path:
    """Publish what is here, beside what was published before."""
    index = RunIndex(store)
    encoded = encode_study(open_study(index, record, "own"), before=index.table("mine"), **options)
    store.write(store.published_path("mine"), encoded)
    return store.published_path("mine")


def _part(tmp_path: Path, seed: int, before: Store | None = None) -> Store:
    """Return a results folder with the runs of one seed, and what another has published."""
    store = Store(tmp_path / f"seed {seed}")
    for (_, own), run_id in CELLS.items():
        if own == seed:
            save_run(store, run_id, own)
    if before:
        store.write(store.published_path("mine"), before.published_path("mine").read_bytes())
    return store


# --- Bytes ----------------------------------------------------------------------------------------


def test_the_same_runs_give_the_same_bytes_whenever_they_were_trained(store: Store, tmp_path: Path) -> None:
    again = Store(tmp_path / "again")
    for (_, seed), run_id in CELLS.items():
        save_run(again, run_id, seed, started="2021-12-31 and it took longer")
    assert _publish(store).read_bytes() == _publish(again).read_bytes()


def test_other_programs_can_read_it_and_what_produced_a_run_but_no_clock(store: Store) -> None:
    """A curve is a list of 200 numbers: at step 50, point 10, a mean of the one episode that ended."""
    frame = pq.read_table(_publish(store)).to_pandas()
    assert frame["condition"].tolist() == ["a", "b", "a", "b"]
    assert frame["return budget-5%"][2][9] == pytest.approx(2 / 3, rel=0.01)
    assert len(frame["entropy"][0]) == 200
    assert frame["evaluations"][0][3]["share_killed"] == 4 / 11
    assert json.loads(frame["settings"][0]) == SETTINGS
    assert json.loads(frame["provenance"][0]) == {"python": "3.11.7", "commit": "abc"}


def test_a_curve_over_orders_of_size_is_rounded_in_proportion() -> None:
    values = np.array([np.nan, 0.0, 1e-3, 1.0, 1e6, 3e6])
    kept = rounded(values)
    assert np.isnan(kept[0]) and kept[1:] == pytest.approx(values[1:], rel=1 / 512, abs=0)
    assert rounded(kept).tolist()[1:] == kept.tolist()[1:]
    assert rounded(np.array([-1e-5, 0.25, 1.0])).tolist() == [-(2.0**-8), 0.25, 1.0]  # its sign stays
    for odd in ([-5e-324, 5e-324], [-1e308, 1e308], [-3.0, -3.0], [np.nan, np.inf]):
        assert np.array_equal(rounded(np.array(odd)), odd, equal_nan=True)


# --- In place of the runs -------------------------------------------------------------------------


def test_one_flipped_bit_anywhere_is_noticed_where_the_table_is_needed(store: Store) -> None:
    path = _publish(store)
    data = path.read_bytes()
    for place in range(0, len(data), 4001):
        path.write_bytes(data[:place] + bytes([data[place] ^ (1 << place % 8)]) + data[place + 1 :])
        with pytest.raises(UserError, match="mine.parquet: damaged; take it from version control again"):
            read_published(store, "mine")
    for size in (0, 1, 100, -1):
        path.write_bytes(data[:size])
        with pytest.raises(UserError, match="damaged"):
            read_published(store, "mine")
    assert len(open_study(store, RECORD).runs) == 4  # all of them are here
    path.unlink()
    with pytest.raises(UserError, match="mine.parquet: cannot be read"):
        read_published(store, "mine")
    assert store.published(shipped=False) == []


# --- Part by part -----------------------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"curves": ("return",)}])
def test_published_part_by_part_it_is_the_same_to_the_byte(
    store: Store, tmp_path: Path, options: dict[str, Any]
) -> None:
    """Machines that share nothing but the table make the table that one machine makes."""
    _publish(first := _part(tmp_path, 0), **options)
    second = _part(tmp_path, 1, before=first)
    second.save_run("a0" * 8, Status("crashed", 100), {})  # it stays as it was published
    assert _publish(second).read_bytes() == _publish(store, **options).read_bytes()


@pytest.mark.parametrize(
    ("seed", "changed"), [(0, {"valued": True}), (1, {"valued": True}), (1, {"played": 50.5})]
)
def test_evaluations_of_other_columns_join(
    store: Store, tmp_path: Path, seed: int, changed: dict[str, Any]
) -> None:
    """Runs of DQN have two columns more, PPO's in the same table none of them; counts may be whole in one."""
    parts = [_part(tmp_path, own) for own in (0, 1)]
    for to in (parts[seed], store):
        for name in "ab":
            save_run(to, f"{name}{seed}" * 8, seed, **changed)
    before = _publish(parts[0])
    parts[1].write(parts[1].published_path("mine"), before.read_bytes())
    assert _publish(parts[1]).read_bytes() == _publish(store).read_bytes()
