"""What a person sees while a study runs: plain lines in a log, bars on a terminal."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.cli import progress
from pneuma.cli.options import say
from pneuma.cli.progress import LINE_SECONDS, ProgressDisplay, duration
from pneuma.cli.study_run import _tell_outcomes
from pneuma.config import Run
from pneuma.study import foresight
from pneuma.study.execute import Outcome, Progress
from pneuma.study.foresight import TimeLeft, kind, wall_seconds
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store

Captured = pytest.CaptureFixture[str]


class _Clock:
    """Time that passes only when told to."""

    def __init__(self) -> None:
        self.now = 0.0

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


def _runs(plan: Plan) -> dict[str, Run]:
    return {cell.run_id: cell.run for cell in plan.cells}


@pytest.mark.parametrize(("quiet", "shown"), [(False, 1), (True, 0)])
def test_what_passes_is_shown_unless_quiet(plan: Plan, quiet: bool, shown: int, capsys: Captured) -> None:
    with ProgressDisplay(plan, _runs(plan), 1, quiet=quiet) as display:
        display.update(Progress(plan.cells[0], 0, note="compiling", passing=True))
        display.update(Progress(plan.cells[0], 0, note="goes on after a kill"))
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["tanh seed 0: compiling"] * shown + ["tanh seed 0: goes on after a kill"]


def test_a_log_gets_a_line_now_and_then_and_one_for_every_end(
    plan: Plan, clock: _Clock, capsys: Captured
) -> None:
    tanh, relu = plan.cells
    with ProgressDisplay(plan, _runs(plan), 1, quiet=False) as display:
        display.update(Progress(tanh, 256))  # too early for a line
        clock.now = LINE_SECONDS
        display.update(Progress(relu, 1024))
        display.update(Progress(tanh, 2560, "done"))
        display.update(Progress(relu, 2560, "diverged"))
    assert capsys.readouterr().err.splitlines() == [
        "0/2 runs ended, 25% of all steps",  # (256 + 1,024) / 5,120
        "tanh seed 0: done; 1/2 runs ended, 70% of all steps",  # (2,560 + 1,024) / 5,120
        "relu seed 0: diverged; 2/2 runs ended, 100% of all steps",
    ]


@pytest.mark.parametrize("quiet", [True, False])
def test_nothing_is_shown_when_asked_for_quiet_or_when_nothing_is_trained(
    plan: Plan, quiet: bool, capsys: Captured
) -> None:
    with ProgressDisplay(plan, _runs(plan) if quiet else {}, 1, quiet) as display:
        if quiet:
            display.update(Progress(plan.cells[0], 2560, "done"))
    assert capsys.readouterr() == ("", "")


def test_a_terminal_gets_a_bar_for_each_condition(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = _Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.delenv("NO_COLOR", raising=False)
    tanh, relu = plan.cells
    with ProgressDisplay(plan, _runs(plan), 1, quiet=False) as display:
        display.update(Progress(tanh, 2560, "done"))
        display.update(Progress(relu, 1280))
    last = screen.getvalue().split("\n")
    text = "\n".join(last[-4:])
    assert "tanh" in text and "1/1 runs" in text and "2560/2560" in text
    assert "relu" in text and "0/1 runs" in text and "1280/2560" in text


def test_training_outlives_its_terminal(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its window was closed: whatever is written to it fails (EIO)."""
    screen = _Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)

    def gone(_: str) -> int:
        raise OSError(5, "Input/output error")

    with ProgressDisplay(plan, _runs(plan), 1, quiet=False) as display:
        thread = display._bars.live._refresh_thread  # its own mistakes would be shown by this one
        assert thread is not None
        thread.stop()
        thread.join()
        monkeypatch.setattr(screen, "write", gone)
        display.update(Progress(plan.cells[0], 0, note="goes on from step 256"))
        display.update(Progress(plan.cells[0], 2560, "done"))
    say("Stopped.", aside=True)


@pytest.mark.parametrize("traced", [False, True])
def test_why_a_run_went_wrong_is_told_by_who_knows_it_now(
    plan: Plan, traced: bool, tmp_path: Path, capsys: Captured
) -> None:
    """An error.txt that lies there may be of an earlier try."""
    store, cell = Store(tmp_path), plan.cells[0]
    trace = store.run_folder(cell.run_id) / "error.txt"
    if traced:
        store.write(trace, b"OSError: of yesterday")
    end = Outcome(cell, Status("crashed"), True, "r: cannot be written (No space left on device)")
    _tell_outcomes(plan, [end], store, as_json=False, quiet=False)
    told = capsys.readouterr().out.splitlines()[0]
    where = f" ({trace})" if traced else ""
    assert told == f"tanh seed 0 crashed: r: cannot be written (No space left on device){where}"


def test_beside_bars_the_time_left_is_judged_once_a_second_and_at_every_end(
    plan: Plan, clock: _Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged: list[float] = []

    def seconds(_: TimeLeft) -> float:
        judged.append(clock.now)
        return 60.0

    monkeypatch.setattr(TimeLeft, "seconds", seconds)
    monkeypatch.setattr(sys, "stderr", _Terminal())
    tanh, relu = plan.cells
    with ProgressDisplay(plan, _runs(plan), 1, quiet=False) as display:
        for step in range(1, 11):
            clock.now += 0.3
            display.update(Progress(tanh, 256 * step))
        display.update(Progress(relu, 2560, "done"))
    assert judged == pytest.approx([0.3, 1.5, 2.7, 3.0])


# --- Time left -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seconds", "told"),
    [(0.4, "0 s"), (99, "99 s"), (120, "2 min"), (5_940, "99 min"), (12_000, "3 h 20 min")],
)
def test_a_length_of_time_is_told_for_people(seconds: float, told: str) -> None:
    assert duration(seconds) == told


def test_two_workers_share_what_waits() -> None:
    assert wall_seconds([4, 3, 2], 1) == 9
    assert wall_seconds([4, 3, 2], 2) == 5  # 4 by one; 3, then 2 by the other
    assert wall_seconds([], 2) == 0


def test_what_goes_on_from_a_checkpoint_or_forks_has_only_its_rest_to_train(
    plan: Plan, clock: _Clock, capsys: Captured
) -> None:
    kept = {cell.run_id: 2048 for cell in plan.cells}
    left = TimeLeft(_runs(plan), 1, kept, clock=clock.monotonic)
    tanh = plan.cells[0]
    clock.now = 3.0
    left.update(Progress(tanh, 2304))
    clock.now = 4.0
    left.update(Progress(tanh, 2560, "done"))
    assert left.seconds() is None  # an end has no pace
    left = TimeLeft(_runs(plan), 1, kept, clock=clock.monotonic)
    clock.now = 5.0
    left.update(Progress(tanh, 2176))  # half a second went for these, so half before
    clock.now = 5.5
    left.update(Progress(tanh, 2304))  # 256 steps a second
    assert left.seconds() == pytest.approx(1 + 0.5 + 2)
    with ProgressDisplay(plan, _runs(plan), 1, quiet=False, kept=kept) as display:
        clock.now += LINE_SECONDS
        display.update(Progress(tanh, 2304))
    assert capsys.readouterr().err == "0/2 runs ended, 85% of all steps\n"  # (2,304 + 2,048) / 5,120


def test_the_time_left_follows_from_the_pace_of_the_steps(plan: Plan) -> None:
    clock = _Clock()
    left = TimeLeft(_runs(plan), workers=1, clock=clock.monotonic)
    tanh, relu = plan.cells
    assert left.seconds() is None
    clock.now = 3.0
    left.update(Progress(tanh, 256))
    assert left.seconds() is None  # one report has no pace
    clock.now = 4.0
    left.update(Progress(tanh, 512))  # 256 steps a second; 2 s went before the first step
    assert left.seconds() == pytest.approx(8 + 2 + 10)  # 2,048 steps here, then all of the other
    clock.now = 6.0  # nothing new: the rest of this run gets shorter all the same
    assert left.seconds() == pytest.approx(6 + 2 + 10)
    left.update(Progress(tanh, 2560, "done"))
    assert left.seconds() == pytest.approx(2 + 10)
    left.update(Progress(relu, 2560, "done"))
    assert left.seconds() == 0


def test_what_kind_a_run_is_of_is_worked_out_once(plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    """It digests all settings, and is asked for every run at every report."""
    asked: list[Run] = []

    def counted(run: Run) -> str:
        asked.append(run)
        return kind(run)

    monkeypatch.setattr(foresight, "kind", counted)
    clock = _Clock()
    tanh, relu = plan.cells
    runs = {f"{place:016x}": replace(tanh.run, seed=place) for place in range(50)}
    left = TimeLeft(runs, workers=2, clock=clock.monotonic)
    for begun in range(20):
        cell = replace(tanh, seed=begun, run=runs[f"{begun:016x}"], run_id=f"{begun:016x}")
        for step in (256, 512):
            clock.now += 1
            left.update(Progress(cell, step))
        told = left.seconds()
    assert told is not None and told > 0
    assert len(asked) == len(runs)
