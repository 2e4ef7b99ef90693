"""Checkpoints of a run in the store: when they are taken, and where a run goes on."""

from __future__ import annotations

import math
from typing import Any

import pytest

from pneuma.engines.loop import Progress
from pneuma.engines.records import Checkpoint, Records
from pneuma.store import checkpoints
from pneuma.store.checkpoints import RunCheckpoints
from pneuma.store.provenance import Attempt
from pneuma.store.store import Store, checkpoint_files

NAME = "0123456789abcdef"


class _Clock:
    """Time that a test sets."""

    now = 1000.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> _Clock:
    clock = _Clock()
    monkeypatch.setattr(checkpoints, "time", clock)
    return clock


def begin(store: Store, notes: list[str] | None = None) -> RunCheckpoints:
    notes = [] if notes is None else notes
    return RunCheckpoints(store, NAME, 15.0, notes.append)


def update(run_checkpoints: RunCheckpoints, step: int, at_once: bool = False) -> None:
    run_checkpoints.update(Progress(step, Records(), lambda: Checkpoint(step, {})), Attempt(), at_once)


def steps(store: Store) -> list[int]:
    return [file.step for file in checkpoint_files(store.run_folder(NAME))]


def test_a_checkpoint_is_taken_when_it_is_time_and_two_are_kept(store: Store, clock: _Clock) -> None:
    run_checkpoints = begin(store)
    update(run_checkpoints, 256)
    assert steps(store) == []
    update(run_checkpoints, 256, at_once=True)
    for step in (512, 768, 1024):
        clock.now += 15.0
        update(run_checkpoints, step)
    assert steps(store) == [1024, 768]
    run_checkpoints.finish()
    assert not (store.run_folder(NAME) / "checkpoints").exists()


def test_what_takes_long_to_write_is_written_less_often(
    store: Store, clock: _Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At least 40 times as far apart as the last write took: 2 s to write, 80 s until the next."""

    def slowly(*_: Any, **__: Any) -> bytes:
        clock.now += 2.0
        return b""

    monkeypatch.setattr(checkpoints, "encode", slowly)
    run_checkpoints = begin(store)
    for seconds, step in ((15.0, 256), (79.0, 512), (1.0, 768)):
        clock.now += seconds
        update(run_checkpoints, step)
    assert steps(store) == [768, 256]


def test_a_damaged_checkpoint_is_reported_and_the_one_before_is_used(store: Store) -> None:
    for step in (256, 512):
        update(begin(store), step, at_once=True)
    path = checkpoint_files(store.run_folder(NAME))[0].path
    path.write_bytes(path.read_bytes()[:-1])
    notes: list[str] = []
    checkpoint = begin(store, notes).latest()
    assert checkpoint is not None and checkpoint.step == 256
    assert notes == ["the checkpoint at step 512 is damaged: going on from the one before"]
    checkpoint_files(store.run_folder(NAME))[0].path.write_bytes(b"")
    assert begin(store).latest() is None
    assert steps(store) == []


WRONG_ATTEMPTS: list[Any] = [
    "x", None, ["x"], [{}], [{**Attempt().so_far(1), "wall_seconds": "long"}],
    [{**Attempt().so_far(1), "wall_seconds": math.nan}], [{**Attempt().so_far(1), "machine": "mine"}],
    [{**Attempt().so_far(1), "machine": {"cores": 2**70}}],
]  # fmt: skip


@pytest.mark.parametrize("attempts", WRONG_ATTEMPTS)
def test_untrusted_a_checkpoint_with_other_attempts_is_damaged(store: Store, attempts: Any) -> None:
    """A run trained on from it would come to its end, and then have no provenance."""
    update(begin(store), 256, at_once=True)
    contents = checkpoints.encode(Checkpoint(512, {}), {"attempts": attempts}, NAME)
    forged_name = checkpoints.file_name(512, contents)
    (store.run_folder(NAME) / "checkpoints" / forged_name).write_bytes(contents)
    checkpoint = begin(store).latest()
    assert checkpoint is not None and checkpoint.step == 256
    assert steps(store) == [256]


def test_attempts_before_a_kill_come_with_the_checkpoint(store: Store) -> None:
    for step in (256, 512):
        run_checkpoints = begin(store)
        run_checkpoints.latest()
        update(run_checkpoints, step, at_once=True)
    run_checkpoints = begin(store)
    run_checkpoints.latest()
    assert [attempt["step"] for attempt in run_checkpoints.attempts] == [256, 512]


def test_folders_in_the_place_of_files_are_removed(store: Store) -> None:
    folder = store.run_folder(NAME)
    checkpoint = "0000000000256-0123456789abcdef.safetensors"
    for place in (".x.y", "metrics.parquet", f"checkpoints/{checkpoint}", "checkpoints/.x.y"):
        (folder / place / "within").mkdir(parents=True)
    run_checkpoints = begin(store)
    assert run_checkpoints.latest() is None
    run_checkpoints.finish()
    assert list(folder.iterdir()) == []


def test_what_a_killed_write_left_is_removed_by_the_next_process(store: Store) -> None:
    folder = store.run_folder(NAME)
    temporary_files = [folder / f".row.arrow.{'a' * 32}", folder / "checkpoints" / f".256.{'b' * 32}"]
    for path in temporary_files:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    begin(store)
    assert not any(path.exists() for path in temporary_files)
