"""Supervision of workers, which a shell's script replaces in some tests, and how signals are counted."""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import pytest

from pneuma.config import Run, make_run
from pneuma.errors import StorageError
from pneuma.store.store import Store
from pneuma.study.identity import run_id
from pneuma.training.executors import local
from pneuma.training.executors.base import Event, ExecutorConfig, Job
from pneuma.training.executors.local import Interrupts

RUN = make_run({"steps": 256})
TWO = {run_id(run): run for run in (RUN, replace(RUN, seed=1))}


def train(runs: dict[str, Run], folder: Path) -> list[Event]:
    events: list[Event] = []
    local.train_runs(Job(runs, Store(folder / "results"), ExecutorConfig()), events.append)
    return events


def no_worker(folder: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Put a shell's script in the place of workers."""
    program = folder / "no-worker"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))


@pytest.mark.parametrize("final", [True, False])
def test_what_a_users_own_code_raised_is_not_trained_again(
    final: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = {"event": "end", "run_id": run_id(RUN), "status": "crashed", "step": 0, "trained": True}
    line = json.dumps({**about, "reason": "by the corridor", "final": final})
    no_worker(tmp_path, monkeypatch, f"echo x >> {tmp_path}/started\necho '{line}'\nexit 1")
    *notes, end = train({run_id(RUN): RUN}, tmp_path)
    assert end["reason"] == "by the corridor" and len(notes) == (0 if final else 1)
    assert len((tmp_path / "started").read_text().splitlines()) == len(notes) + 1


def test_a_wait_is_told_once_in_a_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A search trains the same run up to each of its pauses."""
    end = {"event": "end", "run_id": run_id(RUN), "status": "done", "step": 256, "trained": True}
    lines = [json.dumps({"event": "busy", "run_id": run_id(RUN)}), json.dumps(end)]
    flip = f"if [ -e {tmp_path}/was ]; then rm {tmp_path}/was; echo '{lines[1]}'"
    answer = f"{flip}; else touch {tmp_path}/was; echo '{lines[0]}'; fi"
    no_worker(tmp_path, monkeypatch, f"while read order; do {answer}; done")
    events = train({run_id(RUN): RUN}, tmp_path) + train({run_id(RUN): RUN}, tmp_path)
    assert [event["event"] for event in events] == ["note", "end", "end"]
    assert "another process trains this run" in events[0]["text"]


def test_after_a_full_disk_no_further_run_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    about = {"event": "end", "run_id": run_id(RUN), "status": "stopped", "step": 0, "trained": True}
    line = json.dumps({**about, "reason": "row.arrow: cannot be written (No space left)", "storage": True})
    no_worker(tmp_path, monkeypatch, f"echo x >> {tmp_path}/started\necho '{line}'\nexit 1")
    with pytest.raises(StorageError, match="row.arrow: cannot be written"):
        train(TWO, tmp_path)
    assert (tmp_path / "started").read_text() == "x\n"


@pytest.mark.parametrize(
    ("death", "status", "reason"),
    [
        ("exit 3", "crashed", "the worker process ended with code 3\nwhy\n"),
        ("kill -SEGV $$", "killed", "why\n\nthe worker process was killed by SIGSEGV"),
    ],
)
def test_a_dying_worker_takes_only_its_own_run_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, death: str, status: str, reason: str
) -> None:
    """The run that its process trained before stays, and what a library prints there is ignored."""
    first, second = TWO
    about = {"event": "end", "run_id": first, "status": "done", "step": 256, "trained": True}
    done = f"echo Welcome!; echo '{json.dumps(about)}'; read order; echo first died >&2; exit 3"
    script = f"read order; case $order in *{first}*) {done};; esac\necho why >&2\n{death}"
    no_worker(tmp_path, monkeypatch, script)
    events = train(TWO, tmp_path)
    notes = [event["run_id"] for event in events if event["event"] == "note" and "once more" in event["text"]]
    ends = [(event["run_id"], event["status"]) for event in events if event["event"] == "end"]
    assert notes == [second] and ends == [(first, "done"), (second, status)]
    assert Store(tmp_path / "results").read_file(second, "error.txt").decode() == reason


def test_of_what_a_run_prints_the_last_part_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the folder of temporary files, too, which is often memory."""
    name = next(iter(TWO))
    sizes = []
    free_disk = local._Worker.free_disk

    def free_and_measure(worker: local._Worker) -> None:
        free_disk(worker)
        printed = os.fstat(worker._errors.fileno())
        sizes.append((printed.st_size, printed.st_blocks * 512))

    monkeypatch.setattr(local._Worker, "free_disk", free_and_measure)
    step = json.dumps({"event": "step", "run_id": name, "step": 0})
    write = "head -c 3000000 /dev/zero | tr '\\0' x >&2"
    no_worker(tmp_path, monkeypatch, f"read order; {write}; echo '{step}'; sleep 0.2; echo why >&2; exit 3")
    train({name: TWO[name]}, tmp_path)
    assert sizes and all(length == 3_000_000 and on_disk < 100_000 for length, on_disk in sizes)
    error = Store(tmp_path / "results").read_file(name, "error.txt")
    assert len(error) == 65_536 and error.endswith(b"xxxwhy\n")


def test_a_worker_that_is_killed_under_a_memory_limit_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda limit: (2**31, resource.RLIM_INFINITY))
    no_worker(tmp_path, monkeypatch, "kill -SEGV $$")
    train({run_id(RUN): RUN}, tmp_path)
    reason = Store(tmp_path / "results").failure(run_id(RUN))
    assert reason.endswith("killed by SIGSEGV (perhaps because memory ran out: its limit is 2.0 GiB)")


# --- What workers compute with ------------------------------------------------------------------------

HOSTILE = {
    "NUMBA_DISABLE_JIT": "1", "NUMBA_CPU_NAME": "generic", "NPY_DISABLE_CPU_FEATURES": "X86_V3",
    "OMP_NUM_THREADS": "4", "MKL_CBWR": "AVX", "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2",
    "OPENBLAS_CORETYPE": "Haswell", "TORCH_ALLOW_TF32_CUBLAS_OVERRIDE": "1", "PYTHONHASHSEED": "7",
    "DNNL_MAX_CPU_ISA": "SSE41", "ONEDNN_DEFAULT_FPMATH_MODE": "BF16", "ATEN_CPU_CAPABILITY": "default",
    "NOT_YET_INVENTED": "1",
}  # fmt: skip
"""What a shell may set, by which the same run would come to other numbers."""


def test_a_worker_has_no_variables_that_change_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in HOSTILE.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("PNEUMA_PASS", "ROM_FOLDER,OTHER")
    monkeypatch.setenv("ROM_FOLDER", "/roms")
    no_worker(tmp_path, monkeypatch, f"env > {tmp_path}/has\nexit 1")
    train({run_id(RUN): RUN}, tmp_path)
    has = dict(line.partition("=")[::2] for line in (tmp_path / "has").read_text().splitlines())
    assert has["ROM_FOLDER"] == "/roms"
    expected = {"OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    assert {name: value for name, value in has.items() if name in HOSTILE} == expected


def test_workers_keep_byte_code_where_packages_have_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.delenv("PYTHONPYCACHEPREFIX", raising=False)  # set for the suite where it has no byte code
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    numpy = find_spec("numpy")
    assert numpy is not None
    for cached, kept in ((tmp_path / "none.pyc", False), (Path(__file__), True)):
        numpy.cached = str(cached)
        monkeypatch.setattr(local, "find_spec", lambda name: numpy)
        variables = local.worker_environment()
        assert ("PYTHONDONTWRITEBYTECODE" in variables) == kept
        folder = None if kept else str(tmp_path / "pneuma" / "bytecode")
        assert variables.get("PYTHONPYCACHEPREFIX") == folder


# --- Signals -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("nohup", "counted"), [(False, 1), (True, 0)])
def test_a_closed_terminal_is_one_interrupt_however_often_its_signal_comes(nohup: bool, counted: int) -> None:
    handler = signal.SIG_IGN if nohup else signal.SIG_DFL
    before = signal.signal(signal.SIGHUP, handler)
    try:
        with Interrupts() as interrupts:
            for _ in range(3):
                signal.raise_signal(signal.SIGHUP)
            assert interrupts.count == counted
            signal.raise_signal(signal.SIGINT)
            assert interrupts.count == counted + 1
        assert signal.getsignal(signal.SIGHUP) == handler
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(("patience", "counted"), [(60.0, 1), (-1.0, 2)])
def test_a_shutdown_waits_only_so_long_for_a_step(
    patience: float, counted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An evaluation of a slow environment once took two minutes."""
    monkeypatch.setattr(local, "PATIENCE", patience)
    with Interrupts() as interrupts:
        signal.raise_signal(signal.SIGTERM)
        assert interrupts.count == counted
