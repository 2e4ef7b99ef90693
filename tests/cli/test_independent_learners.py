"""Runs whose players each learn: their tables, policies and curves by the command line; hand-made records."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest

from pneuma.engines.records import LEARNER_COLUMNS
from pneuma.engines.team import Team, policy_files
from pneuma.study.execute import selection_record
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json
from pneuma.study.tables import to_parquet

from .calls import policy_of, printed, refused

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


@pytest.fixture
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """One run of each condition, stored; of the learners the second loses twice as much."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PNEUMA_RESULTS", "results")
    Path("two.toml").write_text(STUDY)
    plan = make_plan(load_study("two.toml"), Selection(preset="quick"))
    store = Store(Path("results"))
    store.save_selection("two", selection_record(plan))
    update = {**dict.fromkeys(LEARNER_COLUMNS, 1.5), "step": 128}
    learners = [{**update, "learner": k, "value_loss": float(k + 1)} for k in (0, 1)]
    for cell in plan.cells:
        own = cell.condition == "independent"
        files = policy_files(Team((policy_of(), policy_of())) if own else policy_of())
        files |= {"run.json": run_document(cell.run, cell.run_id), "provenance.json": to_json({})}
        if own:
            files["learners.parquet"] = to_parquet(learners, LEARNER_COLUMNS)
        store.save_run(cell.run_id, Status("done", 1280), files)
    return plan


def test_the_table_of_learners_is_of_the_runs_that_have_it(plan: Plan) -> None:
    words = ("study", "export", "two.toml", "--table", "learners", "--out", "-")
    rows = csv.DictReader(io.StringIO(printed(*words)))
    told = [(row["condition"], row["step"], row["learner"], row["value_loss"]) for row in rows]
    assert told == [("independent", "128", "0", "1.0"), ("independent", "128", "1", "2.0")]
    assert 'no finished run has learners = "independent"' in refused(*words, "--condition", "shared")


def test_a_policy_of_a_team_is_not_exported(plan: Plan) -> None:
    _, own = (cell.run_id for cell in plan.cells)
    assert "each player has its own policy" in refused("run", "export", own, "--out", "a.zip")
    assert not Path("a.zip").exists()
