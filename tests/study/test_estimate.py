"""The runtime estimate: from runs like it, else from a table, times this machine's slowness."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.config import Run, as_fields, make_run
from pneuma.study.estimate import START_SECONDS, stored_paces
from pneuma.study.identity import run_id
from pneuma.study.provenance import machine
from pneuma.study.store import Status, Store, run_document, to_json

RUN = make_run({"steps": 2560})
HERE = {"cpu": machine()["cpu"], "device": "cpu"}
XEON = {"cpu": "Intel Xeon", "device": "cpu"}


def save(store: Store, run: Run, step: int, seconds: float, *machines: dict[str, Any]) -> None:
    """Store a run that took so long for its steps, on the last of some machines."""
    attempts = [{"machine": each, "step": step} for each in machines]
    about = {"wall_seconds": seconds + 9, "training_seconds": seconds, **machines[-1], "attempts": attempts}
    files = {"run.json": run_document(run, run_id(run)), "provenance.json": to_json(about)}
    store.save_run(run_id(run), Status("done", step), files)


def pace(store: Store, run: Run = RUN) -> float:
    """Return the seconds that a step of a run is estimated to take."""
    return (stored_paces(store, []).seconds(run, 1000) - START_SECONDS) / 1000


def test_a_run_like_those_that_ended_takes_as_long_on_such_a_processor(tmp_path: Path) -> None:
    """Runs on two processors tell nothing, those of another processor only where there are no others."""
    store = Store(tmp_path)
    save(store, replace(RUN, seed=1), 2560, 2560 * 0.004, XEON)
    save(store, replace(RUN, seed=2), 2560, 2560 * 0.9, HERE, XEON)
    assert pace(store) == pytest.approx(0.004)
    save(store, replace(RUN, seed=3), 2560, 2560 * 0.001, HERE)
    assert pace(store) == pytest.approx(0.001)


def test_a_pace_is_of_the_steps_that_were_trained(tmp_path: Path) -> None:
    """Of a diverged run they are fewer than its budget; of a fork, without its parent's."""
    store = Store(tmp_path)
    save(store, RUN, 512, 2.56, HERE)
    assert pace(store) == pytest.approx(2.56 / 512)
    fork = make_run({**as_fields(RUN), "horizon": 128, "parent": "a" * 16, "fork_step": 2304})
    save(store, fork, 2560, 2.56, HERE)
    assert pace(store, fork) == pytest.approx(2.56 / 256)
