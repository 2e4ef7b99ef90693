"""`--executor`: what is reckoned and said of the place where runs are to be trained."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.cli import main
from pneuma.config import as_fields
from pneuma.study import estimate
from pneuma.study.executors import ray
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study

ADDRESS = "10.0.0.5:6379"


def test_a_plan_reckons_with_the_room_of_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    paces = estimate.Paces()
    for cell in make_plan(load_study("activation"), Selection()).cells:
        paces.add(as_fields(cell.run), 0.001)
    monkeypatch.setattr(estimate, "stored_paces", lambda *_: paces)
    monkeypatch.setattr(ray, "most_workers", lambda place: {ADDRESS: 40}[place.address])
    command = ["study", "plan", "activation", "--results", str(tmp_path)]
    assert main([*command, "--executor", "ray", "--address", ADDRESS]) == 0
    # all at once, 50,000 steps (50,176 in whole horizons) at a millisecond each, after a start of 4 s
    assert "To train: about 54 s with 40 at once" in capsys.readouterr().out
