"""`pneuma run list | show`, on stored runs whose every figure is known."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import Run, make_run
from pneuma.store.last_queries import note_query
from pneuma.store.store import Store
from pneuma.study.plan import Plan, Query, make_plan
from pneuma.study.spec import load_study

from .. import hand_made
from .calls import described, finish_study, policy_of, printed, save_finished

PACKAGES = {"pneuma": "0.1.0", "torch": "2.13.0"}
MACHINE = {"wall_seconds": 12.5, "python": "3.11", "packages": PACKAGES, "cpu": "A processor"}


@pytest.fixture
def plan() -> Plan:
    """Of the activation study, ReLU, which no other study has, and leaky ReLU, one seed."""
    picked = Query(seeds=(7,), steps=640, conditions=("relu", "leaky-relu"))
    return make_plan(load_study("activation", "text"), picked)


@pytest.fixture
def store(plan: Plan, store: Store, monkeypatch: pytest.MonkeyPatch, unshipped: None) -> Store:
    """The results of that plan."""
    monkeypatch.setenv("PNEUMA_RESULTS", str(store.root))
    for cell in plan.cells:
        save_finished(store, cell.run, **MACHINE)
    note_query(store, plan)
    return store


@pytest.fixture
def alone(store: Store) -> str:
    """A run that no study asks for."""
    run = make_run({"seed": 3, "steps": 256, "horizon": 256, "gamma": 0.123})
    return save_finished(store, run, **MACHINE)


def test_list_has_every_run_once_with_its_studies(
    store: Store, alone: str, plan: Plan, tmp_path: Path
) -> None:
    relu, leaky = (cell.run_id for cell in plan.cells)
    assert [line.split()[0] for line in printed("run", "list").splitlines()] == sorted([relu, leaky, alone])
    (store.run_folder(leaky) / "provenance.json").unlink()
    documents = {row.pop("run_id"): row for row in described("run", "list", "--json")["runs"]}
    held = {"study": "activation", "world": "text", "condition": "relu", "seed": 7}
    document = documents[relu]
    assert (document["status"], document["step"], document["seed"]) == ("done", 640, 7)
    assert held in document["studies"]
    assert documents[alone] == {"status": "done", "step": 256, "seed": 3, "studies": []}
    assert documents[leaky]["status"] == "damaged"
    assert "No run is stored" in printed("run", "list", "--results", tmp_path / "none")
    (run_id,) = finish_study(
        store, world="text", conditions=("relu",), seeds=(7,), steps=256, settings={"gamma": 0.5}
    )
    (own,) = (row for row in described("run", "list", "--json")["runs"] if row["run_id"] == run_id)
    assert [(each["condition"], each["settings"]) for each in own["studies"]] == [("relu", {"gamma": 0.5})]
    assert "activation/relu with gamma = 0.5\n" in printed("run", "list")
    assert "study activation, condition relu with gamma = 0.5, seed 7\n" in printed("run", "show", run_id)


def test_show_prints_what_produced_a_run(store: Store, plan: Plan) -> None:
    cell = plan.cells[0]
    every = printed("run", "show", cell.run_id, "--all")
    fields = [line.partition(" = ")[0].strip() for line in every.splitlines() if " = " in line]
    assert sorted(fields) == sorted(Run.__dataclass_fields__)
    document = described("run", "show", cell.run_id, "--json")
    assert make_run(document["settings"]) == cell.run
    assert document["defaults"]["activation"] == "tanh" and "gamma" not in document["defaults"]
    assert document["provenance"] == MACHINE and document["policy"] is None
    assert {file["state"] for file in document["files"]} == {"sound"}


def test_show_prints_the_checksum_of_a_policy(tmp_path: Path) -> None:
    policy, run_id = policy_of(), "c0" * 8
    files = {"policy.safetensors": policy.to_bytes()}
    hand_made.save_run(Store(tmp_path), run_id, [], [], [], 1000, policy_files=files)
    assert described("run", "show", run_id, "--results", tmp_path, "--json")["policy"] == policy.checksum
    assert f"\npolicy {policy.checksum}\n" in printed("run", "show", run_id, "--results", tmp_path)


def test_show_lists_files_that_are_not_as_written(store: Store, alone: str) -> None:
    folder = store.run_folder(alone)
    data = bytearray((folder / "run.json").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "run.json").write_bytes(bytes(data))
    (folder / "provenance.json").unlink()
    document = described("run", "show", alone, "--json")
    assert document["status"] == "damaged"
    states = {"run.json": "damaged", "provenance.json": "missing", "metrics.parquet": "sound"}
    states_by_file = {file["name"]: file["state"] for file in document["files"]}
    assert states_by_file.items() >= states.items()
    assert "Fields" in printed("run", "show", alone)
