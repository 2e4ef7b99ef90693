"""`--executor`: what is reckoned and said of the place where runs are to be trained."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.cli import main
from pneuma.config import as_settings
from pneuma.study import estimate
from pneuma.study.execute import prepare
from pneuma.study.executors import ray
from pneuma.study.executors.base import Place, Supervision
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store

ADDRESS = "10.0.0.5:6379"


def test_a_plan_reckons_with_the_room_of_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    paces = estimate.Paces()
    for cell in make_plan(load_study("activation"), Selection()).cells:
        paces.add(as_settings(cell.run), 0.001)
    monkeypatch.setattr(estimate, "stored_paces", lambda *_: paces)
    monkeypatch.setattr(ray, "most_workers", lambda place: {ADDRESS: 40}[place.address])
    command = ["study", "plan", "activation", "--results", str(tmp_path)]
    assert main([*command, "--executor", "ray", "--address", ADDRESS]) == 0
    # all at once, 50,000 steps (50,176 in whole horizons) at a millisecond each, after a start of 4 s
    assert "To train: about 54 s with 40 at once" in capsys.readouterr().out


def test_what_is_to_be_known_of_the_place_is_said_before_runs_go_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray, "check", lambda runs, how: f"{len(runs)} runs go to {how.place.address}")
    planned = make_plan(load_study("activation"), Selection(seeds=(0,), steps=256))
    here, away = Supervision(1), Supervision(1, place=Place("ray", ADDRESS))
    assert prepare(planned, Store(tmp_path), supervision=here).notes == ()
    assert prepare(planned, Store(tmp_path), supervision=away).notes == (f"3 runs go to {ADDRESS}",)
