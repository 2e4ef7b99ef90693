"""`pneuma run list | show | export`, on stored runs whose every figure is known."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.policy import Policy
from pneuma.study.execute import selection_record
from pneuma.study.files import checksum, seal
from pneuma.study.identity import run_id
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json

from .calls import described, printed, refused

ALONE = "00aa000000000000"
"""A run that no study holds."""
ALIKE = "00aa111111111111"
"""Another, with the same first digits."""

MACHINE = {
    "started": "2026-01-02T03:04:05+00:00",
    "wall_seconds": 12.5,
    "threads": 1,
    "python": "3.11.7",
    "packages": {"pneuma": "0.1.0", "torch": "2.13.0"},
    "commit": "0123456789abcdef0123456789abcdef01234567",
    "system": "Linux x86_64",
    "cpu": "A processor",
    "cores": 2,
}


def policy_of(run: Run, features: int = 60) -> Policy:
    generator = np.random.default_rng(0)

    def layer(before: int, after: int) -> tuple[np.ndarray, np.ndarray]:
        shapes = ((before, after), (after,))
        weight, bias = (generator.standard_normal(shape).astype(np.float32) for shape in shapes)
        return weight, bias

    (actor,), (critic,) = run.actor, run.critic
    return Policy(
        run.activation,
        (layer(features, actor), layer(actor, 5)),
        (layer(features, critic), layer(critic, 1)),
    )


def save(store: Store, run_id: str, run: Run, about: Any = MACHINE, **files: bytes) -> None:
    contents = {
        "run.json": run_document(run, run_id),
        "provenance.json": to_json(about),
        "policy.safetensors": policy_of(run).to_bytes(),
    }
    contents |= {name.replace("_", "."): data for name, data in files.items()}
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
    store.save_selection("activation", selection_record(plan))
    for cell in plan.cells:
        save(store, cell.run_id, cell.run)
    for name in (ALONE, ALIKE):
        save(store, name, make_run({"seed": 3, "steps": 256}))
    return store


# --- list ------------------------------------------------------------------------------------------


def test_list_tells_studies_first_and_every_run_once(store: Store, plan: Plan) -> None:
    tanh, relu = (cell.run_id for cell in plan.cells)
    rows = [line.split() for line in printed("run", "list").splitlines()]
    assert rows == [
        [tanh, "done", "640", "steps", "seed", "7", "activation/tanh"],
        [relu, "done", "640", "steps", "seed", "7", "activation/relu"],
        [ALONE, "done", "256", "steps", "seed", "3", "of", "no", "study"],
        [ALIKE, "done", "256", "steps", "seed", "3", "of", "no", "study"],
    ]
    document = described("run", "list", "--json")
    held = [{"study": "activation", "condition": "tanh", "seed": 7}]
    assert document["schema"] == 1
    assert document["runs"][0] == {
        "run_id": tanh, "status": "done", "step": 640, "seed": 7, "studies": held,
    }  # fmt: skip
    assert document["runs"][2]["studies"] == []


def test_a_run_whose_file_is_gone_is_listed_as_damaged(store: Store) -> None:
    (store.run_folder(ALONE) / "policy.safetensors").unlink()
    states = {row["run_id"]: row["status"] for row in described("run", "list", "--json")["runs"]}
    assert (states[ALONE], states[ALIKE]) == ("damaged", "done")


# --- show ------------------------------------------------------------------------------------------


def test_show_says_what_produced_a_run(store: Store, plan: Plan) -> None:
    cell = plan.cells[0]
    shown = " ".join(printed("run", "show", cell.run_id).split())
    for words in (
        f"run {cell.run_id}: done, 640 steps trained",
        "study activation, condition tanh, seed 7",
        "horizon = 64 (default 256)",
        "betas = 0.9, 0.9 (default 0.9, 0.999)",
        "episode_steps = 50 (default 1000)",
        "seed = 7 (default 0)",
        "started 2026-01-02T03:04:05+00:00",
        "wall time 12.5 s",
        "commit 0123456789abcdef0123456789abcdef01234567",
        "machine Linux x86_64, A processor, 2 cores, 1 thread",
        "packages pneuma 0.1.0, torch 2.13.0",
    ):
        assert words in shown
    size = (store.run_folder(cell.run_id) / "policy.safetensors").stat().st_size
    assert f"policy.safetensors {size:,} bytes sound" in shown
    assert "gamma" not in shown  # at its default


def test_the_document_of_show_is_complete(store: Store, plan: Plan) -> None:
    cell = plan.cells[1]
    document = described("run", "show", cell.run_id, "--json")
    assert document["schema"] == 1
    assert make_run(document["settings"]) == cell.run
    changed = ("activation", "betas", "episode_steps", "horizon", "seed", "steps")
    assert sorted(document["defaults"]) == sorted(changed)
    assert document["defaults"]["horizon"] == 256
    assert document["provenance"] == MACHINE
    assert document["studies"] == [{"study": "activation", "condition": "relu", "seed": 7}]
    assert {file["name"]: file["state"] for file in document["files"]} == {
        "run.json": "sound",
        "provenance.json": "sound",
        "policy.safetensors": "sound",
    }


def test_a_run_that_has_not_ended_is_not_called_damaged(store: Store, plan: Plan) -> None:
    run = replace(plan.cells[0].run, seed=11)
    name = run_id(run)
    store.write(store.run_folder(name) / "run.json", run_document(run, name))
    told = printed("run", "show", name)
    assert "damaged" not in told
    assert "No provenance: it is written when a run has ended." in told
    document = described("run", "show", name, "--json")
    assert document["settings"]["seed"] == 11


def test_show_says_which_file_is_not_what_was_written(store: Store) -> None:
    folder = store.run_folder(ALONE)
    data = bytearray((folder / "run.json").read_bytes())
    data[len(data) // 2] ^= 1
    (folder / "run.json").write_bytes(bytes(data))
    (folder / "provenance.json").unlink()
    (folder / "more.txt").write_text("mine")
    document = described("run", "show", ALONE, "--json")
    assert document["status"] == "damaged"
    assert f"run {ALONE}: damaged (run.json)" in printed("run", "show", ALONE)
    assert {file["name"]: file["state"] for file in document["files"]} == {
        "run.json": "damaged",
        "provenance.json": "missing",
        "policy.safetensors": "sound",
        "more.txt": "unlisted",
    }
    name = str(store.root / "secret.json")
    Path(name).write_text("{}")
    files = {"../../secret.json": checksum(b"{}"), name: checksum(b"{}")}
    (folder / "status.json").write_bytes(seal({"status": "done", "step": 256, "files": files}))
    found = {file["name"]: file for file in described("run", "show", ALONE, "--json")["files"]}
    assert {(found[own]["bytes"], found[own]["state"]) for own in files} == {(0, "missing")}


@pytest.mark.parametrize(
    "about", [[], 3, {"packages": 3, "resumes": 5}, {"resumes": [3, {"differences": 4}]}, {"cpu": {}}]
)
def test_nonsense_in_place_of_provenance_is_no_traceback(about: Any, store: Store) -> None:
    save(store, ALONE, make_run({}), about)
    assert ALONE in printed("run", "show", ALONE)


# --- Which run is meant ----------------------------------------------------------------------------


def test_the_first_digits_are_enough(store: Store) -> None:
    assert f"run {ALONE}:" in printed("run", "show", "00aa0")
    assert f"run {ALONE}:" in printed("run", "show", "00AA0")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("00aa", ("more digits", ALONE, ALIKE)),
        ("00aa00000000000f", ("no run '00aa00000000000f'", f"the nearest is {ALONE}")),
        ("../../results", ("no run", "pneuma run list")),
        ("", ("no run ''",)),
    ],
)
@pytest.mark.parametrize("command", [["show"], ["export", "--out", "x.zip"]])
def test_a_run_that_is_not_there_is_one_line(
    command: list[str], name: str, words: tuple[str, ...], store: Store
) -> None:
    line = refused("run", command[0], name, *command[1:])
    for word in words:
        assert word in line


def test_a_zip_in_place_of_a_run_is_refused_with_the_reason(store: Store) -> None:
    line = refused("run", "show", "strangers.ZIP")
    assert "strangers.ZIP" in line and "runs whatever code is pickled in it" in line


# --- export ----------------------------------------------------------------------------------------


def test_export_writes_what_stable_baselines3_loads(store: Store, tmp_path: Path) -> None:
    from stable_baselines3 import PPO

    out = tmp_path / "policy.zip"
    document = described("run", "export", "00aa0", "--out", str(out), "--json")
    assert document == {
        "schema": 1, "run_id": ALONE, "file": str(out), "bytes": out.stat().st_size, "note": "",
    }  # fmt: skip
    observations = np.random.default_rng(1).standard_normal((50, 60)).astype(np.float32)
    chosen, _ = PPO.load(out, device="cpu").predict(observations, deterministic=True)
    np.testing.assert_array_equal(chosen, policy_of(make_run({})).best(observations))


def test_export_writes_onnx(store: Store, tmp_path: Path) -> None:
    onnx = pytest.importorskip("onnx")
    out = tmp_path / "policy.onnx"
    assert f"wrote {out}" in printed("run", "export", ALONE, "--out", str(out))
    about = {each.key: each.value for each in onnx.load(out).metadata_props}
    assert (about["run_id"], about["env"]) == (ALONE, "pneuma/Pneuma-v0")


def test_export_says_when_the_files_of_a_run_were_not_opened(store: Store, tmp_path: Path) -> None:
    run = make_run({"level": "/nowhere/level", "reward": "stranger:reward"})
    save(store, ALONE, run)
    out = tmp_path / "policy.zip"
    shown = printed("run", "export", ALONE, "--out", str(out))
    assert "were not opened" in shown and "--trust" in shown
    out.unlink()
    assert "/nowhere/level" in refused("run", "export", ALONE, "--out", str(out), "--trust")
    assert not out.exists()
    assert "stranger" not in sys.modules


def test_what_has_no_policy_is_not_exported(store: Store, tmp_path: Path) -> None:
    document = run_document(make_run({}), ALONE)
    out = str(tmp_path / "policy.zip")
    store.save_run(ALONE, Status("diverged", 256), {"run.json": document})
    assert "left no policy" in refused("run", "export", ALONE, "--out", out)
    (store.run_folder(ALONE) / "status.json").unlink()
    store.save_run(ALONE, Status("crashed"), {"run.json": document, "error.txt": b"Traceback"})
    assert "is crashed" in refused("run", "export", ALONE, "--out", out)
    assert not Path(out).exists()


def test_a_strangers_policy_that_is_none_is_refused(store: Store, tmp_path: Path) -> None:
    pickled = io.BytesIO(b"\x80\x04cposix\nsystem\n").getvalue()
    save(store, ALONE, make_run({}), policy_safetensors=pickled)
    line = refused("run", "export", ALONE, "--out", str(tmp_path / "policy.zip"))
    assert ALONE in line and "no policy of Pneuma's" in line
    assert not (tmp_path / "policy.zip").exists()


@pytest.mark.parametrize(
    ("settings", "words"), [({}, "no configuration"), ({"gamma": 7}, "gamma = 7"), ([], "no configuration")]
)
def test_a_strangers_configuration_that_is_none_is_refused(
    settings: Any, words: str, store: Store, tmp_path: Path
) -> None:
    save(store, ALONE, make_run({}), run_json=to_json({"schema": 1, "run_id": ALONE, "run": settings}))
    assert ALONE in printed("run", "show", ALONE)
    line = refused("run", "export", ALONE, "--out", str(tmp_path / "policy.zip"))
    assert ALONE in line and words in line
