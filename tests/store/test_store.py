"""The store: files are there whole or not at all, nothing damaged is ever read; record tables."""

from __future__ import annotations

import errno
import math
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn

import pytest

from pneuma.config import make_run
from pneuma.errors import StorageError, UserError
from pneuma.files import create_whole, replace_files, to_json, write_whole
from pneuma.store.locks import run_lock
from pneuma.store.store import Identity, Status, Store
from pneuma.store.tables import from_parquet, to_parquet

NAME = "0123456789abcdef"
MINE = Identity("a" * 16, 3, 512)
LISTING = {"title": "A", "baseline": "a", "runs": [{"run_id": NAME, "condition": "a", "seed": 0}]}
FILES = {"run.json": b"{}\n", "episodes.parquet": bytes(range(256))}
CRASH = {"run.json": b"{}", "error.txt": b"why"}


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.save_run(NAME, Status("done", 512, identity=MINE), FILES)
    return store


# --- Files whole or not at all -------------------------------------------------------------------


def test_a_file_is_written_whole_with_the_usual_permissions(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_whole(path, b"first")
    write_whole(path, to_json({"a": [1, None]}))
    assert path.read_bytes() == b'{\n  "a": [\n    1,\n    null\n  ]\n}\n'
    assert os.listdir(tmp_path) == ["file"]
    (tmp_path / "other").touch()
    assert path.stat().st_mode == (tmp_path / "other").stat().st_mode


@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("error", [OSError("no space left on device"), KeyboardInterrupt()])
def test_a_failed_write_leaves_what_was_there_and_nothing_else(
    step: str, error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> NoReturn:
        raise error

    (tmp_path / "file").write_bytes(b"first")
    monkeypatch.setattr(os, step, fail)
    with pytest.raises(type(error)):
        write_whole(tmp_path / "file", b"second")
    assert os.listdir(tmp_path) == ["file"]
    assert (tmp_path / "file").read_bytes() == b"first"


def test_files_are_on_the_disk_before_one_is_in_its_place_and_come_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A write that fails on its way leaves those before it, and nothing half written."""
    replace, synced, done = os.replace, list[int](), list[str]()

    def fail_at_the_third(source: str, target: Path) -> None:
        if len(done) == 2:
            raise OSError(errno.ENOSPC, "no space left on device")
        done.append(target.name)
        replace(source, target)

    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append(len(os.listdir(tmp_path))))
    monkeypatch.setattr(os, "replace", fail_at_the_third)
    with pytest.raises(OSError, match="no space left on device: .*/status'"):
        replace_files(tmp_path, {name: name.encode() for name in ("b", "a", "status", "c")})
    assert synced == [4] * 4 and done == ["b", "a"]
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"a", "b": b"b"}


# --- Runs ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "{", '{"schema": 1, "status": "done", "step": 1, "files": {}}'])
def test_a_damaged_status_is_noticed(store: Store, text: str) -> None:
    (store.run_folder(NAME) / "status.json").write_text(text)
    assert store.status(NAME) == Status("damaged", 0, "status.json")
    with pytest.raises(UserError, match="missing or damaged"):
        store.read_file(NAME, "run.json")


@pytest.mark.parametrize("bit", [0, 2047, None])
def test_one_flipped_bit_or_a_missing_file_is_noticed_and_nothing_else_is_read(
    store: Store, bit: int | None
) -> None:
    path = store.run_folder(NAME) / "episodes.parquet"
    (store.run_folder(NAME) / "extra.parquet").write_bytes(b"")
    data = bytearray(path.read_bytes())  # 256 bytes: 2,048 bits
    if bit is None:
        path.unlink()
    else:
        data[bit // 8] ^= 1 << bit % 8
        path.write_bytes(data)
    assert store.status(NAME) == Status("damaged", 0, "episodes.parquet")
    for name in ("episodes.parquet", "extra.parquet"):  # no checksum vouches for the second
        with pytest.raises(UserError, match=f"{name}: missing or damaged; run the study again"):
            store.read_file(NAME, name)


def test_a_run_saved_again_holds_only_its_new_files_and_a_crash_never_replaces_a_finished_one(
    tmp_path: Path,
) -> None:
    """Another process may have trained it meanwhile."""
    store = Store(tmp_path / "other")
    store.save_run(NAME, Status("crashed"), CRASH)
    assert {path.name for path in store.run_folder(NAME).iterdir()} == {*CRASH, "status.json"}
    with ThreadPoolExecutor(8) as pool:  # two processes may save one run at once
        for done in [pool.submit(store.save_run, NAME, Status("done", 512), FILES) for _ in range(20)]:
            done.result()
    with run_lock(store.run_folder(NAME)):  # of one who thought that the run was not finished
        store.save_run(NAME, Status("crashed"), CRASH)
    assert store.status(NAME) == Status("done", 512)
    assert {path.name for path in store.run_folder(NAME).iterdir()} == {*FILES, "status.json"}


def test_only_checkpoints_by_name_tell_how_far_a_run_is_and_a_lock_that_it_runs(tmp_path: Path) -> None:
    """Who notes that a worker was killed does not know how far it was."""
    store = Store(tmp_path)
    folder = store.run_folder(NAME) / "checkpoints"
    folder.mkdir(parents=True)
    for name in ("old-copy.safetensors", f"{'9' * 13}-copy.safetensors", "\u0663" * 13 + "-" + "a" * 16):
        (folder / name).write_bytes(b"")
    assert store.status(NAME) == Status("planned", 0)
    (folder / f"{512:013}-{'a' * 16}.safetensors").write_bytes(b"")
    assert store.status(NAME) == Status("partial", 512)
    store.save_run(NAME, Status("killed"), FILES)
    assert store.status(NAME) == Status("killed", 512)
    with run_lock(store.run_folder(NAME)) as mine:
        assert mine and store.status(NAME) == Status("running", 512)
    assert (store.run_folder(NAME) / ".lock").exists() and store.status(NAME) == Status("killed", 512)
    store.save_run(NAME, Status("done", 512), FILES)
    assert not (store.run_folder(NAME) / ".lock").exists()


def test_a_row_is_added_to_a_finished_run_alone_and_its_loss_damages_nothing(store: Store) -> None:
    """It is made from the other files again; a planned run has nothing to make one of."""
    store.save_row(NAME, b"row")
    assert store.read_file(NAME, "row.arrow") == b"row" and store.status(NAME).identity == MINE
    (store.run_folder(NAME) / "row.arrow").unlink()
    assert store.status(NAME) == Status("done", 512)
    for name in (other := "f" * 16), "e" * 16:
        store.plan_run(other, MINE)
        store.save_row(name, b"row")
    assert store.status(other) == Status("planned") and store.status(other).identity == MINE
    assert store.runs() == [NAME, other] and os.listdir(store.run_folder(other)) == ["status.json"]


def test_a_run_is_not_removed_while_another_process_trains_it(store: Store) -> None:
    """A process may begin to train it after `study delete` has looked."""
    with run_lock(store.run_folder(NAME)):
        with pytest.raises(UserError, match=f"run {NAME} is training now"):
            store.delete_run(NAME)
        assert store.read_file(NAME, "run.json") == FILES["run.json"]
    store.delete_run(NAME)
    assert store.runs() == []


def test_a_removal_that_fails_is_one_line(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> NoReturn:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "unlink", fail)
    with pytest.raises(UserError, match=r"episodes.parquet: cannot be removed \(Operation not permitted\)"):
        store.save_run(NAME, Status("done", 512), {"run.json": b"{}"})


def test_a_run_is_noted_where_there_are_no_hard_links(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on FAT, exFAT and many shared folders; a status that is there, or being written, stays."""

    def fail(*_: object) -> NoReturn:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", fail)
    identity, earlier, other = Identity("ab" * 8, 1, 512), store.status(NAME), "f" * 16
    store.plan_run(NAME, identity)
    assert store.status(NAME) == earlier and store.status(NAME).finished
    with store.lock(other) as is_free:
        assert is_free
        store.plan_run(other, identity)
        assert not (store.run_folder(other) / "status.json").exists()
    store.plan_run(other, identity)
    assert store.status(other).identity == identity
    create_whole(tmp_path / "file", b"first")
    create_whole(tmp_path / "file", b"second")
    assert (tmp_path / "file").read_bytes() == b"first"
    names = {path.name for path in tmp_path.rglob("*")}
    assert not any(name.startswith(".") and name != ".lock" for name in names)


STORAGE = (
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.ENOMEM, errno.EIO, errno.EROFS, errno.ENODEV,
    errno.ENOTCONN, errno.ESTALE, errno.EHOSTDOWN,
)  # fmt: skip


@pytest.mark.parametrize("number", [*STORAGE, errno.EACCES])
def test_a_write_that_the_disk_refuses_names_the_file_and_says_if_no_file_could_be_written(
    store: Store, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def fail(descriptor: int) -> NoReturn:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(UserError) as refused:
        store.save_run(NAME, Status("done", 512), FILES)
    assert f"{store.run_folder(NAME)}/run.json: cannot be written ({os.strerror(number)})" in str(
        refused.value
    )
    assert isinstance(refused.value, StorageError) == (number != errno.EACCES)


def test_of_an_endless_failure_the_end_is_kept_and_a_message_shown(store: Store) -> None:
    store.save_failure("e" * 16, make_run({}), "crashed", "Traceback\n" + "a" * 300_000 + "b" * 300_000)
    assert len(store.read_file("e" * 16, "error.txt")) == 65_536
    assert store.failure("e" * 16) == "b" * 2_000 + " … " + "b" * 2_000


def test_what_a_killed_write_left_is_swept_by_the_next_one(store: Store) -> None:
    folder = store.run_folder(NAME)
    left, other = folder / f".row.arrow.{'a' * 32}", folder / f".row.arrow.{'b' * 32}"
    for path in (left, other, folder / ".notes.txt"):
        path.touch()
    for path in (left, folder / ".notes.txt"):
        os.utime(path, (0, 0))
    store.save_row(NAME, b"row")
    assert not left.exists() and other.exists() and (folder / ".notes.txt").exists()


# --- Studies without a file ----------------------------------------------------------------------


def test_the_runs_of_a_study_without_a_file_come_back_unless_its_record_is_damaged(store: Store) -> None:
    store.save_listing("one", {**LISTING, "title": "first"})
    store.save_listing("two", LISTING)
    store.save_listing("one", LISTING)
    assert store.listing("one") == {"study": "one", **LISTING}
    assert store.listings() == ["one", "two"]
    assert store.listing("activation") is None and Store(store.root / "nowhere").listings() == []
    whole = store.listing_path("two").read_bytes()
    for text in (b"", b"{", b'{"schema": 2, "runs": []}', whole.replace(b'"a"', b'"b"')):
        store.listing_path("one").write_bytes(text)
        assert store.listing("one") is None


# --- Record tables --------------------------------------------------------------------------------

COLUMNS = ("slot", "episode", "step", "return", "length", "kills", "hp", "ending")


def _row(episode: int, **changes: Any) -> dict[str, Any]:
    row = {"slot": 0, "episode": episode, "step": 10**12, "return": 0.1 + 0.2, "length": 50, "kills": 3}
    return {**row, "hp": 12.0, "ending": "killed", **changes}


def test_rows_come_back_as_they_were_with_the_columns_asked_for() -> None:
    rows = [_row(0), _row(1, ending="time-limit", **{"return": -1e-300}), _row(2, kills=0)]
    table = from_parquet(to_parquet(rows, COLUMNS))
    assert tuple(table.column_names) == COLUMNS
    assert table.to_pylist() == rows
    assert from_parquet(to_parquet([_row(0)], ("ending", "step"))).to_pylist() == [
        {"ending": "killed", "step": 10**12}
    ]
    assert from_parquet(to_parquet([{"length": 20.5}], ("length",))).to_pylist() == [{"length": 20.5}]
    (row,) = from_parquet(to_parquet([_row(0, hp=math.nan)], COLUMNS)).to_pylist()
    assert math.isnan(row["hp"])
