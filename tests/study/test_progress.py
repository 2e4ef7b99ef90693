"""What a person sees while a study runs never stops it."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.cli.output import say
from pneuma.study.plan import Selection, make_plan
from pneuma.study.progress import ProgressDisplay
from pneuma.study.spec import load_study
from pneuma.study.store import Store


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_training_outlives_its_terminal(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Its window was closed: whatever is written to it fails (EIO)."""
    terminal = _Terminal()
    plan = make_plan(load_study("activation"), Selection(seeds=(0,), conditions=("tanh",)))

    def gone(_: str) -> int:
        raise OSError(5, "Input/output error")

    for name, value in {"TERM": "xterm", "COLUMNS": "120"}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys, "stderr", terminal)
    runs = {cell.run_id: cell.run for cell in plan.cells}
    with ProgressDisplay(plan, runs, Store(tmp_path), quiet=False) as display:
        thread = display._bars.live._refresh_thread  # its own mistakes would be shown by this one
        assert thread is not None
        thread.stop()
        thread.join()
        monkeypatch.setattr(terminal, "write", gone)
        display.update(plan.cells[0], {"event": "note", "text": "goes on from step 256"})
        display.update(plan.cells[0], {"event": "end", "step": 50_176, "status": "done"})
    say("Stopped.", aside=True)


def test_no_name_reaches_the_terminal_raw(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A condition's name may be an escape sequence that sets the window's title."""
    plan = make_plan(load_study("activation"), Selection(seeds=(0,), conditions=("tanh",)))
    cell = replace(plan.cells[0], condition="\x1b]0;a\x07")
    plan = replace(plan, cells=(cell,))
    with ProgressDisplay(plan, {cell.run_id: cell.run}, Store(tmp_path), quiet=False) as display:
        display.update(cell, {"event": "note", "text": "begins"})
    assert capsys.readouterr().err == "\\u001b]0;a\\u0007 seed 0: begins\n"
