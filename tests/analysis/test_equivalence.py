"""The engines held against each other on written runs: the sign, the smallest p-values, what is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.bench.equivalence import compare_engines
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store

from .claim_files import save_run

STUDY = """\
title = "Both"
base = "table-6-2"
[conditions.alike]
[conditions.apart]
epochs = 5
[presets.quick]
seeds = 5
steps = 1024
"""
SHARES = [0.40, 0.41, 0.42, 0.43, 0.44]


@pytest.fixture
def study(tmp_path: Path) -> str:
    path = tmp_path / "both engines.toml"
    path.write_text(STUDY)
    return str(path)


def save_runs(store: Store, study: str, engine: str, lower: dict[str, float]) -> None:
    for cell in make_plan(load_study(study), Selection(engine=engine)).cells:
        save_run(store, cell.run_id, SHARES[cell.seed] - lower[cell.condition], cell.run.steps)


def test_engines_alike_in_one_condition_and_apart_in_another(study: str, tmp_path: Path) -> None:
    """Of 5 and 5 runs there are 252 relabelings, of which one is as far apart as the seen one."""
    store = Store(tmp_path / "results")
    save_runs(store, study, "batched", {"alike": 0.0, "apart": 0.0})
    save_runs(store, study, "sb3", {"alike": 0.0, "apart": 0.2})
    report = compare_engines(store, study, Selection())
    rows = {(row["condition"], row["outcome"]): row for row in report["rows"]}
    alike, apart = (rows[name, "final-share-killed"] for name in ("alike", "apart"))
    assert alike["means"] == {"batched": pytest.approx(0.42), "sb3": pytest.approx(0.42)}
    assert alike["p_equivalent"] < 0.02 and alike["p_different"] == 1
    assert apart["difference"] == pytest.approx(0.2)  # batched less sb3
    assert apart["p_equivalent"] == 1 and apart["p_different"] == pytest.approx(2 / 252)
    assert apart["p_different_corrected"] == pytest.approx(4 * 2 / 252)
    assert report["seeds"] == 5 and report["steps"] == 1024
