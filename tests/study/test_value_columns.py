"""Columns that only learners of values have: through files, tables of several runs, and the published one."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.analysis.export import encode_table
from pneuma.analysis.published import published_path
from pneuma.analysis.publishing import encode_study
from pneuma.analysis.run_index import open_published, open_study
from pneuma.engines.base import load_engine
from pneuma.engines.records import EVALUATION_COLUMNS
from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store
from pneuma.study.worker import result_files

STUDY = """
title = "Policies and values"
base = "table-6-2"
[run]
engine = "sb3"
actor = [8]
horizon = 64
evaluation_episodes = 1
episode_steps = 30
[conditions.ppo]
[conditions.dqn]
algorithm = "dqn"
[presets.quick]
seeds = 1
steps = 128
"""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Two runs, stored as a worker does."""
    folder = tmp_path_factory.mktemp("values")
    (folder / "mine.toml").write_text(STUDY, encoding="utf-8")
    store = Store(folder / "results")
    plan = make_plan(load_study(str(folder / "mine.toml")), Selection())
    for cell in plan.cells:
        result = next(load_engine("sb3").train([cell.run], {}, lambda progress: True))
        store.save_run(cell.run_id, Status("done", 128), result_files(result, cell.run_id, {}))
    store.save_selection("mine", selection_record(plan))
    return store


def test_a_table_of_both_is_blank_where_there_are_no_values(store: Store) -> None:
    record = store.selection("mine")
    assert record is not None
    data = open_study(store, record)
    table = data.table("evaluations")
    assert list(table.columns) == ["condition", "seed", "run_id", *EVALUATION_COLUMNS, "q_estimate", "q_true"]
    for condition, blank in (("ppo", True), ("dqn", False)):
        own = table[table["condition"] == condition]
        assert len(own) == 2
        assert own[["q_estimate", "q_true"]].isna().to_numpy().tolist() == [[blank, blank]] * 2
    lines = encode_table(data, "evaluations", "csv")[0].decode().splitlines()
    assert lines[1].endswith(",,")  # of PPO
    assert not lines[-1].endswith(",")


def test_the_published_table_keeps_them(store: Store) -> None:
    record = store.selection("mine")
    assert record is not None
    data = open_study(store, record)
    store.write(published_path(store, "mine"), encode_study(data))
    (again,) = open_published(store.root, ["mine"])
    for name in ("q_estimate", "q_true"):
        np.testing.assert_array_equal(
            again.table("evaluations")[name].to_numpy(), data.table("evaluations")[name].to_numpy()
        )
