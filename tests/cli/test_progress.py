"""What a person sees while a study runs: plain lines in a log, bars on a terminal, and how it ended."""

from __future__ import annotations

import io
import sys

import pytest

from pneuma.cli import progress
from pneuma.cli.output import say
from pneuma.cli.progress import LINE_SECONDS, ProgressDisplay
from pneuma.config import Run
from pneuma.study.execute import CellProgress
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study

Captured = pytest.CaptureFixture[str]


class _Clock:
    """Time that passes only when told to."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> _Clock:
    clock = _Clock()
    monkeypatch.setattr(progress, "time", clock)
    return clock


@pytest.fixture
def plan() -> Plan:
    """Two runs of 2,560 steps: seed 0 of tanh and of ReLU."""
    return make_plan(load_study("activation"), Selection(seeds=(0,), steps=2560, conditions=("tanh", "relu")))


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> _Terminal:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return _Terminal()


def _runs(plan: Plan) -> dict[str, Run]:
    return {cell.run_id: cell.run for cell in plan.cells}


def test_a_log_gets_a_line_now_and_then_and_one_for_every_end(
    plan: Plan, clock: _Clock, capsys: Captured
) -> None:
    """The relu run goes on from a checkpoint at step 1,024; 2,560 steps are left after 10 s."""
    tanh, relu = plan.cells
    with ProgressDisplay(plan, _runs(plan), quiet=False, kept={relu.run_id: 1024}) as display:
        clock.now = 2.0
        display.update(CellProgress(tanh, 256))  # too early for a line
        clock.now = LINE_SECONDS
        display.update(CellProgress(tanh, 1536))  # 1,280 steps in 8 s
        display.update(CellProgress(tanh, 2560, "done"))
        display.update(CellProgress(relu, 2560, "diverged"))
    assert capsys.readouterr().err.splitlines() == [
        "0/2 runs ended, 50% of all steps, 16 s left",
        "tanh seed 0: done; 1/2 runs ended, 70% of all steps, 6 s left",
        "relu seed 0: diverged; 2/2 runs ended, 100% of all steps",
    ]


def test_training_outlives_its_terminal(
    plan: Plan, terminal: _Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its window was closed: whatever is written to it fails (EIO)."""

    def gone(_: str) -> int:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(sys, "stderr", terminal)
    with ProgressDisplay(plan, _runs(plan), quiet=False) as display:
        thread = display._bars.live._refresh_thread  # its own mistakes would be shown by this one
        assert thread is not None
        thread.stop()
        thread.join()
        monkeypatch.setattr(terminal, "write", gone)
        display.update(CellProgress(plan.cells[0], 0, note="goes on from step 256"))
        display.update(CellProgress(plan.cells[0], 2560, "done"))
    say("Stopped.", aside=True)
