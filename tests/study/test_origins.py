"""Which runs were trained on something else than most, and how fast each kind of processor was."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.cli import main, study_run
from pneuma.config import Run, as_fields, make_run
from pneuma.errors import UserError
from pneuma.study import calibration, foresight
from pneuma.study.execute import selection_record
from pneuma.study.files import seal
from pneuma.study.identity import run_id
from pneuma.study.origins import stored_origins, unusual_origins
from pneuma.study.plan import Cell, Plan, Selection, make_plan
from pneuma.study.provenance import machine
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json

MILAN = {"cpu": "AMD Milan", "device": "cpu", "python": "3.11.7", "packages": {"jax": "0.10.2"}}
XEON = {**MILAN, "cpu": "Intel Xeon"}


def origin(*machines: dict[str, Any], started: str = "2026-01-01", seconds: float = 1.0) -> dict[str, Any]:
    """Return a provenance as it is written: the last machine's facts, and every attempt's."""
    attempts = [{"machine": each} for each in machines]
    return {"started": started, "wall_seconds": seconds, **machines[-1], "attempts": attempts}


# --- Marks -------------------------------------------------------------------------------------------


def test_what_was_trained_otherwise_than_most_is_marked_in_a_word() -> None:
    newer = {**MILAN, "packages": {"jax": "0.10.3"}}
    told = {
        "a": origin(MILAN),
        "b": origin(MILAN),
        "c": origin(XEON),
        "d": origin(newer),
        "e": origin(MILAN),
        "f": origin({**XEON, "python": "3.12.1"}),
    }
    both = "other processor, other packages"
    assert unusual_origins(told.items()) == {"c": "other processor", "d": "other packages", "f": both}
    assert unusual_origins([("a", origin(MILAN))]) == unusual_origins([]) == {}


def test_the_order_of_packages_is_no_difference() -> None:
    two = {**MILAN, "packages": {"jax": "1", "numpy": "2"}}
    other = {**MILAN, "packages": {"numpy": "2", "jax": "1"}}
    assert unusual_origins([("a", origin(two)), ("b", origin(other))]) == {}


def test_a_gpu_is_another_processor_and_so_is_a_way_over_two() -> None:
    gpu = {**MILAN, "device": "gpu: NVIDIA H200"}
    told = {"a": origin(MILAN), "b": origin(MILAN), "c": origin(gpu), "d": origin(XEON, MILAN)}
    assert unusual_origins(told.items()) == {"c": "other processor", "d": "other processor"}


def test_of_two_as_frequent_the_earlier_is_the_usual_one() -> None:
    late, early = origin(XEON, started="2026-02-01"), origin(MILAN, started="2026-01-01")
    assert unusual_origins([("a", late), ("b", early)]) == {"a": "other processor"}


def test_a_strangers_provenance_is_no_trouble(tmp_path: Path) -> None:
    for odd in ({}, {"attempts": 3}, {"attempts": [3, {"machine": []}]}, {"cpu": [1], "packages": 7}):
        unusual_origins([("a", odd), ("b", origin(MILAN))])
    store = Store(tmp_path)
    for i, told in enumerate((b"3", b"{", b'{"imported": true}', b'{"cpu": "x"}')):
        store.save_run(f"{i:016}", Status("done", 1), {"provenance.json": told})
    assert [*stored_origins(store, [f"{i:016}" for i in range(5)])] == [(f"{3:016}", {"cpu": "x"})]


def test_marking_thousands_of_runs_holds_no_list_of_what_they_tell() -> None:
    """A run here tells of fifty machines, some 30 kB; all of them would be 15 MB."""
    tracemalloc.start()
    try:
        told = ((f"{i}", origin(*(dict(MILAN) for _ in range(50)))) for i in range(500))
        assert unusual_origins(told) == {}
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


# --- Stored studies ----------------------------------------------------------------------------------


@pytest.fixture
def planned() -> Plan:
    return make_plan(
        load_study("activation"), Selection(seeds=(0, 1), steps=1000, conditions=("tanh", "relu"))
    )


def save(store: Store, plan: Plan, origins: list[dict[str, Any]]) -> None:
    """Store the plan's first runs as trained so, and the plan as the study's latest selection."""
    for cell, told in zip(plan.cells, origins, strict=False):
        files = {"run.json": run_document(cell.run, cell.run_id), "provenance.json": to_json(told)}
        store.save_run(cell.run_id, Status("done", cell.run.steps), files)
    store.save_selection(plan.study.name, selection_record(plan))


def test_status_and_show_tell_the_mark(
    tmp_path: Path, planned: Plan, capsys: pytest.CaptureFixture[str]
) -> None:
    save(Store(tmp_path), planned, [origin(MILAN), origin(MILAN), origin(XEON), origin(MILAN)])
    odd = planned.cells[2].run_id
    assert main(["study", "status", "activation", "--results", str(tmp_path)]) == 0
    marked = [line for line in capsys.readouterr().out.splitlines() if "than most" in line]
    assert len(marked) == 1 and odd in marked[0] and "(other processor than most)" in marked[0]
    assert main(["study", "status", "activation", "--results", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unlike_most"] == {odd: "other processor"}
    assert main(["run", "show", odd, "--results", str(tmp_path)]) == 0
    assert "other processor than most runs of study activation" in capsys.readouterr().out
    assert main(["run", "show", planned.cells[0].run_id, "--results", str(tmp_path)]) == 0
    assert "than most" not in capsys.readouterr().out


def test_paces_are_of_this_kind_of_processor_where_it_is_known(tmp_path: Path, planned: Plan) -> None:
    here, store = {**MILAN, "cpu": machine(1)["cpu"]}, Store(tmp_path)
    seconds = planned.cells[0].run.steps * 0.001  # a millisecond a step
    told = [origin(here, seconds=seconds), *(origin(XEON, seconds=n * seconds) for n in (4, 5, 6))]
    save(store, planned, told)
    statuses = {cell.run_id: store.status(cell.run_id) for cell in planned.cells}
    measured = foresight.measured_runs(planned, statuses, store)
    paces = foresight.known_paces(measured, store)
    assert [pace.per_step for pace in paces.values()] == [pytest.approx(0.001)]
    paces = foresight.known_paces(measured[1:], store)
    assert [pace.per_step for pace in paces.values()] == [pytest.approx(0.005)]
    speeds = foresight.processor_speeds(planned, measured)
    assert set(speeds) == {"tanh", "relu"}
    assert {name: (round(speed), runs) for name, (speed, runs) in speeds["tanh"].items()} == {
        here["cpu"]: (1000, 1),
        "Intel Xeon": (200, 3),
    }


def test_a_pace_is_of_the_steps_that_were_trained(tmp_path: Path, planned: Plan) -> None:
    """Of a diverged run they are fewer than its budget; of a fork, without its parent's."""
    store, cells = Store(tmp_path), planned.cells[:2]
    fork = make_run({**as_fields(cells[1].run), "parent": "a" * 16, "fork_step": cells[1].run.steps - 256})
    runs = {cells[0].run_id: (cells[0].run, "diverged", 512), run_id(fork): (fork, "done", fork.steps)}
    for name, (run, status, step) in runs.items():
        files = {"run.json": run_document(run, name), "provenance.json": to_json(origin(MILAN, seconds=2.56))}
        store.save_run(name, Status(status, step), files)
    plan = replace(planned, cells=(cells[0], Cell("fork", 0, fork, run_id(fork))))
    statuses = {name: store.status(name) for name in runs}
    rates = [each.per_step for each in foresight.measured_runs(plan, statuses, store)]
    assert rates == [pytest.approx(2.56 / 512), pytest.approx(2.56 / 256)]


def test_what_other_machines_measured_is_kept(
    tmp_path: Path, planned: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, told = Store(tmp_path), list[str]()
    monkeypatch.setattr(calibration, "_measure", lambda run: (foresight.Pace(1.0, 0.5), False))
    runs = [planned.cells[0].run]
    calibration.calibrate(runs, store, {}, told.append)
    monkeypatch.setattr(foresight, "_machine", lambda: "another")
    assert foresight.known_paces([], store) == {}
    calibration.calibrate(runs, store, {}, told.append)
    monkeypatch.undo()
    assert foresight.known_paces([], store) == {foresight.kind(runs[0]): foresight.Pace(1.0, 0.5)}
    assert told == ["measuring how fast this machine trains (1 of 1) …"] * 2


def test_where_a_pace_cannot_be_kept_a_plan_names_the_option_that_needs_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(store: Store) -> None:
        raise UserError(f"{store.root}: cannot be written")

    monkeypatch.setattr(Store, "check_writable", refuse)
    with pytest.raises(UserError, match="cannot be written; or plan without measuring: --no-calibrate"):
        study_run._calibrated([make_run({})], Store(tmp_path), {})


@pytest.mark.parametrize("told_so", [True, False])  # else it is what the start took that shows it
def test_a_start_that_compiled_is_measured_again(
    tmp_path: Path, planned: Plan, told_so: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every run of a plan would otherwise be told to take a compilation longer than it does."""
    run = replace(planned.cells[0].run, steps=1024)
    compiled, loaded = foresight.Pace(31.0, 0.01), foresight.Pace(2.0, 0.01)
    paces = iter([(compiled, told_so), (loaded, False)])
    monkeypatch.setattr(calibration, "_measure", lambda run: next(paces))
    told: list[str] = []
    assert calibration.calibrate([run], Store(tmp_path), {}, told.append) == {foresight.kind(run): loaded}
    assert told[1:] == ["it had to compile first; measuring once more …"]


def test_a_start_that_a_run_hardly_feels_is_measured_once(
    tmp_path: Path, planned: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A big network's first update comes after minutes, which another measurement would cost once more."""
    run = replace(planned.cells[0].run, steps=40_192)
    asked: list[Run] = []

    def measure(run: Run) -> tuple[foresight.Pace, bool]:
        asked.append(run)
        return foresight.Pace(60.0, 0.03), True

    monkeypatch.setattr(calibration, "_measure", measure)
    monkeypatch.setattr(calibration, "_with_evaluations", lambda run, pace: pace)
    found = calibration.calibrate([run], Store(tmp_path), {}, lambda text: None)
    assert found == {foresight.kind(run): foresight.Pace(60.0, 0.03)}
    assert asked == [run]


def test_a_run_too_slow_to_come_to_an_evaluation_is_told_its_evaluations(
    tmp_path: Path, planned: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A start of 3 s, updates of 2 s, and 20 evaluations, every one of which takes 10."""
    run = replace(planned.cells[0].run, steps=256 * 100)
    asked: list[tuple[int, float | None]] = []

    def watch(run: Run, seconds: float | None) -> calibration._Timed:
        asked.append((run.steps, seconds))
        if seconds:
            return calibration._Timed(100.0, [(105.0, 256), (107.0, 512)])
        return calibration._Timed(200.0, [(218.0, 256), (230.0, 512)])  # 3 s more were spent once

    monkeypatch.setattr(calibration, "_time", watch)
    (pace,) = calibration.calibrate([run], Store(tmp_path), {}, lambda text: None).values()
    assert asked == [(run.steps, calibration.MEASURED_SECONDS), (512, None)]
    assert pace.seconds(run.steps) == pytest.approx(3 + 100 * 2 + 20 * 10)


def test_runs_of_other_budgets_have_other_paces(planned: Plan) -> None:
    """All are evaluated as often, so that a step of a short run takes longer."""
    run = planned.cells[0].run
    assert foresight.kind(run) == foresight.kind(replace(run, seed=7))
    assert foresight.kind(run) != foresight.kind(replace(run, steps=2 * run.steps))


def test_a_run_that_changed_processors_times_neither(tmp_path: Path, planned: Plan) -> None:
    store = Store(tmp_path)
    save(store, planned, [origin(XEON, MILAN)])
    statuses = {cell.run_id: store.status(cell.run_id) for cell in planned.cells}
    assert foresight.measured_runs(planned, statuses, store) == []


def test_a_pace_leaves_out_what_waited_for_a_compilation_and_nothing_else() -> None:
    """Steps of 0.001 s, an evaluation that doubles one of them, and one that waited 20 s."""
    seconds = [0.256, 0.256, 0.512, 20.0, 0.256]
    moments = [(sum(seconds[:i]), 256 * i) for i in range(6)]
    assert calibration._usual_pace(moments) == pytest.approx((4 * 0.256 + 0.256) / 4 / 256)


@pytest.mark.parametrize("strange", [3, {"here": 3}, {"here": {"kind": 3}}, {"here": {"kind": ["a", "b"]}}])
def test_a_strangers_calibrations_are_none(strange: object, tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write(foresight._calibration_path(store), seal({"paces": strange}))
    assert not any(foresight._all_calibrations(store).values())
