"""What a person sees while a study runs: plain lines in a log, bars on a terminal, and how it ended."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

import pytest

from pneuma.cli import progress
from pneuma.cli.options import say
from pneuma.cli.progress import LINE_SECONDS, ProgressDisplay, duration
from pneuma.cli.study_run import _tell_results
from pneuma.config import Run
from pneuma.study.execute import CellProgress, CellResult
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store

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


@pytest.mark.parametrize("quiet", [False, True])
def test_only_notes_that_matter_are_shown_where_all_shall_be_quiet(
    plan: Plan, quiet: bool, capsys: Captured
) -> None:
    with ProgressDisplay(plan, _runs(plan), quiet) as display:
        display.update(CellProgress(plan.cells[0], 0, note="compiling", passing=True))
        display.update(CellProgress(plan.cells[0], 0, note="goes on after a kill"))
        display.update(CellProgress(plan.cells[0], 2560, "done"))
    lines = capsys.readouterr().err.splitlines()
    assert ("tanh seed 0: goes on after a kill" in lines, len(lines)) == (True, 1 if quiet else 3)


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


def test_a_terminal_gets_a_bar_for_each_condition_once_and_lines_above_them(
    plan: Plan, terminal: _Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal)
    tanh, relu = plan.cells
    with ProgressDisplay(plan, _runs(plan), quiet=False) as display:
        display.update(CellProgress(tanh, 2560, "done"))
        display.update(CellProgress(relu, 1280))
        print("Stopping", file=sys.stderr)  # what the supervisor says after Ctrl-C
    last = terminal.getvalue().rpartition("Stopping")[2]
    text = re.sub(r"\x1b\[[0-9;?]*\w", "", last)
    assert re.search(r"tanh .*1/1 runs +2560/2560", text)
    assert re.search(r"relu .*0/1 runs +1280/2560", text)
    assert re.search(r"all .*1/2 runs +3840/5120", text)


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


def test_why_a_run_went_wrong_is_told_by_who_knows_it_now(
    plan: Plan, tmp_path: Path, capsys: Captured
) -> None:
    """An error.txt that lies there may be of an earlier try."""
    store, cell = Store(tmp_path), plan.cells[0]
    trace = store.run_folder(cell.run_id) / "error.txt"
    store.write(trace, b"OSError: of yesterday")
    end = CellResult(cell, Status("crashed"), True, "r: cannot be written (No space left on device)")
    _tell_results(plan, [end], store, as_json=False, quiet=False)
    told = capsys.readouterr().out.splitlines()[0]
    assert told == f"tanh seed 0 crashed: r: cannot be written (No space left on device) ({trace})"


@pytest.mark.parametrize(
    ("seconds", "told"),
    [(0.4, "0 s"), (99, "99 s"), (120, "2 min"), (5_940, "99 min"), (12_000, "3 h 20 min")],
)
def test_a_length_of_time_is_told_for_people(seconds: float, told: str) -> None:
    assert duration(seconds) == told
