"""What a person sees while a study runs never stops it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.study.plan import Selection, make_plan
from pneuma.study.progress import ProgressDisplay
from pneuma.study.spec import load_study
from pneuma.study.store import Store


def test_no_name_reaches_the_terminal_raw(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """A condition's name may be an escape sequence that sets the window's title."""
    plan = make_plan(load_study("activation"), Selection(seeds=(0,), conditions=("tanh",)))
    cell = replace(plan.cells[0], condition="\x1b]0;a\x07")
    plan = replace(plan, cells=(cell,))
    with ProgressDisplay(plan, {cell.run_id: cell.run}, Store(tmp_path), quiet=False) as display:
        display.update(cell, {"event": "note", "text": "begins"})
    assert capsys.readouterr().err == "\\u001b]0;a\\u0007 seed 0: begins\n"
