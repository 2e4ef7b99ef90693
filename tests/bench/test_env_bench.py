"""The benchmark of the environment: its document, and that it measures what it says."""

from __future__ import annotations

import json
import time

import numpy as np
import pytest

from pneuma.bench import env as bench
from pneuma.bench.start import start_seconds
from pneuma.cli import main
from pneuma.env.worlds import Worlds


def test_document_has_every_case_with_a_positive_rate(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The schema of design section 2, with CartPole among the cases, and what stands beside it."""
    start = {"import_seconds": 0.1, "first_step_cold_seconds": 4.0, "first_step_warm_seconds": 0.2}
    monkeypatch.setattr(bench, "start_seconds", lambda: start)
    quick = bench.bench_env(rounds=1, seconds=0.01)
    monkeypatch.setattr(bench, "bench_env", lambda: quick)
    assert main(["bench", "env", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == 1
    for case in document["cases"]:
        assert case.keys() == {"case", "face", "worlds", "agent_steps_per_second"}
        assert case["agent_steps_per_second"] > 0 and case["worlds"] in (1, 64)
    assert {case["face"] for case in document["cases"]} == {"kernel", "single", "vector", "cartpole"}
    assert document["save_and_restore_microseconds"] > 0
    assert {key: document[key] for key in start} == start
    assert main(["bench", "env"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == len(document["cases"]) + 4


def test_a_rate_is_steps_over_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step that takes a tenth of a millisecond is taken 10,000 times a second."""
    now = 0.0

    def step(_: int) -> None:
        nonlocal now
        now += 1e-4

    monkeypatch.setattr(time, "perf_counter", lambda: now)
    assert bench._rate(step, 0.05) == pytest.approx(10_000)


def test_worst_case_keeps_every_monster_busy() -> None:
    worlds = Worlds(2)
    worlds.reset()
    bench._engage(worlds)
    for _ in range(300):
        worlds.step(np.zeros((2, 1), np.int64) + 4)
        assert (worlds.monsters["noticed"] == 1).all()
    assert (worlds.worlds["ending"] == 0).all() and (worlds.worlds["monsters_left"] == 14).all()


@pytest.mark.slow
def test_the_first_step_is_slower_with_an_empty_compile_cache() -> None:
    seconds = start_seconds(rounds=1)
    assert 0 < seconds["import_seconds"] < seconds["first_step_cold_seconds"]
    assert seconds["first_step_warm_seconds"] < seconds["first_step_cold_seconds"] / 3
