"""An untrusted results folder: nothing in it is run, and nothing leads out of it."""

from __future__ import annotations

import ast
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save

import pneuma
from pneuma.config import make_run
from pneuma.engines.records import Checkpoint
from pneuma.errors import UserError
from pneuma.files import checksum, dump_checksummed
from pneuma.store.checkpoints import encode, file_name, read_checkpoint
from pneuma.store.last_queries import forget_query
from pneuma.store.store import Identity, Status, Store, checkpoint_files
from pneuma.study.identity import run_id
from pneuma.training.executors import local
from pneuma.training.executors.base import Event, ExecutorConfig, Job

from ..cli.calls import call

NAME = "0123456789abcdef"
LISTED: dict[str, object] = {"run_id": NAME, "condition": "a", "seed": 0}
LISTING: dict[str, object] = {"study": "mine", "title": "Mine", "baseline": "a", "runs": [LISTED]}
PACKAGE = Path(pneuma.__file__).parent


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.save_run(NAME, Status("done", 512), {"run.json": b"{}\n"})
    return store


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", ".lock"])
def test_a_status_that_names_a_file_elsewhere_is_damaged_and_nothing_is_read(
    store: Store, tmp_path: Path, name: str
) -> None:
    secret = b"secret"
    (tmp_path / "results" / "runs" / "secret").write_bytes(secret)
    manifest = {"status": "done", "step": 512, "files": {name: checksum(secret)}}
    (store.run_folder(NAME) / "status.json").write_bytes(dump_checksummed(manifest))
    assert store.status(NAME).name == "damaged"
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, name)


def test_a_link_in_a_files_place_is_replaced_and_its_target_left_alone(store: Store, tmp_path: Path) -> None:
    target = tmp_path / "precious"
    target.write_text("mine")
    (store.root / "studies").mkdir()
    for link in (store.root / "studies" / "mine.json", store.run_folder(NAME) / "error.txt"):
        link.symlink_to(target)
    store.save_listing("mine", LISTING)
    store.save_run(NAME, Status("done", 1024), {"run.json": b"{}\n", "error.txt": b"now a file"})
    assert target.read_text() == "mine"
    assert not (store.root / "studies" / "mine.json").is_symlink()


def test_a_folder_that_is_a_link_out_of_the_results_is_not_written_to(store: Store, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    run_id = "f" * 16
    (store.root / "runs" / run_id).symlink_to(elsewhere)
    with pytest.raises(UserError, match="leads out of the results folder"):
        store.save_run(run_id, Status("done", 1), {"run.json": b"{}\n"})
    with pytest.raises(UserError, match="leads out of the results folder"):
        store.write(store.run_folder(run_id) / "checkpoints" / "one", b"data")
    (store.root / "searches").symlink_to(elsewhere)
    with pytest.raises(UserError, match="leads out of the results folder"):
        store.check_writable()
    assert os.listdir(elsewhere) == []


@pytest.mark.parametrize("folder", ["last", "studies"])
def test_nothing_is_removed_through_a_link_that_leads_out_of_the_results(
    store: Store, tmp_path: Path, folder: str
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine.json").write_text("precious")
    (store.root / folder).symlink_to(elsewhere)
    with pytest.raises(UserError, match="leads out of the results folder"):
        store.remove(store.root / folder / "mine.json")
    if folder == "last":
        with pytest.raises(UserError, match="leads out of the results folder"):
            forget_query(store, "mine", "arena")
    assert (elsewhere / "mine.json").read_text() == "precious"
    store.remove(store.root / folder)
    assert not (store.root / folder).is_symlink() and elsewhere.is_dir()


def test_one_module_alone_removes_what_is_stored() -> None:
    """`files.py` removes the temporary files of its own writing; a video's are outside the results."""
    paths = PACKAGE.rglob("*.py")
    removing = {path.name for path in paths if re.search(r"\b(rmtree|unlink|rmdir)\(", path.read_text())}
    assert removing <= {"store.py", "files.py", "watch.py"}


RUNS_CODE = {"pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal", "yaml"}
UNPICKLES_NOTHING = {
    "tomllib.load", "json.load", "builder.load",  # of a compiled program's memory
    "entry.load", "choice.load", "self.load",  # import from an installed package
}  # fmt: skip


def test_no_module_can_unpickle() -> None:
    """Nor load what torch, NumPy, pandas or an algorithm pickled: only text and safetensors are loaded."""
    for path in PACKAGE.rglob("*.py"):
        tree = [*ast.walk(ast.parse(path.read_text()))]
        imported = {alias.name for node in tree if isinstance(node, ast.Import) for alias in node.names}
        imported |= {node.module or "" for node in tree if isinstance(node, ast.ImportFrom)}
        assert not {name.split(".")[0] for name in imported} & RUNS_CODE, path
        called = [node.func for node in tree if isinstance(node, ast.Call)]
        assert not {"eval", "exec"} & {func.id for func in called if isinstance(func, ast.Name)}, path
        last = [(getattr(func, "attr", getattr(func, "id", "")), func) for func in called]
        loads = {
            ast.unparse(func) for name, func in last if name in ("load", "read_pickle")
        } - UNPICKLES_NOTHING
        assert loads <= ({"load"} if "safetensors.numpy" in imported else set()), path


@pytest.mark.usefixtures("trains_here")
def test_a_run_whose_folder_is_a_link_is_not_trained_into_and_nothing_there_is_swept(
    store: Store, tmp_path: Path
) -> None:
    run, theirs = make_run({"steps": 256}), tmp_path / "theirs"
    theirs.mkdir()
    for name in (".lock", ".netrc.bak"):
        (theirs / name).write_text("mine")
    folder = store.run_folder(run_id(run)) / "checkpoints"
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.symlink_to(theirs)
    events = list[Event]()
    local.train_runs(Job({run_id(run): run}, store, ExecutorConfig()), events.append)
    (end,) = [event for event in events if event["event"] == "end"]
    assert (
        end["status"] == "crashed"
        and "is a link that leads out of the results folder; remove it" in end["reason"]
    )
    assert {path.name: path.read_text() for path in theirs.iterdir()} == {
        ".lock": "mine", ".netrc.bak": "mine",
    }  # fmt: skip


# --- Checkpoints -----------------------------------------------------------------------------------


WHOLE = Checkpoint(64, {"weights": np.arange(3.0)})
HISTORY: dict[str, Any] = {"attempts": []}


@pytest.mark.parametrize(
    "contents",
    [
        b"text",
        save({}),
        save({}, metadata={"pneuma": "{"}),
        encode(WHOLE, HISTORY, NAME).replace(b'\\"schema\\": 1', b'\\"schema\\": 2'),
        encode(WHOLE, HISTORY, "f" * 16),
    ],
)
def test_a_checkpoint_of_another_run_or_version_counts_as_damaged(tmp_path: Path, contents: bytes) -> None:
    path = tmp_path / NAME / "checkpoints" / file_name(64, contents)
    path.parent.mkdir(parents=True)
    path.write_bytes(contents)
    (checkpoint_file,) = checkpoint_files(tmp_path / NAME)
    assert read_checkpoint(checkpoint_file) is None


# --- Code and files that are named -----------------------------------------------------------------


def test_untrusted_texts_cannot_drive_the_terminal(store: Store) -> None:
    wild = "\x1b]0;owned\x07"
    run = {**LISTED, "condition": f"a{wild}", "run_id": "f" * 16}
    store.plan_run("f" * 16, Identity(NAME, 0, 512))
    store.save_listing("mine", {"title": f"T{wild}", "baseline": f"b{wild}", "runs": [run]})
    for words in (["show", "mine"], ["status", "mine"], ["status", "mine", "--condition", "c"]):
        code, out, shown = call("study", *words, "--results", store.root)
        shown += out
        assert (code, "owned" in shown) == (2 if "c" in words else 0, True)
        assert "\x1b" not in shown and "\x07" not in shown
