"""What is shown of a study that was run in several ways: variants apart, else the amount of most runs."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from pneuma.analysis.stored_studies import study_record

from pneuma.api import open_data
from pneuma.config import ENGINE_VERSIONS
from pneuma.study.execute import prepare
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store

from .calls import call, printed, refused


def _run(store: Store, study: str = "activation", **selection: Any) -> list[str]:
    """Plan and record some of a study as `study run` does, and have its runs end; return their ids."""
    plan = make_plan(load_study(study), Selection(**{"conditions": ("tanh", "relu"), **selection}))
    prepare(plan, store)
    for cell in plan.cells:
        store.save_run(cell.run_id, Status("done", cell.run.steps), {})
    return [cell.run_id for cell in plan.cells]


def _shown(store: Store, name: str, *options: str) -> list[str]:
    told = json.loads(printed("study", "status", name, *options, "--json", "--results", store.root))
    return [run["run_id"] for run in told["runs"]]


def test_a_variant_stands_under_its_own_name_and_beside_its_study(tmp_path: Path) -> None:
    store, changed = Store(tmp_path), {"learning_rate": 0.001}
    plain = _run(store, seeds=(0, 1), steps=512)
    quick = _run(store, seeds=(0, 1), steps=512, settings=changed)
    slow = _run(store, seeds=(0, 1, 2), steps=512, settings={"learning_rate": 1e-5}, variant="slow")
    assert _shown(store, "activation") == plain
    assert _shown(store, "activation+learning_rate=0.001") == quick
    assert _shown(store, "activation+slow") == slow
    head = printed("study", "status", "activation+slow", "--results", store.root)
    assert head.startswith("activation+slow (learning_rate = 1e-05): 6 done")
    again = ("study", "run", "activation", "--set", "gamma=0.5", "--as", "slow", "--results", store.root)
    assert "learning_rate = 1e-05" in refused(*again)
    assert "is a variant" in refused("study", "plan", "activation+slow", "--results", store.root)


def test_most_finished_runs_are_shown_whatever_was_run_last(tmp_path: Path) -> None:
    store = Store(tmp_path)
    first = _run(store, seeds=(0, 1), steps=512)
    other = _run(store, seeds=(0,), steps=1024)
    code, out, told = call("study", "status", "activation", "--results", store.root)
    assert (code, "4 done" in out) == (0, True)
    assert "4 runs of 512 steps. Stored too: 2 runs of 1,024 steps (--steps 1024)" in told
    assert _shown(store, "activation", "--steps", "1024") == other
    assert [run.run_id for run in open_data("activation", tmp_path, steps=1024).runs] == other
    more = _run(store, seeds=(2,), steps=512)
    assert _shown(store, "activation") == [*first, *more]
    record, data = study_record(store, "activation"), open_data("activation", tmp_path)
    assert (record["selection"]["seeds"], record["runs"]) == ([0, 1, 2], data.record["runs"])


def test_runs_of_another_version_are_kept_apart_and_the_latest_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    old = _run(store, seeds=(0, 1), steps=512)
    monkeypatch.setitem(ENGINE_VERSIONS, "batched", 10**6)
    other = _run(store, seeds=(0,), steps=512, conditions=("leaky-relu",))
    assert _shown(store, "activation") == other  # though `old` had no such condition
    new = [*_run(store, seeds=(0,), steps=512), *other]
    assert _shown(store, "activation") == new and not {*old} & {*new}
    told = call("study", "status", "activation", "--results", store.root)[2]
    assert "4 runs of 512 steps with other settings or code" in told


def test_commands_at_the_same_time_record_the_seeds_of_all(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with ThreadPoolExecutor() as pool:
        ids = pool.map(lambda seed: _run(store, seeds=(seed,), steps=512), range(6))
    assert {*_shown(store, "activation")} == {run_id for each in ids for run_id in each}


def test_steps_are_rounded_up_for_the_horizon_of_each_run(tmp_path: Path) -> None:
    picked = Selection(steps=1_000_000)  # 1,000,192 with a horizon of 256, and 1,001,472 with one of 2048
    study, store, both = "hyperparameters", Store(tmp_path), ("table-6-2", "horizon-2048")
    assert len(study_record(store, study, picked, "arena")["runs"]) == 400
    ids = {steps: _run(store, study, seeds=(0,), steps=steps, conditions=both) for steps in (1500, 2000)}
    assert all(_shown(store, study, "--steps", str(steps)) == ids[steps] for steps in ids)
    told = refused("study", "status", study, "--steps", "2049", "--results", store.root)
    assert "has runs of 2,048, 1,536 steps" in told


def test_several_values_of_a_field_make_conditions(tmp_path: Path) -> None:
    study, several = load_study("activation"), {"learning_rate": [1e-4, 3e-4], "betas": [0.9, 0.9]}
    plan = make_plan(study, Selection(seeds=(0,), steps=512, conditions=("relu",), settings=several))
    assert plan.conditions == ("learning_rate=1e-4, relu", "learning_rate=3e-4, relu")
    set_ = [(cell.run.learning_rate, cell.run.betas) for cell in plan.cells]
    assert set_ == [(1e-4, (0.9, 0.9)), (3e-4, (0.9, 0.9))]
    for key, values in {"gradient_limit": "none, 0.5", "reward": "thesis, kills"}.items():
        plan = make_plan(study, Selection(conditions=("relu",), settings={key: values}))
        assert plan.conditions == tuple(f"{key}={value}, relu" for value in values.split(", "))


def test_a_study_that_was_run_in_another_world_alone_is_shown_there(tmp_path: Path) -> None:
    prepare(plan := make_plan(load_study("architecture", "arena"), Selection(steps=512)), Store(tmp_path))
    assert _shown(Store(tmp_path), "architecture") == [cell.run_id for cell in plan.cells]
    assert "no runs" in refused("study", "status", "architecture", "--world", "godot", "--results", tmp_path)


def test_a_study_that_was_run_by_its_path_is_found_by_its_name_and_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, store = tmp_path / "own.toml", Store(tmp_path / "results")
    text = 'title = "Own"\nbase = "table-6-2"\nworlds = ["godot", "arena"]\n[conditions.a]\n'
    file.write_text(text := text + "[presets.quick]\nseeds = 1\nsteps = 512\n")
    plan = make_plan(load_study(str(file)), Selection())
    prepare(plan, store)
    monkeypatch.chdir(tmp_path.parent)
    told = json.loads(printed("study", "plan", "own", "--json", "--results", store.root))
    assert [run["run_id"] for run in told["runs"]] == [plan.cells[0].run_id]
    assert _shown(store, "own", "--world", "godot") == [plan.cells[0].run_id]
    for world in ("text", "arena"):
        assert "no runs" in refused("study", "status", "own", "--world", world, "--results", store.root)
        assert "No study" in printed("study", "status", "--world", world, "--results", store.root)
    file.write_text(text + '[run]\nreward = "theirs:reward"\n')
    assert f"give its file: {file}" in refused("study", "run", "own", "--results", store.root)
