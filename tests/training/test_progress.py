"""What a person sees while a study runs never stops it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.store.store import Store
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study
from pneuma.training.progress import ProgressDisplay


def test_no_name_reaches_the_terminal_raw(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A condition's name may be an escape sequence that sets the window's title."""
    plan = make_plan(load_study("activation"), Query(seeds=(0,), conditions=("tanh",)))
    cell = replace(plan.cells[0], condition="\x1b]0;a\x07")
    plan = replace(plan, cells=(cell,))
    with ProgressDisplay({cell.run_id: cell.run}, Store(tmp_path), quiet=False) as display:
        display.update(cell, {"event": "note", "text": "begins"})
    assert capsys.readouterr().err == "\\u001b]0;a\\u0007 seed 0: begins\n"


def test_runs_that_pause_have_not_ended(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """As in the rounds of a search; by hand: of 2 x 3,072 steps, 960 are 16 %, and 3,712 are 60 %."""
    plan = make_plan(load_study("activation"), Query(seeds=(0, 1), steps=3000, conditions=("tanh",)))
    first, second = plan.cells
    until = {first.run_id: 640, second.run_id: 1280}
    todo = {cell.run_id: cell.run for cell in plan.cells}
    with ProgressDisplay(todo, Store(tmp_path), quiet=False, until=until) as display:
        display.update(second, {"event": "step", "step": 320})
        display.update(first, {"event": "end", "status": "stopped", "step": 640})
        assert "tanh seed 0: paused; 0/2 runs ended, 16 % of all steps" in capsys.readouterr().err
        display.update(second, {"event": "end", "status": "done", "step": 3072})
        assert "tanh seed 1: done; 1/2 runs ended, 60 % of all steps" in capsys.readouterr().err
