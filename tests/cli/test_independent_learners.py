"""Runs whose players each learn: their tables, policies and curves by the command line; hand-made records."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.engines.policy import Policy
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, LEARNER_COLUMNS, METRIC_COLUMNS
from pneuma.engines.team import Team, policy_files
from pneuma.study.execute import selection_record
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json
from pneuma.study.tables import to_parquet

from .calls import printed, refused

STUDY = """
title = "Two"
base = "table-6-2"
[run]
players = 2
horizon = 64
minibatch = 32
[conditions.shared]
learners = "shared"
[conditions.independent]
learners = "independent"
[presets.quick]
seeds = 1
steps = 1280
"""


def policy(number: int) -> Policy:
    layers = tuple(
        (np.full(shape, number, np.float32), np.zeros(shape[1], np.float32))
        for shape in ((60, 128), (128, 5))
    )
    values = tuple(
        (np.full(shape, number, np.float32), np.zeros(shape[1], np.float32))
        for shape in ((60, 256), (256, 1))
    )
    return Policy("tanh", layers, values)


def files(independent: bool) -> dict[str, bytes]:
    """Slot 0 ends an episode every 64 steps, slot 1 none before step 640; learner 1 loses twice as much."""
    episodes = [(slot, 0, step, float(slot), 1, 1, 0.5, "killed") for step in range(64, 1281, 64) for slot in
                ((0, 1) if step >= 640 else (0,))]  # fmt: skip
    metrics = [{"step": 128, **dict.fromkeys(METRIC_COLUMNS[1:], 1.5)}]
    learners = [{**metrics[0], "learner": k, "value_loss": float(k + 1)} for k in (0, 1)]
    tables: dict[str, tuple[tuple[str, ...], list[dict[str, Any]]]] = {
        "episodes": (EPISODE_COLUMNS, [dict(zip(EPISODE_COLUMNS, row, strict=True)) for row in episodes]),
        "metrics": (METRIC_COLUMNS, metrics),
        "evaluations": (EVALUATION_COLUMNS, [dict.fromkeys(EVALUATION_COLUMNS, 1)]),
        **({"learners": (LEARNER_COLUMNS, learners)} if independent else {}),
    }
    return {f"{name}.parquet": to_parquet(rows, columns) for name, (columns, rows) in tables.items()}


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """One run of each condition, stored."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PNEUMA_RESULTS", "results")
    Path("two.toml").write_text(STUDY)
    plan = make_plan(load_study("two.toml"), Selection(preset="quick"))
    store = Store(Path("results"))
    store.save_selection("two", selection_record(plan))
    for cell in plan.cells:
        own = cell.condition == "independent"
        policies = policy_files(Team((policy(0), policy(1))) if own else policy(0))
        about = {"run.json": run_document(cell.run, cell.run_id), "provenance.json": to_json({})}
        store.save_run(cell.run_id, Status("done", 1280), {**files(own), **policies, **about})
    return plan


def run_ids(plan: Plan) -> dict[str, str]:
    return {cell.condition: cell.run_id for cell in plan.cells}


def exported(*arguments: str) -> list[dict[str, str]]:
    text = printed("study", "export", "two.toml", "--out", "-", "--format", "csv", *arguments)
    return list(csv.DictReader(io.StringIO(text)))


def test_the_table_of_learners_is_of_the_runs_that_have_it(plan: Plan) -> None:
    rows = exported("--table", "learners")
    told = [(row["condition"], row["step"], row["learner"], row["value_loss"]) for row in rows]
    assert told == [("independent", "128", "0", "1.0"), ("independent", "128", "1", "2.0")]
    shared = ("study", "export", "two.toml", "--condition", "shared", "--table", "learners", "--out", "a.csv")
    assert 'no finished run has learners = "independent"' in refused(*shared)


def test_a_curve_begins_when_every_player_has_finished_an_episode(plan: Plan) -> None:
    rows = exported("--table", "curves", "--condition", "shared")
    steps = [float(row["step"]) for row in rows if row["quantity"] == "return" and row["mean"]]
    assert min(steps) == 640  # and it does begin: two players of one slot are two slots of episodes


def test_export_asks_whose_policy(plan: Plan) -> None:
    own, shared = run_ids(plan)["independent"], run_ids(plan)["shared"]
    export = ("run", "export", own, "--out", "a.zip")
    assert "each player has its own policy; choose --player 0 to 1" in refused(*export)
    assert "there is no player 2" in refused(*export, "--player", "2")
    assert not Path("a.zip").exists()
    printed(*export, "--player", "1")
    assert Path("a.zip").exists()
    line = refused("run", "export", shared, "--out", "b.zip", "--player", "0")
    assert f"all players of run {shared} share one policy" in line
