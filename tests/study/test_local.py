"""The local executor beside workers that are none: what they say is never taken for an event."""

from __future__ import annotations

import math
import os
import sys
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from pneuma.config import make_run
from pneuma.study.compiling import COMPILES, WAITS
from pneuma.study.executors import local, supervisor
from pneuma.study.executors.base import Event, Supervision
from pneuma.study.identity import run_id
from pneuma.study.locks import RunLock, is_held
from pneuma.study.store import Store

RUN = make_run({"steps": 2048})


def test_a_run_that_another_process_trains_is_waited_for_without_a_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker takes half a second of a core to find the lock taken; once was enough."""
    store, name = Store(tmp_path / "results"), run_id(RUN)
    begun, asked = list[object](), list[Path]()
    start = local.LocalProcess

    def note(job: Any) -> Any:
        begun.append(job)
        return start(job)

    def ask(folder: Path) -> bool:
        asked.append(folder)
        if len(asked) == 3:
            other.close()
        return is_held(folder)

    monkeypatch.setattr(local, "LocalProcess", note)
    monkeypatch.setattr(supervisor, "is_held", ask)
    monkeypatch.setattr(supervisor, "BUSY_SECONDS", 0.05)
    events: list[Event] = []
    with ExitStack() as other:
        assert other.enter_context(RunLock(store.run_folder(name)))
        local.run_groups([{name: RUN}], store, Supervision(1), events.append)
    assert len(begun) == 2 and len(asked) == 3  # one that found it busy, one that trained it
    assert [event["status"] for event in events if event["event"] == "end"] == ["done"]


@pytest.mark.parametrize(
    "line",
    [
        "Welcome!",
        "3",
        "null",
        '{"event": "step"}',
        '{"event": "end", "run_id": "another", "status": "done", "step": 1}',
    ],
)
def test_a_worker_that_tells_no_event_is_killed_and_tried_once_more(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "no-worker"
    program.write_text(f"#!/bin/sh\necho '{line}'\nexec sleep 60\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    events: list[Event] = []
    local.run_groups([{run_id(RUN): RUN}], Store(tmp_path / "results"), Supervision(1), events.append)
    note, end = events
    assert "was killed by SIGKILL" in note["text"] and note["text"].endswith("tried once more")
    assert (end["event"], end["run_id"], end["status"]) == ("end", run_id(RUN), "killed")


def test_runs_that_a_dying_worker_had_not_come_to_keep_their_second_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker of two dies in the first; then each of them dies alone, and the second once more."""
    runs = {run_id(run): run for run in (RUN, replace(RUN, seed=1))}
    program = tmp_path / "no-worker"
    told = '{"event": "note", "run_id": "%s", "text": "begun"}'
    program.write_text(
        f'#!/bin/sh\nread group\necho "$group" >> {tmp_path}/begun\n'
        f"case $group in *{list(runs)[0]}*) echo '{told % list(runs)[0]}';; esac\nexit 3\n"
    )
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    events: list[Event] = []
    local.run_groups([runs], Store(tmp_path / "results"), Supervision(1), events.append)
    notes = [event["run_id"] for event in events if event["event"] == "note" and "once more" in event["text"]]
    assert sorted(notes) == sorted(runs)  # of the second when it was alone
    assert [event["status"] for event in events if event["event"] == "end"] == ["crashed", "crashed"]
    assert len((tmp_path / "begun").read_text().splitlines()) == 4


def test_waiting_for_what_another_compiles_is_no_training(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time-out is counted from the first update; 300 s may go before it, and 600 more while it waits."""
    clock = iter([100.0, 150.0])
    monkeypatch.setattr("pneuma.study.executors.supervisor.time.monotonic", lambda: next(clock))
    worker = supervisor._Worker(Mock(), Mock(), started=0.0, waits=0.0)
    assert worker.deadline(3.0) == 303.0
    worker.note_time({"event": "passing", "run_id": "x", "text": WAITS})
    assert worker.deadline(3.0) == 903.0
    worker.note_time({"event": "passing", "run_id": "x", "text": COMPILES})
    assert worker.deadline(3.0) == 100.0 + 303.0
    worker.note_time({"event": "step", "run_id": "x", "step": 64})
    assert worker.deadline(3.0) == 153.0


def test_waiting_for_a_node_takes_no_time_of_a_run() -> None:
    worker = supervisor._Worker(Mock(), Mock(), started=0.0, waits=math.inf)
    assert worker.deadline(3.0) == math.inf
    worker.note_time({"event": "passing", "run_id": "x", "text": "starts on the node 10.0.0.2"})
    assert worker.deadline(3.0) == pytest.approx(time.monotonic() + 303.0, abs=10)


def test_a_run_whose_time_is_up_is_waited_for_as_long_as_its_slow_updates_take(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its only update so far came after a minute; one that takes as long, and is evaluated, is no hang."""
    clock = {"now": 0.0}
    monkeypatch.setattr("pneuma.study.executors.supervisor.time.monotonic", lambda: clock["now"])
    wakeup, other_end = os.pipe()
    how = Supervision(1, timeout_seconds=4.0)
    interrupts = Mock(count=0, wakeup=wakeup)
    supervised = supervisor.Supervisor([], Mock(), how, Mock(), interrupts, Mock())
    process = Mock()
    worker = supervisor._Worker(process, Mock(), started=0.0, waits=0.0)
    monkeypatch.setattr(supervised, "_workers", lambda: [worker])

    def look(now: float) -> tuple[bool, bool]:
        """Return whether the run has been asked to stop, and whether it has been killed."""
        clock["now"] = now
        supervised._end_overdue()
        return process.ask_to_stop.called, process.kill.called

    clock["now"] = 60.0
    worker.note_time({"event": "step", "run_id": "x", "step": 64})
    assert [look(now) for now in (63.0, 65.0, 96.0, 300.0)] == [
        (False, False), (True, False), (True, False), (True, False),
    ]  # fmt: skip
    assert supervised._patience() == pytest.approx(65 + 600 + 30 - 300, abs=1)
    assert look(65 + 600 + 31) == (True, True)
    os.close(other_end)
    os.close(wakeup)
