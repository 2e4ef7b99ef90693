"""A results folder from a stranger: nothing in it is run, and nothing leads out of it."""

from __future__ import annotations

import ast
import os
from pathlib import Path

import pytest

import pneuma
from pneuma.errors import UserError
from pneuma.study.files import checksum, seal
from pneuma.study.store import Status, Store

NAME = "0123456789abcdef"
PACKAGE = Path(pneuma.__file__).parent


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.save_run(NAME, Status("done", 512), {"run.json": b"{}\n"})
    return store


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "..", "a/b.json", "", ".lock"])
def test_a_status_that_names_a_file_elsewhere_is_damaged_and_nothing_is_read(
    store: Store, tmp_path: Path, name: str
) -> None:
    secret = b"secret"
    (tmp_path / "results" / "runs" / "secret").write_bytes(secret)
    manifest = {"status": "done", "step": 512, "files": {name: checksum(secret)}}
    (store.run_folder(NAME) / "status.json").write_bytes(seal(manifest))
    assert store.status(NAME).name == "damaged"
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, name)


@pytest.mark.parametrize("name", ["../../elsewhere", "..", "", "0123456789ABCDEF", NAME + "/", NAME + "0"])
def test_what_is_no_run_id_leads_nowhere(store: Store, name: str) -> None:
    with pytest.raises(UserError, match="is no run's id"):
        store.status(name)


def test_a_link_in_a_files_place_is_replaced_and_its_target_left_alone(store: Store, tmp_path: Path) -> None:
    target = tmp_path / "precious"
    target.write_text("mine")
    (store.root / "studies").mkdir()
    for link in (store.root / "studies" / "mine.json", store.run_folder(NAME) / "error.txt"):
        link.symlink_to(target)
    store.save_selection("mine", {"study": "mine", "runs": [], "selection": {}})
    store.save_run(NAME, Status("done", 1024), {"run.json": b"{}\n", "error.txt": b"now a file"})
    assert target.read_text() == "mine"
    assert not (store.root / "studies" / "mine.json").is_symlink()


def test_a_folder_that_is_a_link_out_of_the_results_is_not_written_to(store: Store, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    other = "f" * 16
    (store.root / "runs" / other).symlink_to(elsewhere)
    with pytest.raises(UserError, match="leads out of the results folder"):
        store.save_run(other, Status("done", 1), {"run.json": b"{}\n"})
    assert os.listdir(elsewhere) == []


RUNS_CODE = {"pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal", "yaml"}


OWN_PROCESSES = {"agreement.py"}
"""Modules that pickle what they hand to a process of their own; they read no file."""
MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path.name not in OWN_PROCESSES)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.stem)
def test_no_module_can_unpickle(path: Path) -> None:
    """Nor load what torch pickled: `torch.load` and `PPO.load` are called nowhere."""
    tree = ast.parse(path.read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not {name.split(".")[0] for name in imported} & RUNS_CODE
    calls = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    assert not calls & {"torch.load", "PPO.load", "np.load", "numpy.load", "eval", "exec"}


@pytest.mark.parametrize(
    "change",
    [
        {"files": 5}, {"files": {"run.json": 3}}, {"step": None}, {"step": "text"}, {"status": ["done"]},
        {"status": "well"},
    ],
)  # fmt: skip
def test_a_sealed_status_that_makes_no_sense_is_damage(store: Store, change: dict[str, object]) -> None:
    manifest = {"status": "done", "step": 512, "files": {}, **change}
    (store.run_folder(NAME) / "status.json").write_bytes(seal(manifest))
    assert store.status(NAME).name == "damaged"


@pytest.mark.parametrize(
    "change",
    [
        {"runs": 5}, {"runs": [5]}, {"runs": [{"run_id": "../..", "condition": "a", "seed": 0}]},
        {"runs": [{"run_id": NAME, "condition": 3, "seed": 0}]}, {"selection": None}, {"study": 3},
        {"runs": [{"run_id": NAME, "condition": "a", "seed": "0"}]},
    ],
)  # fmt: skip
def test_a_sealed_record_that_makes_no_sense_is_none(store: Store, change: dict[str, object]) -> None:
    (store.root / "studies").mkdir()
    record = {"study": "a", "runs": [], "selection": {}}
    (store.root / "studies" / "a.json").write_bytes(seal(record))
    assert store.selection("a") is not None
    (store.root / "studies" / "a.json").write_bytes(seal({**record, **change}))
    assert store.selection("a") is None
