"""What the benchmarks of engines tell, on runs of a moment."""

from __future__ import annotations

import pytest

from pneuma.bench import engines, reference, workers

pytestmark = pytest.mark.slow


def test_an_updates_operations_by_hand() -> None:
    """Of the text's agents, 60 numbers into 128 and 256 units, five logits and a value; 10 epochs of 256."""
    update, operations = engines._update("small")
    first, last = 60 * (128 + 256), 128 * 5 + 256
    assert operations == (4 * first + 6 * last) * 256 * 10
    assert update()


def test_every_case_is_measured_and_each_engine_by_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "CASES", (("small", 1, 512, 256, 1), ("small", 10, 256, 256, 1)))
    monkeypatch.setattr(engines, "SIZES", {"small": {}})
    monkeypatch.setattr(engines, "UPDATES", {"small": 1})
    told = engines.measure()
    names = ["small network, 1 run", "small network, 10 runs"]
    assert [(row["case"], row["engine"], row["runs"]) for row in told["cases"]] == [
        (names[0], "batched", 1), (names[0], "sb3", 1), (names[1], "batched", 10), (names[1], "sb3", 1),
    ]  # fmt: skip
    assert list(told["ratios"]) == names
    assert told["update_over_matrix_product"]["small"] > 0 and told["matrix_product_gflops"] > 0
    assert told["peak_megabytes_ten_small"] > 100


def test_what_listening_costs_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "STEPS", 512)
    monkeypatch.setattr(reference, "ROUNDS", 1)
    told = reference.measure()
    assert [row["engine"] for row in told["cases"]] == ["sb3", "Stable-Baselines3"]
    assert 0.2 < told["ratios"][reference.CASE] < 5


def test_two_workers_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "ROUNDS", 1)
    told = workers.bench_workers()
    assert [row["workers"] for row in told["cases"]] == [1, 2] and told["ratio"] > 0
