"""The loop of a search: laws of its trials, which hold whatever a run is worth."""

from __future__ import annotations

import json
import math
import random
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from optuna import Study
from optuna.pruners import MedianPruner
from optuna.storages.journal import JournalFileBackend
from optuna.trial import FrozenTrial, TrialState

from pneuma.config import ENGINE_VERSIONS
from pneuma.engines import loop
from pneuma.engines.loop import planned_evaluations
from pneuma.search import trials, values
from pneuma.search.log import read_record
from pneuma.search.samplers import PRUNERS, SAMPLERS
from pneuma.search.spec import OVER_SEEDS, Objective
from pneuma.search.values import combine, read_rows, trial_value
from pneuma.store.store import Status, Store
from pneuma.study.plan import Cell, Plan
from pneuma.training.execute import CellResult

from .conftest import MEDIAN, Formula, FormulaRow, MakeTask, Task, height, open_log

RANGE = "[space.gamma]\nlow = 0.8\nhigh = 1.0\n[run]\nhorizon = 64\n"
ARGUMENTS = {"nsga-ii": "population_size = 4", "median": "n_startup_trials = 2"}
"""Of samplers and pruners that do nothing in as few trials as here, otherwise."""


@pytest.fixture(autouse=True)
def twenty_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluate these short runs as often as long ones."""
    monkeypatch.setattr(loop, "SHORT_STEPS", 0)


class Killed(Exception):
    """The process ends."""


@pytest.mark.parametrize(
    "more",
    [
        *(f'[sampler]\nname = "{name}"\n{ARGUMENTS.get(name, "")}' for name in SAMPLERS),
        *(f'[pruner]\nname = "{name}"\n{ARGUMENTS.get(name, "")}' for name in PRUNERS),
        '[pruner]\nname = "optuna.pruners:HyperbandPruner"\nmax_resource = 20',
        '[sampler]\nname = "optuna.samplers:GPSampler"',
        '[sampler]\nname = "optuna.samplers:QMCSampler"\nqmc_type = "halton"',
    ],
)
@pytest.mark.filterwarnings("error")
def test_a_search_is_the_same_however_often_it_is_begun_or_killed(
    make_task: MakeTask, store: Store, formula: Formula, more: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is killed while it writes a line, of which a part is left in the log."""
    formula.status = "diverged" if "QMC" in more else "done"  # such trials have notes
    task = make_task(12, more=RANGE + more)
    alone = task.solve()
    assert [trial["number"] for trial in alone] == list(range(12))
    assert len({trial["params"]["learning_rate"] for trial in alone}) > 6  # a population of 4 repeats some
    assert make_task(5, more=RANGE + more).solve() == alone[:5]  # fewer trials are the first of more
    append = JournalFileBackend.append_logs
    generator = random.Random(1)
    left = 0

    def append_or_die(self: Any, logs: list[dict[str, Any]]) -> None:
        nonlocal left
        left -= 1
        if left == 0:
            line = json.dumps(logs[0])
            with open(self._file_path, "a") as file:
                file.write(line[: generator.randrange(len(line))])
            raise Killed
        append(self, logs)

    monkeypatch.setattr(JournalFileBackend, "append_logs", append_or_die)
    kills, found_trials = 0, None
    while found_trials is None:
        left = generator.randrange(1, 60)
        try:
            found_trials = task.solve(store)
        except Killed:
            kills += 1
    assert kills > 2 and found_trials == alone


def test_a_published_search_is_found_again(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its outcomes are those in its log, by which TPE and the median pruner went when it was run."""
    published = read_record(store, "tune-adam", "arena")

    def read_published(store: Store, cells: Sequence[Cell], step: int | None = None) -> list[FormulaRow]:
        return [FormulaRow(cell, step or cell.run.steps, "done") for cell in cells]

    def outcome(row: FormulaRow, name: str) -> float:
        trial = published.trials[int(row.cell.condition.removeprefix("trial-"))]
        numbers = {planned.step: planned.number for planned in planned_evaluations(row.cell.run)}
        return trial.intermediate_values[numbers[row.step]]

    monkeypatch.setitem(ENGINE_VERSIONS, "batched", 3)  # which trained its runs
    monkeypatch.setattr(trials, "read_rows", read_published)
    monkeypatch.setattr(values, "outcome", outcome)
    found_trials = Task(published.search, published.budget).record(store).ended
    assert [trial.state for trial in found_trials] == [trial.state for trial in published.ended]
    for trial, old in zip(found_trials, published.ended, strict=True):
        assert trial.params["betas"] == old.params["betas"]
        assert trial.params["learning_rate"] == pytest.approx(old.params["learning_rate"], rel=1e-12)
        assert trial.values == pytest.approx(old.values)
        if trial.params == old.params:  # to the last digit, which another processor may round otherwise
            assert trial.user_attrs["config_id"] == old.user_attrs["config_id"]


def test_the_first_trials_are_those_that_it_starts_with(make_task: MakeTask) -> None:
    found_trials = make_task(4, start='start = ["table-6-1", { learning_rate = 1e-3 }]').solve()
    assert found_trials[0]["params"] == {"learning_rate": 3e-4, "activation": "relu"}
    assert found_trials[0]["values"][0] == pytest.approx(1 - 0.2 * abs(np.log10(3e-4) + 3) - 0.1 + 0.005)
    assert found_trials[1]["params"]["learning_rate"] == 1e-3 and "activation" in found_trials[1]["params"]


def test_what_optuna_enqueues_is_the_next_trial(make_task: MakeTask, store: Store) -> None:
    """With the other parameters suggested; values outside of the space fail, and say so."""
    study = open_log(make_task(4).record(store).path)
    study.enqueue_trial({"learning_rate": 2e-3})
    study.enqueue_trial({"learning_rate": 9.0})
    study.enqueue_trial({"activation": "sine"})
    found_trials = make_task(8).solve(store)
    assert found_trials[4]["params"]["learning_rate"] == 2e-3
    assert found_trials[4]["params"].keys() == {"learning_rate", "activation"}
    assert [trial["state"] for trial in found_trials] == ["complete"] * 5 + ["failed"] * 2 + ["complete"]
    assert found_trials[5]["note"] == "was enqueued with learning_rate = 9.0, which is not in its space"


def test_a_trial_that_another_program_asks_for_is_left_to_it(make_task: MakeTask, store: Store) -> None:
    assert open_log(make_task(4).record(store).path).ask().number == 4
    found_trials = make_task(12).solve(store)
    assert [trial["number"] for trial in found_trials] == [0, 1, 2, 3, *range(5, 12)]


# --- Pruning ---------------------------------------------------------------------------------------


def told_to_stop(task: Task) -> set[int]:
    """Return the trials that notes tell were stopped early."""
    notes = " ".join(note for note in task.notes if note.startswith("Stopped early"))
    return {int(number) for number in re.findall(r"\d+", notes)}


@pytest.mark.parametrize(
    ("pruner", "pauses"),
    [  # by hand, from Optuna's definitions; a run has 20 evaluations
        ('name = "median"', [5, 10, 15]),
        ('name = "optuna.pruners:PercentilePruner"\npercentile = 10.0', [*range(1, 20)]),
    ],
)
def test_training_pauses_where_the_pruner_decides(
    make_task: MakeTask, pruner: str, pauses: list[int]
) -> None:
    task = make_task(4, f"[run]\nhorizon = 64\n[pruner]\n{pruner}")
    (trial, *_) = task.solve()
    steps = [until[trial["run_ids"][0]] for until in task.asked]
    assert steps == [2048 * pause // 20 for pause in pauses] + [0]


def test_a_median_stops_what_is_below_it(make_task: MakeTask) -> None:
    """By hand: those below the median of the complete trials of earlier generations, of 4 each."""
    sampler = '[sampler]\nname = "random"\n'
    pruner = '[pruner]\nname = "median"\nn_startup_trials = 4\nn_warmup_steps = 10\ninterval_steps = 10'
    task = make_task(16, f"[run]\nhorizon = 64\n{sampler}{pruner}")
    found_trials = task.solve()
    assert all(trial["state"] == "complete" and len(trial["reports"]) == 20 for trial in found_trials[:4])
    stopped = set()
    for index, trial in enumerate(found_trials[4:], 4):
        earlier = [other for other in found_trials[: index // 4 * 4] if other["state"] == "complete"]
        median = np.median([other["reports"][10] for other in earlier])
        best = max(trial["reports"][step] for step in range(1, 11))
        assert (trial["state"] == "pruned") == bool(best < median)
        if trial["state"] == "pruned":
            stopped.add(trial["number"])
            assert [*trial["reports"]] == [*range(1, 11)]
            assert trial["values"] == (trial["reports"][10],)
    assert told_to_stop(task) == stopped and stopped


@pytest.mark.parametrize(
    ("step", "paused", "reports"),
    [  # by hand: 4 updates are 5, 10, 15 and 20 twentieths; the first from 6 on is 10, and from 16 on 20
        (6, 1024, [5, 10]),
        (16, 0, [5, 10, 15, 20]),
    ],
)
def test_each_evaluation_is_reported_once_and_no_trial_is_stopped_at_its_end(
    make_task: MakeTask, step: int, paused: int, reports: list[int]
) -> None:
    pruner = f'name = "median"\nn_startup_trials = 1\nn_warmup_steps = {step}\ninterval_steps = 20'
    task = make_task(16, f"[run]\nhorizon = 512\n[pruner]\n{pruner}")
    found_trials = task.solve()
    assert {*task.asked[0].values()} == {paused}
    assert {trial["state"] for trial in found_trials} == ({"complete", "pruned"} if paused else {"complete"})
    for trial in found_trials:
        assert [*trial["reports"]] == ([5, 10, 15, 20] if trial["state"] == "complete" else reports)


def test_a_pruner_sees_of_its_own_generation_that_it_is_running(
    make_task: MakeTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a decision would depend on which process was faster; generations are of 4 trials."""
    prune, looks = MedianPruner.prune, 0

    def watch(pruner: MedianPruner, study: Study, trial: FrozenTrial) -> bool:
        nonlocal looks
        for other in study.trials[trial.number // 4 * 4 : trial.number]:
            looks += 1
            assert other.state == TrialState.RUNNING and not other.intermediate_values
        return prune(pruner, study, trial)

    monkeypatch.setattr(MedianPruner, "prune", watch)
    make_task(8, RANGE + '[pruner]\nname = "median"\nn_startup_trials = 2').solve()
    assert looks > 20


# --- Several processes -----------------------------------------------------------------------------


def test_processes_that_search_together_find_what_one_would(make_task: MakeTask, store: Store) -> None:
    """Whenever this one trains, another goes on with the same search for some rounds, and is killed then."""
    lives = 0

    def train(plan: Plan, until: Mapping[str, int]) -> list[CellResult]:
        nonlocal lives
        if lives < 5:
            lives += 1
            rounds = iter(range(lives))

            def train_or_die(plan: Plan, until: Mapping[str, int]) -> list[CellResult]:
                if next(rounds, None) is None:
                    raise Killed
                return []

            with suppress(Killed):
                make_task(12, more=MEDIAN).solve(store, train_or_die)
        return []

    assert make_task(12, more=MEDIAN).solve(store, train) == make_task(12, more=MEDIAN).solve()
    assert lives == 5


def test_what_another_process_ends_meanwhile_is_neither_told_again_nor_said_to_stop_early(
    make_task: MakeTask, store: Store, formula: Formula, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While this one reads the values of a trial, another ends the whole search."""
    task = make_task(8, more=MEDIAN)
    default = formula.read_rows
    others: list[Any] = []

    def read_meanwhile(*args: Any) -> Any:
        if not others:
            others.append(None)
            others[0] = make_task(8, more=MEDIAN).solve(store)
        return default(*args)

    monkeypatch.setattr(formula, "read_rows", read_meanwhile)
    found_trials = task.solve(store)
    assert found_trials == others[0]
    assert told_to_stop(task) <= {trial["number"] for trial in found_trials if trial["state"] == "pruned"}


# --- Values ----------------------------------------------------------------------------------------


def test_a_run_without_a_number_fails_its_trial_alone(make_task: MakeTask, formula: Formula) -> None:
    formula.value = lambda cell: float("nan") if cell.run.activation == "relu" else height(cell)
    for trial in make_task(8).solve():
        failed = trial["params"]["activation"] == "relu"
        assert trial["state"] == ("failed" if failed else "complete")
        assert ("final-share-killed" in trial["note"]) == failed


def test_over_seeds_by_hand() -> None:
    combined = {name: combine(name, np.array([1.0, 2, 3, 8])) for name in OVER_SEEDS}
    expected = {"mean": 3.5, "median": 2.5, "iqm": 2.5, "deviation": math.sqrt(29 / 3)}
    assert combined == pytest.approx(expected)


@pytest.mark.parametrize(
    ("outcome", "over_seeds", "direction", "value"),
    [  # by hand, of 0.5 and of 0.7 that diverged; a share lies between 0 and 1, a return has no bounds
        ("final-share-killed", "mean", "maximize", 0.25),
        ("final-share-killed", "mean", "minimize", 0.75),
        ("final-share-killed", "deviation", "minimize", math.sqrt(0.5)),  # of 0 and 1
        ("final-return", "mean", "maximize", 0.6),
        ("final-return", "deviation", "minimize", math.sqrt(0.02)),
    ],
)
def test_a_diverged_run_counts_with_the_worst_that_can_be(
    monkeypatch: pytest.MonkeyPatch, outcome: str, over_seeds: str, direction: str, value: float
) -> None:
    monkeypatch.setattr(values, "outcome", lambda row, name: row.value)
    objective = Objective(outcome=outcome, over_seeds=over_seeds, direction=direction)
    rows: Any = [SimpleNamespace(value=0.5, status="done"), SimpleNamespace(value=0.7, status="diverged")]
    assert trial_value(objective, rows) == pytest.approx(value)


def test_a_run_that_diverges_after_a_pause_has_its_values_from_before(
    make_task: MakeTask, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that what a pruner decided at the pause is decided again once the run's end is known."""
    run = make_task().search.make_run({"learning_rate": 1e-3, "activation": "tanh"}, steps=2048)
    cell = Cell("trial-000", 1000, run)
    monkeypatch.setattr(Store, "status", lambda *_: Status("diverged", 250))
    monkeypatch.setattr(values, "stored_row", lambda *_: "end")
    monkeypatch.setattr(values, "row_until", lambda *args: args[-1])
    rows = [read_rows(store, [cell], step)[0] for step in (100, 200, 250, 300, None)]
    assert rows == [100, 200, "end", "end", "end"]
