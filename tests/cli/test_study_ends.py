"""Studies whose runs end in no success, by the commands that people type."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pneuma.study import execute
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store

from .calls import call, printed


def test_a_diverged_run_is_a_result_with_a_line_of_its_own(tmp_path: Path) -> None:
    (cell,) = make_plan(load_study("activation"), Selection(seeds=(0,), conditions=("tanh",))).cells
    Store(tmp_path).save_run(cell.run_id, Status("diverged", 512), {})
    run = ("study", "run", "activation", "--seeds", "1", "--condition", "tanh", "--results", tmp_path)
    assert "tanh seed 0 diverged at step 512" in printed(*run)
    called = call(*run, "--json")
    assert called.code == 0 and "tanh seed 0 diverged at step 512" in called.err
    assert called.document["runs"][0]["status"] == "diverged"


def test_a_crash_is_exit_code_1_and_says_where_to_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\nread job\necho out of luck >&2\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    results = tmp_path / "results"
    called = call("study", "run", "activation", "--seeds", "1", "--condition", "tanh", "--results", results)
    assert called.code == 1
    (trace,) = results.glob("runs/*/error.txt")
    assert f"tanh seed 0 crashed: out of luck ({trace})" in called.out
    assert trace.read_text() == "the worker process ended with code 3\nout of luck\n"
    status = call("study", "status", "activation", "--json", "--results", results)
    assert (status.code, status.document["runs"][0]["status"]) == (0, "crashed")


def test_an_interrupt_is_exit_code_130_and_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(execute, "execute", interrupt)
    called = call("study", "run", "activation", "--quiet", "--results", tmp_path)
    assert (called.code, called.out) == (130, "")
    assert len(called.err.splitlines()) == 1
