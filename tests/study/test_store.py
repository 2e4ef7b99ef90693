"""The store: files are there whole or not at all, and nothing damaged is ever read."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NoReturn

import pytest

from pneuma.errors import UserError
from pneuma.study.files import replace_files
from pneuma.study.locks import RunLock
from pneuma.study.store import Status, Store, to_json, write_whole

NAME = "0123456789abcdef"
RECORD = {"title": "A", "figure": "a", "baseline": "a", "same": [], "selection": {}, "runs": []}
FILES = {"run.json": b"{}\n", "episodes.parquet": bytes(range(256))}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.save_run(NAME, Status("done", 512), FILES)
    return store


# --- Files whole or not at all -------------------------------------------------------------------


def _fail(*_: object) -> NoReturn:
    raise OSError("no space left on device")


def test_a_file_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_whole(path, b"first")
    write_whole(path, b"second")
    assert path.read_bytes() == b"second"
    assert os.listdir(tmp_path) == ["file"]
    (tmp_path / "beside").touch()
    assert path.stat().st_mode == (tmp_path / "beside").stat().st_mode
    path.chmod(0o600)
    write_whole(path, b"third")
    assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("step", ["fsync", "replace", "chmod"])
def test_a_failed_write_leaves_what_was_there_and_nothing_else(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_bytes(b"first")
    monkeypatch.setattr(os, step, _fail)
    with pytest.raises(OSError, match="no space left"):
        write_whole(tmp_path / "file", b"second")
    assert os.listdir(tmp_path) == ["file"]
    assert (tmp_path / "file").read_bytes() == b"first"


def test_files_that_are_written_together_come_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A write that fails on its way leaves those before it, and nothing half written."""
    replace = os.replace
    done: list[str] = []

    def fail_at_the_third(source: str, target: Path) -> None:
        if len(done) == 2:
            raise OSError("no space left on device")
        done.append(target.name)
        replace(source, target)

    monkeypatch.setattr(os, "replace", fail_at_the_third)
    with pytest.raises(OSError, match="no space left"):
        replace_files(tmp_path, {name: name.encode() for name in ("b", "a", "status", "c")})
    assert done == ["b", "a"]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"a", "b": b"b"}


def test_all_files_are_on_the_disk_before_one_is_in_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(len(os.listdir(tmp_path))))
    replace_files(tmp_path, {"a": b"1", "b": b"2", "c": b"3"})
    assert synced == [3, 3, 3]
    assert sorted(os.listdir(tmp_path)) == ["a", "b", "c"]


def test_an_interrupted_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "file", b"data")
    assert os.listdir(tmp_path) == []


def test_json_ends_with_a_line() -> None:
    assert to_json({"a": [1, None]}) == b'{\n  "a": [\n    1,\n    null\n  ]\n}\n'


# --- Runs ----------------------------------------------------------------------------------------


def test_a_saved_run_comes_back(store: Store) -> None:
    assert store.status(NAME) == Status("done", 512)
    assert {name: store.read_file(NAME, name) for name in FILES} == FILES
    assert {path.name for path in store.run_folder(NAME).iterdir()} == {*FILES, "status.json"}


@pytest.mark.parametrize(
    ("name", "finished"),
    [
        ("planned", False),
        ("running", False),
        ("done", True),
        ("diverged", True),
        ("crashed", False),
        ("killed", False),
        ("timeout", False),
    ],
)
def test_results_are_what_is_done_or_diverged(name: str, finished: bool) -> None:
    assert Status(name).finished is finished


def test_an_unknown_run_is_planned(store: Store) -> None:
    assert store.status("f" * 16) == Status("planned", 0)


def test_a_run_without_its_status_is_planned(store: Store) -> None:
    (store.run_folder(NAME) / "status.json").unlink()
    assert store.status(NAME) == Status("planned", 0)
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, "run.json")


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "3", '{"schema": 1, "status": "done", "step": 1, "files": {}}', "\x00", '{"schema": 1}'],
)
def test_a_damaged_status_is_noticed(store: Store, text: str) -> None:
    (store.run_folder(NAME) / "status.json").write_text(text)
    assert store.status(NAME) == Status("damaged", 0, "status.json")
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, "run.json")


@pytest.mark.parametrize("bit", [0, 1023, 2047])
def test_one_flipped_bit_is_noticed(store: Store, bit: int) -> None:
    path = store.run_folder(NAME) / "episodes.parquet"
    data = bytearray(path.read_bytes())  # 256 bytes: 2,048 bits
    data[bit // 8] ^= 1 << bit % 8
    path.write_bytes(data)
    with pytest.raises(UserError, match="episodes.parquet: missing or damaged; run the study again"):
        store.read_file(NAME, "episodes.parquet")


def test_a_damaged_run_is_to_be_trained_again(store: Store) -> None:
    """Design section 4: a damaged file is noticed and retrained."""
    (store.run_folder(NAME) / "episodes.parquet").write_bytes(b"damaged")
    assert not store.status(NAME).finished


def test_a_run_that_lacks_a_file_is_to_be_trained_again(store: Store) -> None:
    (store.run_folder(NAME) / "episodes.parquet").unlink()
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, "episodes.parquet")
    assert not store.status(NAME).finished


def test_a_file_that_nothing_vouches_for_is_not_read(store: Store) -> None:
    (store.run_folder(NAME) / "extra.parquet").write_bytes(b"")
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, "extra.parquet")


CRASH = {"run.json": b"{}", "error.txt": b"why"}


def test_a_run_saved_again_holds_only_its_new_files(tmp_path: Path) -> None:
    store = Store(tmp_path / "other")
    store.save_run(NAME, Status("crashed"), CRASH)
    assert {path.name for path in store.run_folder(NAME).iterdir()} == {*CRASH, "status.json"}
    store.save_run(NAME, Status("done", 512), FILES)
    assert {path.name for path in store.run_folder(NAME).iterdir()} == {*FILES, "status.json"}


def test_a_crash_never_replaces_a_finished_run(store: Store) -> None:
    """Another process may have trained it meanwhile."""
    before = store.status(NAME)
    assert before.finished
    store.save_run(NAME, Status("crashed"), CRASH)
    assert store.status(NAME) == before


def test_two_processes_may_save_one_run_at_once(tmp_path: Path) -> None:
    store = Store(tmp_path / "other")
    with ThreadPoolExecutor(8) as pool:
        for done in [pool.submit(store.save_run, NAME, Status("done", 512), FILES) for _ in range(40)]:
            done.result()
    assert store.status(NAME) == Status("done", 512)
    assert {path.name for path in store.run_folder(NAME).iterdir()} == {*FILES, "status.json"}


def test_a_save_that_fails_half_way_leaves_the_run_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path / "other")
    monkeypatch.setattr(os, "fsync", _fail)
    with pytest.raises(UserError, match="run.json: cannot be written"):
        store.save_run(NAME, Status("done", 1024), FILES)
    assert store.status(NAME) == Status("planned", 0)


def test_only_checkpoints_by_name_tell_how_far_a_run_is(tmp_path: Path) -> None:
    store = Store(tmp_path)
    folder = store.run_folder(NAME) / "checkpoints"
    folder.mkdir(parents=True)
    for name in ("old-copy.safetensors", f"{'9' * 13}-copy.safetensors", "\u0663" * 13 + "-" + "a" * 16):
        (folder / name).write_bytes(b"")
    assert store.status(NAME) == Status("planned", 0)
    (folder / f"{512:013}-{'a' * 16}.safetensors").write_bytes(b"")
    assert store.status(NAME) == Status("partial", 512)


def test_a_crashed_run_is_as_far_as_its_checkpoint(tmp_path: Path) -> None:
    """Who notes that a worker was killed does not know how far it was."""
    store = Store(tmp_path)
    store.save_run(NAME, Status("killed"), FILES)
    assert store.status(NAME) == Status("killed", 0)
    folder = store.run_folder(NAME) / "checkpoints"
    folder.mkdir(exist_ok=True)
    (folder / f"{512:013}-{'a' * 16}.safetensors").write_bytes(b"")
    assert store.status(NAME) == Status("killed", 512)
    with RunLock(store.run_folder(NAME)) as mine:
        assert mine and store.status(NAME) == Status("running", 512)


# --- Studies -------------------------------------------------------------------------------------


def test_the_latest_selection_of_a_study_comes_back(store: Store) -> None:
    settings = {"env": "a", "slots": 1, "steps": 512}
    cell = {"run_id": NAME, "condition": "a", "seed": 0, "run": settings}
    latest = {**RECORD, "study": "one", "runs": [cell]}
    store.save_selection("one", {**RECORD, "study": "one"})
    store.save_selection("two", {**RECORD, "study": "two"})
    store.save_selection("one", latest)
    assert store.selection("one") == {"schema": 1, **latest}
    assert store.studies() == ["one", "two"]
    path = store.root / "studies" / "one.json"
    sealed = json.loads(path.read_bytes())
    assert {key: value for key, value in sealed.items() if key != "sha256"} == store.selection("one")


def test_a_study_that_was_not_run_has_no_selection(store: Store) -> None:
    assert store.selection("activation") is None
    assert Store(store.root / "nowhere").studies() == []


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": 2, "runs": []}'])
def test_a_damaged_selection_reads_as_none(store: Store, text: str) -> None:
    store.save_selection("one", {**RECORD, "study": "one"})
    (store.root / "studies" / "one.json").write_text(text)
    assert store.selection("one") is None


# --- The folder ----------------------------------------------------------------------------------


def test_a_folder_is_made_and_left_empty(tmp_path: Path) -> None:
    Store(tmp_path / "a" / "b").check_writable()
    assert os.listdir(tmp_path / "a" / "b") == []


@pytest.mark.parametrize("below", [".", "below"])
def test_a_file_in_the_folders_place_is_told(below: str, tmp_path: Path) -> None:
    (tmp_path / "results").write_text("")
    with pytest.raises(UserError, match=r"^--results .*results.* cannot be written"):
        Store(tmp_path / "results" / below).check_writable()
