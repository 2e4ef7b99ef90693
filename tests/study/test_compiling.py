"""One worker compiles, the others wait for it; whoever fails leaves the task to the next."""

from __future__ import annotations

import errno
import threading
import time
from pathlib import Path

import pytest

from pneuma.config import make_run
from pneuma.study import compiling
from pneuma.study.compiling import COMPILES, WAITS, FirstCompile

RUN = make_run({})


class _Other(threading.Thread):
    """A second worker, with what it told; it compiles nothing."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self.told: list[str] = []
        self.stop = threading.Event()
        self._folder = folder

    def run(self) -> None:
        with FirstCompile(make_run({"seed": 1}), self._folder, self.told.append, self.stop):
            pass


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiling, "WAIT_SECONDS", 0.001)


@pytest.mark.parametrize("well", [True, False])
def test_a_second_worker_waits_and_compiles_only_if_the_first_failed(tmp_path: Path, well: bool) -> None:
    told: list[str] = []
    other = _Other(tmp_path)
    with FirstCompile(RUN, tmp_path, told.append, threading.Event()) as first:
        other.start()
        deadline = time.monotonic() + 10
        while not other.told and time.monotonic() < deadline:
            time.sleep(0.001)
        assert other.is_alive()
        if well:
            first.done()
    other.join(10)
    assert told == [COMPILES]
    assert other.told == ([WAITS] if well else [WAITS, COMPILES])


def test_what_is_compiled_is_not_waited_for_again_by_runs_of_the_same_shapes(tmp_path: Path) -> None:
    told: list[str] = []

    def compile_for(settings: dict[str, object]) -> int:
        with FirstCompile(make_run(settings), tmp_path / "new", told.append, threading.Event()) as first:
            first.done()
        return len(told)

    assert compile_for({}) == 1
    assert compile_for({"seed": 3, "learning_rate": 1e-2, "betas": (0.9, 0.9)}) == 1  # numbers are data
    assert compile_for({"activation": "relu"}) == 2
    assert compile_for({"weight_decay": 0.1}) == 3


def test_who_is_told_to_stop_does_not_wait(tmp_path: Path) -> None:
    with FirstCompile(RUN, tmp_path, lambda text: None, threading.Event()):
        other = _Other(tmp_path)
        other.stop.set()
        other.start()
        other.join(10)
        assert not other.is_alive()


def test_a_mark_that_cannot_be_left_crashes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "touch", full)
    told: list[str] = []
    for _ in range(2):
        with FirstCompile(RUN, tmp_path, told.append, threading.Event()) as first:
            first.done()
    assert told == [COMPILES, COMPILES]


def test_nothing_is_told_where_no_programs_are_kept() -> None:
    told: list[str] = []
    with FirstCompile(RUN, None, told.append, threading.Event()) as first:
        first.done()
    assert told == []
