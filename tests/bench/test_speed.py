"""The benchmarks of speed: by hand where they reckon, and that they run where they measure."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from pneuma.analysis.run_index import open_study
from pneuma.bench import engines, env, scaling
from pneuma.bench.synthetic import store_study
from pneuma.env.worlds import Worlds
from pneuma.study.store import Store

from ..cli.calls import described, printed


def test_ratios_are_the_medians_of_rounds_and_are_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    """By hand: 10 over 5, 30 over 6 and 24 over 8 steps a second are 2, 5 and 3."""
    monkeypatch.setattr(engines, "CASES", (("small", 10, 512, 256, 3),))
    monkeypatch.setattr(engines, "engine_rates", lambda *_: ([10.0, 30.0, 24.0], [5.0, 6.0, 8.0]))
    monkeypatch.setattr(engines, "worker_rates", lambda: ([2.0, 4.0, 4.0], [3.0, 8.0, 7.0]))
    monkeypatch.setattr(engines, "bench_engines", engines.measure)
    told = described("bench", "engines", "--json")
    case = "small network, 10 runs"
    assert told["ratios"] == {case: 3.0, engines.WORKERS: 1.75}
    assert told["cases"][0] == {"case": case, "engine": "batched", "runs": 10, "steps_per_second": 24.0}
    assert f"{case}: batched over sb3, median of rounds: 3.00\n" in printed("bench", "engines")


@pytest.mark.slow
def test_every_face_is_measured_beside_cartpole(monkeypatch: pytest.MonkeyPatch) -> None:
    start = {"import_seconds": 0.1, "first_step_cold_seconds": 4.0, "first_step_warm_seconds": 0.2}
    monkeypatch.setattr(env, "start_seconds", lambda: start)
    quick = env.bench_env(rounds=1, seconds=0.01)
    monkeypatch.setattr(env, "bench_env", lambda: quick)
    document = described("bench", "env", "--json")
    assert {case["face"] for case in document["cases"]} == {"kernel", "single", "vector", "cartpole"}
    assert all(case["agent_steps_per_second"] > 0 for case in document["cases"])
    assert len(printed("bench", "env").splitlines()) == len(document["cases"]) + 3


def test_worst_case_keeps_every_monster_busy() -> None:
    worlds = Worlds(2)
    worlds.reset()
    env.engage(worlds)
    for _ in range(300):
        worlds.step(np.zeros((2, 1), np.int64) + 4)
        assert (worlds.monsters["noticed"] == 1).all()
    assert (worlds.worlds["ending"] == 0).all() and (worlds.worlds["monsters_left"] == 14).all()


def test_drawn_runs_are_stored_whole_and_have_what_trained_ones_have(tmp_path: Path) -> None:
    file = tmp_path / f"{scaling.STUDY}.toml"
    file.write_text(scaling.study_file(seeds=2, conditions=3, steps=2_560), encoding="utf-8")
    told = store_study(file, tmp_path / "results")
    store = Store(tmp_path / "results")
    record = store.selection(scaling.STUDY)
    assert record is not None and told.runs == 6
    assert Counter(store.status(run["run_id"]).name for run in record["runs"]) == {"done": 6}
    data = open_study(store, record)
    rows = {name: len(data.run_table(data.runs[0], name)) for name in data.tables}
    assert rows == {"episodes": 2_560 // 250, "metrics": 2_560 // 256, "evaluations": 20}


@pytest.mark.slow
def test_what_is_measured_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ours, theirs = engines.engine_rates(
        [engines.engine_run("small", "batched", 0, 256)], engines.engine_run("small", "sb3", 0, 256), 2
    )
    assert len(ours) == len(theirs) == 2 and max(ours) > max(theirs)
    monkeypatch.setattr(engines, "WORKER_ROUNDS", 1)
    monkeypatch.setattr(engines, "WORKER_STEPS", 512)
    one, two = engines.worker_rates()
    assert len(one) == len(two) == 1
    seconds = env.start_seconds(rounds=1)
    assert seconds["first_step_warm_seconds"] < seconds["first_step_cold_seconds"] / 3
    rows = list(scaling.bench_scaling(runs=8, conditions=2, steps=2_560, folder=tmp_path))
    assert [row["case"] for row in rows] == ["store", *scaling.COMMANDS]
    assert not list(tmp_path.iterdir())
