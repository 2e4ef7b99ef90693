"""`pneuma run list | show`, on stored runs whose every figure is known."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import Run, make_run
from pneuma.files import to_json
from pneuma.study.execute import selection_record
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document

from .calls import described, policy_of, printed

ALONE = "00aa000000000000"
"""A run that no study holds."""
ALIKE = "00aa111111111111"
"""Another, with the same first digits."""

MACHINE = {"wall_seconds": 12.5, "packages": {"pneuma": "0.1.0", "torch": "2.13.0"}, "cpu": "A processor"}


def save(store: Store, run_id: str, run: Run) -> None:
    contents = {
        "run.json": run_document(run, run_id),
        "provenance.json": to_json(MACHINE),
        "policy.safetensors": policy_of(run.activation).to_bytes(),
    }
    store.save_run(run_id, Status("done", run.steps), contents)


@pytest.fixture
def plan() -> Plan:
    """Of the activation study, tanh and ReLU, one seed."""
    settings = {"horizon": 64, "episode_steps": 50}
    return make_plan(
        load_study("activation"),
        Selection(seeds=(7,), steps=640, conditions=("tanh", "relu"), settings=settings),
    )


@pytest.fixture
def store(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    """The results of that plan, and two runs of no study."""
    monkeypatch.setenv("PNEUMA_RESULTS", str(tmp_path / "results"))
    store = Store(tmp_path / "results")
    store.save_selection(plan.study.name, selection_record(plan))
    for cell in plan.cells:
        save(store, cell.run_id, cell.run)
    for name in (ALONE, ALIKE):
        save(store, name, make_run({"seed": 3, "steps": 256}))
    return store


# --- list and show ---------------------------------------------------------------------------------


def test_list_tells_studies_first_and_every_run_once(store: Store, plan: Plan, tmp_path: Path) -> None:
    tanh, relu = (cell.run_id for cell in plan.cells)
    assert [line.split()[0] for line in printed("run", "list").splitlines()] == [tanh, relu, ALONE, ALIKE]
    (store.run_folder(ALONE) / "policy.safetensors").unlink()
    documents = {row.pop("run_id"): row for row in described("run", "list", "--json")["runs"]}
    held = [{"study": plan.study.name, "condition": "tanh", "seed": 7}]
    assert documents[tanh] == {"status": "done", "step": 640, "seed": 7, "studies": held}
    assert (documents[ALONE]["status"], documents[ALIKE]["status"]) == ("damaged", "done")
    assert "No run is stored" in printed("run", "list", "--results", tmp_path / "none")


def test_show_says_what_produced_a_run(store: Store, plan: Plan) -> None:
    cell = plan.cells[0]
    every = printed("run", "show", cell.run_id, "--all")
    fields = [line.partition(" = ")[0].strip() for line in every.splitlines() if " = " in line]
    assert sorted(fields) == sorted(Run.__dataclass_fields__)
    document = described("run", "show", cell.run_id, "--json")
    assert make_run(document["settings"]) == cell.run
    assert document["defaults"]["horizon"] == 256 and "gamma" not in document["defaults"]
    assert document["provenance"] == MACHINE
    assert {file["state"] for file in document["files"]} == {"sound"}


def test_show_says_which_file_is_not_what_was_written(store: Store) -> None:
    folder = store.run_folder(ALONE)
    data = bytearray((folder / "run.json").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "run.json").write_bytes(bytes(data))
    (folder / "provenance.json").unlink()
    (folder / "more.txt").write_text("mine")
    document = described("run", "show", ALONE, "--json")
    assert document["status"] == "damaged"
    assert {file["name"]: file["state"] for file in document["files"]} == {
        "run.json": "damaged",
        "provenance.json": "missing",
        "policy.safetensors": "sound",
        "more.txt": "unlisted",
    }
    assert "Fields" in printed("run", "show", ALONE)
