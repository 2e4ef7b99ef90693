"""What the benchmarks of engines tell: by hand where they reckon, and that they run where they measure."""

from __future__ import annotations

import json

import pytest

from pneuma.bench import engines, reference
from pneuma.bench.workers import CASE
from pneuma.cli import main


def test_ratios_are_the_medians_of_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """By hand: 10 over 5, 30 over 6 and 24 over 8 steps a second are 2, 5 and 3."""
    monkeypatch.setattr(engines, "CASES", (("small", 10, 512, 256, 3),))
    monkeypatch.setattr(engines, "_alternate", lambda *_: ([10.0, 30.0, 24.0], [5.0, 6.0, 8.0]))
    monkeypatch.setattr(engines, "_update_shares", lambda: ({"small": 0.5}, 100.0))
    told = engines.measure()
    case = "small network, 10 runs"
    assert told["ratios"] == {case: 3.0}
    assert told["cases"] == [
        {"case": case, "engine": "batched", "runs": 10, "steps_per_second": 24.0},
        {"case": case, "engine": "sb3", "runs": 1, "steps_per_second": 6.0},
    ]
    assert (told["update_over_matrix_product"], told["matrix_product_gflops"]) == ({"small": 0.5}, 100.0)


def test_the_command_tells_what_was_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(engines, "CASES", (("small", 10, 512, 256, 3),))
    monkeypatch.setattr(engines, "_alternate", lambda *_: ([10.0, 30.0, 24.0], [5.0, 6.0, 8.0]))
    monkeypatch.setattr(engines, "_update_shares", lambda: ({"small": 0.5}, 100.0))
    two = {"case": CASE, "engine": "batched", "runs": 2, "steps_per_second": 48.0}
    measured = engines.measure()
    whole = {
        **measured,
        "cases": [*measured["cases"], two],
        "ratios": {**measured["ratios"], CASE: 1.75},
    }
    monkeypatch.setattr(engines, "bench_engines", lambda: whole)
    monkeypatch.setattr(reference, "bench_reference", lambda: {"ratios": {reference.CASE: 1.0625}})
    assert main(["bench", "engines"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["small", "network,", "10", "runs", "batched", "24", "steps/s"]
    assert "small network, 10 runs: batched over sb3, median of rounds: 3.00" in lines
    assert f"{CASE}, median of rounds: 1.75" in lines
    assert f"{reference.CASE}: sb3 over Stable-Baselines3 alone, time per step: 1.062" in lines
    assert "the small update runs at 50% of the core's matrix product of 100 GFLOP/s" in lines
    assert main(["bench", "engines", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == {"schema": 1, **whole, "reference_overhead": {reference.CASE: 1.0625}}


@pytest.mark.slow
def test_an_updates_operations_by_hand() -> None:
    """Of the text's agents, 60 numbers into 128 and 256 units, five logits and a value; 10 epochs of 256."""
    update, operations = engines._update("small")
    first, last = 60 * (128 + 256), 128 * 5 + 256
    assert operations == (4 * first + 6 * last) * 256 * 10
    assert update()


@pytest.mark.slow
def test_engines_are_measured_in_turn() -> None:
    own, other = (engines._run("small", engine, 0, 256) for engine in ("batched", "sb3"))
    ours, theirs = engines._alternate([own, own], [other], rounds=2)
    assert len(ours) == len(theirs) == 2 and max(ours) > max(theirs)


@pytest.mark.slow
def test_what_listening_costs_is_told_of_both(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "STEPS", 512)
    monkeypatch.setattr(reference, "ROUNDS", 1)
    told = reference.measure()
    ours, theirs = (row["steps_per_second"] for row in told["cases"])
    assert [row["engine"] for row in told["cases"]] == ["sb3", "Stable-Baselines3"]
    assert told["ratios"][reference.CASE] == pytest.approx(theirs / ours)
