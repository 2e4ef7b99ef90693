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
from pneuma.store.last_queries import last_query
from pneuma.store.store import Identity, Status, Store, checkpoint_files
from pneuma.study.identity import run_id
from pneuma.training.executors import local
from pneuma.training.executors.base import Event, ExecutorConfig, Job

from ..cli.calls import call

NAME = "0123456789abcdef"
LISTED = {"run_id": NAME, "condition": "a", "seed": 0}
LISTING = {"title": "Mine", "baseline": "a", "runs": [LISTED]}
PACKAGE = Path(pneuma.__file__).parent
LEADS_OUT = "leads out of the results folder"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.save_run(NAME, Status("done", 512), {"run.json": b"{}\n"})
    return store


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A folder of the user's outside the results, with a file."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / ".netrc.bak").write_text("precious")
    return folder


# --- Links and names that lead out -------------------------------------------------------------------


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", ".lock"])
def test_a_status_that_names_a_file_elsewhere_is_damaged_and_nothing_is_read(store: Store, name: str) -> None:
    (store.root / "runs" / "secret").write_bytes(b"secret")
    status = {"status": "done", "step": 512, "files": {name: checksum(b"secret")}}
    (store.run_folder(NAME) / "status.json").write_bytes(dump_checksummed(status))
    assert store.status(NAME).name == "damaged"
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, name)


def test_a_link_in_the_place_of_a_file_is_replaced_and_its_target_kept(store: Store, elsewhere: Path) -> None:
    target = elsewhere / ".netrc.bak"
    store.studies.mkdir()
    for link in (store.listing_path("mine"), store.run_folder(NAME) / "error.txt"):
        link.symlink_to(target)
    store.save_listing("mine", LISTING)
    store.save_run(NAME, Status("done", 1024), {"run.json": b"{}\n", "error.txt": b"now a file"})
    assert target.read_text() == "precious" and not store.listing_path("mine").is_symlink()


def test_a_link_is_not_read_even_if_it_leads_to_what_was_written(store: Store, elsewhere: Path) -> None:
    run_file = store.run_folder(NAME) / "run.json"
    kept_path = elsewhere / "run.json"
    run_file.rename(kept_path)
    run_file.symlink_to(kept_path)
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, "run.json")
    store.save_listing("mine", LISTING)
    assert store.listing("mine")
    store.listing_path("mine").rename(elsewhere / "mine.json")
    store.listing_path("mine").symlink_to(elsewhere / "mine.json")
    assert store.listing("mine") is None


def test_nothing_is_written_or_removed_through_a_link_that_leads_out(store: Store, elsewhere: Path) -> None:
    other = "f" * 16
    (store.root / "runs" / other).symlink_to(elsewhere)
    with pytest.raises(UserError, match=LEADS_OUT):
        store.save_run(other, Status("done", 1), {"run.json": b"{}\n"})
    with pytest.raises(UserError, match=LEADS_OUT):
        store.write(store.run_folder(other) / "checkpoints" / "one", b"data")
    with pytest.raises(UserError, match=LEADS_OUT):
        store.remove(store.run_folder(other) / ".netrc.bak")
    (store.root / "searches").symlink_to(elsewhere)
    with pytest.raises(UserError, match=LEADS_OUT):
        store.check_writable()
    assert os.listdir(elsewhere) == [".netrc.bak"]
    store.remove(store.run_folder(other))
    assert not store.run_folder(other).is_symlink() and elsewhere.is_dir()


@pytest.mark.usefixtures("trains_here")
def test_a_run_is_not_trained_into_a_folder_that_is_a_link(store: Store, elsewhere: Path) -> None:
    run, events = make_run({"steps": 256}), list[Event]()
    folder = store.run_folder(run_id(run))
    folder.mkdir()
    (folder / "checkpoints").symlink_to(elsewhere)
    local.train_runs(Job({run_id(run): run}, store, ExecutorConfig()), events.append)
    assert events[-1]["status"] == "crashed" and LEADS_OUT in events[-1]["reason"]
    assert os.listdir(elsewhere) == [".netrc.bak"]


def test_one_module_alone_removes_what_is_stored() -> None:
    """`files.py` removes the temporary files of its own writing; a video's are outside the results."""
    paths = PACKAGE.rglob("*.py")
    removing = {path.name for path in paths if re.search(r"\b(rmtree|unlink|rmdir)\(", path.read_text())}
    assert removing <= {"store.py", "files.py", "watch.py"}


# --- Code --------------------------------------------------------------------------------------------

RUNS_CODE = {"pickle", "cloudpickle", "dill", "joblib", "shelve", "marshal"}
UNPICKLES_NOTHING = {
    "tomllib.load", "json.load", "builder.load",  # of a compiled program's memory
    "entry.load", "choice.load", "self.load",  # import from an installed package
}  # fmt: skip


def test_no_module_can_unpickle() -> None:
    """Nor load what torch, NumPy, pandas or an algorithm pickled: only text and safetensors are loaded."""
    for path in PACKAGE.rglob("*.py"):
        imported, loaded = set[str](), set[str]()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(node.module or "")
            elif isinstance(node, ast.Call):
                function = ast.unparse(node.func)
                assert function not in ("eval", "exec"), path
                if re.search(r"\b(load|read_pickle)$", function):
                    loaded.add(function)
        assert not {name.split(".")[0] for name in imported} & RUNS_CODE, path
        allowed = {"load"} if "safetensors.numpy" in imported else set()
        if path.match("imports/zoo.py"):
            allowed.add("yaml.load")
            assert "class _Loader(yaml.SafeLoader):" in path.read_text()
        assert loaded - UNPICKLES_NOTHING <= allowed, path


# --- Contents ----------------------------------------------------------------------------------------


def test_documents_with_wrong_types_and_sound_checksums_are_damaged_or_none(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    status_path, listing_path = store.run_folder(NAME) / "status.json", store.listing_path("mine")
    change: Any
    for change in ({"files": 5}, {"files": {"run.json": 3}}, {"step": "text"}, {"config_id": 3}):
        status = {"status": "done", "step": 512, "files": {}, **change}
        status_path.write_bytes(dump_checksummed(status))
        assert store.status(NAME).name == "damaged", change
    store.save_listing("mine", LISTING)
    assert store.listing("mine") is not None
    store.last_path("mine").parent.mkdir()
    store.last_path("mine").write_bytes(dump_checksummed({"arena": {"preset": 3}}))
    assert last_query(store, "mine", "arena") is None
    for change in ({"runs": [5]}, {"runs": [{**LISTED, "run_id": "../.."}]}, {"study": "../a"}, {"title": 3}):
        listing_path.write_bytes(dump_checksummed({"study": "mine", **LISTING, **change}))
        assert store.listing("mine") is None, change
    with monkeypatch.context() as another_version:
        another_version.setattr("pneuma.files.SCHEMA", 2)
        store.save_listing("mine", LISTING)
    assert store.listing("mine") is None


CHECKPOINT = Checkpoint(64, {"weights": np.arange(3.0)})
HISTORY: dict[str, Any] = {"attempts": []}


@pytest.mark.parametrize(
    "contents",
    [
        b"text",
        save({}),
        encode(CHECKPOINT, HISTORY, NAME).replace(b'\\"schema\\": 1', b'\\"schema\\": 2'),
        encode(CHECKPOINT, HISTORY, "f" * 16),
    ],
)
def test_a_checkpoint_of_another_run_or_version_counts_as_damaged(tmp_path: Path, contents: bytes) -> None:
    path = tmp_path / NAME / "checkpoints" / file_name(64, contents)
    path.parent.mkdir(parents=True)
    path.write_bytes(contents)
    (checkpoint_file,) = checkpoint_files(tmp_path / NAME)
    assert read_checkpoint(checkpoint_file) is None


def test_untrusted_texts_cannot_drive_the_terminal(store: Store) -> None:
    wild = "\x1b]0;owned\x07"
    run = {**LISTED, "condition": f"a{wild}", "run_id": "f" * 16}
    store.plan_run("f" * 16, Identity(NAME, 0, 512))
    store.save_listing("mine", {"title": f"T{wild}", "baseline": f"b{wild}", "runs": [run]})
    for words in (["show", "mine"], ["status", "mine"], ["status", "mine", "--condition", "c"]):
        code, output, errors = call("study", *words, "--results", store.root)
        assert (code, "owned" in output + errors) == (2 if "c" in words else 0, True)
        assert not {"\x1b", "\x07"} & {*output, *errors}
