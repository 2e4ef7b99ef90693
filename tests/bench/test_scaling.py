"""Runs that nobody trained are runs to the store, and what is measured on them is what people run."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from pneuma.analysis.run_index import open_study
from pneuma.bench import scaling
from pneuma.bench.synthetic import store_study
from pneuma.errors import UserError
from pneuma.study.store import Store


def test_drawn_runs_are_stored_whole_and_have_what_trained_ones_have(tmp_path: Path) -> None:
    file = tmp_path / f"{scaling.STUDY}.toml"
    file.write_text(scaling._study(seeds=2, conditions=3, steps=2_560), encoding="utf-8")
    told = store_study(file, tmp_path / "results")
    store = Store(tmp_path / "results")
    record = store.selection(scaling.STUDY)
    assert record is not None and told.runs == 6
    assert Counter(store.status(run["run_id"]).name for run in record["runs"]) == {"done": 6}
    data = open_study(store, record)
    rows = {name: len(data.run_table(data.runs[0], name)) for name in data.tables}
    assert rows == {"episodes": 2_560 // 250, "metrics": 2_560 // 256, "evaluations": 20}


@pytest.mark.slow
def test_every_command_is_measured(tmp_path: Path) -> None:
    rows = list(scaling.bench_scaling(runs=8, conditions=2, steps=2_560, folder=tmp_path))
    assert [row["case"] for row in rows] == ["store", *scaling.COMMANDS]
    assert all(row["seconds"] > 0 and row["peak_megabytes"] > 20 for row in rows)
    assert not list(tmp_path.iterdir())


def test_more_seeds_than_a_study_may_have_are_refused_by_the_options_name(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="--runs 100000: more than 10,000 seeds for each of the 8 conditions"):
        next(scaling.bench_scaling(runs=100_000, conditions=8, steps=256, folder=tmp_path))
