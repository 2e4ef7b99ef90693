"""One contract for every source of a study's data: runs, logs, their tables, or some of each."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.analysis import EPISODE_QUANTITIES, RECORD_TABLES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.curves import training_curves
from pneuma.analysis.export import encode_table
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.partly_published import PartlyPublished
from pneuma.analysis.published import published_path, read_published
from pneuma.analysis.published_times import encode_times, times_path
from pneuma.analysis.publishing import encode_study
from pneuma.analysis.sources import open_study
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.study.imported import import_tensorboard
from pneuma.study.store import Status, Store, to_json
from pneuma.study.tables import to_parquet

BUDGET = 1000  # the grid is 5, 10, … 1,000, and 5 % are 50
WriteEvents = Callable[[Path, Any], Path]

EPISODES = ("slot", "episode", "step", "return", "length", "kills", "hp", "ending")
METRICS = ("step", "policy_loss", *UPDATE_QUANTITIES)
EVALUATIONS = ("step", "episodes", "share_killed", "return", "random_share_killed", "hunter_share_killed")


def save_run(store: Store, run_id: str, seed: int, end: int = BUDGET, status: str = "done") -> None:
    """Store a run of an episode every 50 steps, an update every 100 and an evaluation every 500.

    Episode k returns k + seed in k steps and kills k, update k has the value k / 4 throughout.
    """
    episodes = [
        (0, k, 50 * k, float(k + seed), k, k, 0.5, "killed")
        for k in range(1, BUDGET // 50 + 1)
        if 50 * k <= end
    ]
    metrics = [
        (100 * k, *[k / 4] * (len(METRICS) - 1)) for k in range(1, BUDGET // 100 + 1) if 100 * k <= end
    ]
    evaluations = [(500 * k, 50, k / 4 + seed / 8, 1.5, 0.1, 0.9) for k in (1, 2) if 500 * k <= end]
    tables: dict[str, tuple[tuple[str, ...], list[Any]]] = {
        "episodes": (EPISODES, episodes),
        "metrics": (METRICS, metrics),
        "evaluations": (EVALUATIONS, evaluations),
    }
    files = {
        f"{name}.parquet": to_parquet([dict(zip(columns, row, strict=True)) for row in rows], columns)
        for name, (columns, rows) in tables.items()
    }
    files["provenance.json"] = to_json(
        {"started": "now", "wall_seconds": 1.5, "python": "3.11", "packages": {}}
    )
    store.save_run(run_id, Status(status, end), files)


def trained(store: Store) -> dict[str, Any]:
    """Store a study: a done run and a diverged one of `b`, a done one of `a`, one that never ran."""
    save_run(store, "b0" * 8, 0)
    save_run(store, "b1" * 8, 1, end=400, status="diverged")
    save_run(store, "a0" * 8, 0)
    settings = {"env": "pneuma/Pneuma-v0", "slots": 1, "steps": BUDGET}
    cells = [("b", 0, "b0" * 8), ("a", 0, "a0" * 8), ("b", 1, "b1" * 8), ("a", 1, "a1" * 8)]
    runs = [{"condition": c, "seed": s, "run_id": i, "run": settings} for c, s, i in cells]
    return {
        "study": "mine",
        "title": "Mine",
        "figure": "fig-mine",
        "baseline": "b",
        "same": [],
        "selection": {},
        "runs": runs,
    }


def imported(store: Store, write_events: WriteEvents) -> dict[str, Any]:
    """Import a study of two runs of `b`, one of them cut short, and one of `a`."""
    logs = store.root.parent / "logs"
    for number, (name, end) in enumerate((("b_0", BUDGET), ("b_1", 400), ("a_0", BUDGET))):
        points = []
        for k in range(1, end // 100 + 1):
            points += [("rollout/ep_rew_mean", 100 * k, k / 4), ("train/entropy_loss", 100 * k, -k / 8)]
        write_events(
            logs / name / "events.out.tfevents.1.host",
            [*points, ("time/fps", end, float(number))],
        )
    import_tensorboard([logs], store)
    record = store.selection("logs")
    assert record is not None
    return record


@pytest.fixture(params=["runs", "imported", "published runs", "published logs", "partly published runs"])
def data(request: pytest.FixtureRequest, tmp_path: Path, write_events: WriteEvents) -> StudyData:
    store = Store(tmp_path / "results")
    record = (
        imported(store, write_events)
        if "logs" in request.param or request.param == "imported"
        else trained(store)
    )
    if request.param.startswith("partly"):
        return partly_published(store, record)
    found = open_study(store, record)
    return republished(found, tmp_path) if request.param.startswith("published") else found


def republished(data: StudyData, folder: Path) -> StudyData:
    """Return a study as it is read from its published table in a folder that holds nothing else."""
    clone = Store(folder / "clone")
    path = published_path(clone, data.study)
    path.parent.mkdir(parents=True)
    path.write_bytes(encode_study(data))
    return open_study(clone, read_published(clone, data.study).record)


def partly_published(store: Store, record: dict[str, Any], **options: Any) -> StudyData:
    """Publish a study, lose two of its runs, and open it again."""
    whole = open_study(store, record)
    store.write(published_path(store, whole.study), encode_study(whole, **options))
    store.write(times_path(store, whole.study), encode_times(whole))
    for name in ("b1" * 8, "a0" * 8):
        shutil.rmtree(store.run_folder(name))
    data = open_study(store, record)
    assert isinstance(data.source, PartlyPublished)
    assert data.source.published_ids == {"b1" * 8, "a0" * 8}
    return data


# --- The contract ---------------------------------------------------------------------------------


def test_runs_stand_in_the_selections_order_and_say_how_they_ended(data: StudyData) -> None:
    assert {run.condition for run in data.runs} == set(data.conditions) == {"a", "b"}
    assert [run.seed for run in data.of_condition("b")] == [0, 1]
    assert [run.end for run in data.of_condition("b")] == [BUDGET, 400]
    assert {run.status for run in data.runs} <= {"done", "diverged"}
    assert data.budget == BUDGET
    np.testing.assert_array_equal(data.grid, np.arange(1, 201) * 5)


def test_every_quantity_has_a_curve_on_the_grid_that_ends_with_its_run(data: StudyData) -> None:
    assert "return" in data.quantities and "entropy" in data.quantities
    assert set(data.quantities) <= {*EPISODE_QUANTITIES, *UPDATE_QUANTITIES}
    for quantity in data.quantities:
        for window in data.windows:
            for run in data.runs:
                curve = data.curve(run, quantity, window)
                assert curve.shape == (200,)
                assert np.isfinite(curve[data.grid == run.end]).all()
                assert np.isnan(curve[data.grid > run.end]).all()


def test_a_diverged_or_shorter_run_keeps_its_place_in_every_curve(data: StudyData) -> None:
    for curve in training_curves(data, "return"):
        assert curve.runs.shape == (len(data.of_condition(curve.condition)), 200)
    (b,) = [curve for curve in training_curves(data, "return") if curve.condition == "b"]
    assert [int(b.count[list(data.grid).index(step)]) for step in (400, 405, 1000)] == [2, 1, 1]


def test_the_usual_window_is_the_first_and_others_are_refused(data: StudyData) -> None:
    assert data.checked_window(None) == data.windows[0]
    run = data.runs[0]
    np.testing.assert_array_equal(data.curve(run, "return"), data.curve(run, "return", data.windows[0]))
    with pytest.raises(UserError, match="unknown window 'trailing-10'"):
        data.curve(run, "return", "trailing-10")
    for window in {*WINDOWS} - set(data.windows):
        with pytest.raises(UserError, match=f"window {window} cannot be had of study {data.study}"):
            data.curve(run, "return", window)


def test_a_final_value_is_had_at_the_runs_own_end(data: StudyData) -> None:
    for run in data.runs:
        for quantity in data.quantities:
            assert np.isfinite(data.final(run, quantity))


def test_a_quantity_that_there_is_not_is_refused_in_one_line(data: StudyData) -> None:
    for quantity in ({*EPISODE_QUANTITIES, *UPDATE_QUANTITIES} - set(data.quantities)) | {"glory"}:
        for ask in (data.curve, data.final):
            with pytest.raises(
                UserError, match=f"study {data.study}: .* holds no {quantity}; its curves are: "
            ):
                ask(data.runs[0], quantity)


def test_tables_say_to_which_run_a_row_belongs(data: StudyData) -> None:
    for name in data.tables:
        frame = data.table(name)
        assert list(frame.columns[:3]) == ["condition", "seed", "run_id"]
        assert list(dict.fromkeys(frame["run_id"])) == [
            run.run_id for run in data.runs if run.end >= 500 or name != "evaluations"
        ]


def test_a_table_that_there_is_not_is_refused_in_one_line(data: StudyData) -> None:
    for name in {*RECORD_TABLES, "actions"} - set(data.tables):
        with pytest.raises(UserError, match=rf"^study {data.study}: .* holds no {name}; there are .*curves$"):
            data.table(name)
        with pytest.raises(UserError, match=f"holds no {name}"):
            encode_table(data, name, "csv")


def test_every_run_tells_what_produced_it(data: StudyData) -> None:
    for run in data.runs:
        assert data.source.provenance(run)


def test_curves_can_be_exported_and_say_when_they_were_averaged_before(data: StudyData) -> None:
    text = encode_table(data, "curves", "csv")[0].decode()
    assert ("averaged_over" in text.splitlines()[0]) is (data.averaged_over == 100)


def test_a_published_table_is_read_as_what_it_was_made_from(data: StudyData, tmp_path: Path) -> None:
    again = republished(data, tmp_path / "again")
    assert again.runs == data.runs
    assert (again.conditions, again.left_out, again.same) == (data.conditions, data.left_out, data.same)
    assert (again.title, again.figure, again.environments) == (data.title, data.figure, data.environments)
    assert (again.windows, again.averaged_over, again.budget) == (
        data.windows,
        data.averaged_over,
        data.budget,
    )
    assert again.quantities == data.quantities
    for run in data.runs:
        for quantity in data.quantities:
            assert again.final(run, quantity) == data.final(run, quantity)
            for window in data.windows:
                one, other = data.curve(run, quantity, window), again.curve(run, quantity, window)
                np.testing.assert_array_equal(one, other)
    for table in ("curves", *again.tables):
        assert encode_table(again, table, "csv") == encode_table(data, table, "csv")


# --- Values by hand -------------------------------------------------------------------------------


def test_runs_give_the_means_of_their_episodes_and_updates(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    data = open_study(store, trained(store))
    diverged = data.of_condition("b")[1]  # seed 1, ended at 400
    at = {int(step): place for place, step in enumerate(data.grid)}
    assert data.curve(diverged, "return")[at[95]] == 2.0  # (45, 95]: the first, which returned 1 + 1
    assert data.curve(diverged, "kills", "trailing-100")[at[200]] == 2.5  # 1, 2, 3, 4
    assert data.curve(diverged, "entropy")[at[395]] == 0.75  # the third update's, at 300
    assert data.final(diverged, "return") == 5.5  # 2 … 9
    assert data.final(diverged, "grad_norm") == 1.0
    assert data.left_out == 1


def test_logs_give_what_was_logged(tmp_path: Path, write_events: WriteEvents) -> None:
    store = Store(tmp_path / "results")
    data = open_study(store, imported(store, write_events))
    (a,) = data.of_condition("a")
    at = {int(step): place for place, step in enumerate(data.grid)}
    curve = data.curve(a, "return")
    np.testing.assert_array_equal(curve[[at[95], at[100], at[195], at[200]]], [np.nan, 0.25, 0.25, 0.5])
    assert data.curve(a, "entropy")[at[100]] == 0.125
    assert (data.final(a, "return"), data.final(a, "entropy")) == (2.5, 1.25)
    table = data.table("metrics")
    assert list(table.columns) == ["condition", "seed", "run_id", "step", "return_mean_100", "entropy"]
    assert table[table["run_id"] == a.run_id]["return_mean_100"].tolist() == [k / 4 for k in range(1, 11)]


def test_a_nan_that_was_logged_stays_in_the_table_and_is_a_blank_in_the_curve(
    tmp_path: Path, write_events: WriteEvents
) -> None:
    store = Store(tmp_path / "results")
    points = [("rollout/ep_rew_mean", 100 * k, float("nan") if k == 2 else float(k)) for k in (1, 2, 3, 4)]
    write_events(tmp_path / "logs" / "a_1" / "events.out.tfevents.1.host", points)
    import_tensorboard([tmp_path / "logs"], store)
    data = open_study(store, store.selection("logs") or {})
    np.testing.assert_array_equal(data.table("metrics")["return_mean_100"], [1, np.nan, 3, 4])
    curve = data.curve(data.runs[0], "return")
    at = {int(step): place for place, step in enumerate(data.grid)}
    np.testing.assert_array_equal(curve[[at[198], at[200], at[298], at[300]]], [1, np.nan, np.nan, 3])


def test_episodes_of_cleanrl_are_averaged_over_the_last_hundred(
    tmp_path: Path, write_events: WriteEvents
) -> None:
    store = Store(tmp_path / "results")
    points = [("charts/episodic_return", k, float(k)) for k in range(1, 151)]
    points += [("charts/SPS", 150, 9.0), ("losses/entropy", 150, 1.5), ("own", 150, 2.0)]
    write_events(tmp_path / "logs" / "a_1" / "events.out.tfevents.1.host", points)
    import_tensorboard([tmp_path / "logs"], store)
    data = open_study(store, store.selection("logs") or {})
    (run,) = data.runs
    assert data.table("metrics")["return_mean_100"].iloc[[0, 1, 149]].tolist() == [1, 1.5, 100.5]
    assert (data.final(run, "return"), data.final(run, "entropy")) == (100.5, 1.5)
    assert list(data.table("metrics"))[3:] == ["step", "return_mean_100", "entropy", "logged/own"]


# --- Runs here, and runs that were published ------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"curves": ("entropy",)}, {"curves": (), "rounding": True}])
def test_a_study_is_the_same_whichever_of_its_runs_are_here(tmp_path: Path, options: dict[str, Any]) -> None:
    stores = [Store(tmp_path / name) for name in ("whole", "part")]
    whole = open_study(stores[0], trained(stores[0]))
    part = partly_published(stores[1], trained(stores[1]), **options)
    assert (part.runs, part.left_out) == (whole.runs, 1)
    assert options or encode_table(part, "curves", "csv") == encode_table(whole, "curves", "csv")
    for run in whole.runs:
        np.testing.assert_equal(
            [outcome(part, run, name) for name in OUTCOMES], [outcome(whole, run, name) for name in OUTCOMES]
        )


def test_curves_that_were_not_published_are_shown_of_none(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    data = partly_published(store, trained(store), curves=("entropy",))
    assert data.quantities == ["entropy"]
    assert open_study(store, data.record, mixed=False).left_out == 3


def test_a_part_of_a_study_is_had_on_the_points_of_the_whole(tmp_path: Path) -> None:
    """The longest run of the table is not asked for, and its curves' points are those that there are."""
    store = Store(tmp_path / "results")
    record = trained(store)
    record["runs"] = [{**run, "run": {**run["run"]}} for run in record["runs"]]
    record["runs"][0]["run"]["steps"] = 2 * BUDGET
    store.write(published_path(store, "mine"), encode_study(open_study(store, record)))
    shutil.rmtree(store.run_folder("b1" * 8))
    data = open_study(store, {**record, "runs": record["runs"][1:]})
    assert (len(data.runs), data.left_out, data.budget) == (2, 1, 2 * BUDGET)


def test_published_runs_with_other_points_stay_apart(tmp_path: Path) -> None:
    """The run here is twice as long as all that were published."""
    store = Store(tmp_path / "results")
    record = dict(partly_published(store, trained(store)).record)
    del record["budget"]
    record["runs"] = [{**run, "run": {**run["run"]}} for run in record["runs"]]
    record["runs"][0]["run"]["steps"] = 2 * BUDGET
    data = open_study(store, record)
    assert (len(data.runs), data.left_out, data.budget) == (1, 3, 2 * BUDGET)
