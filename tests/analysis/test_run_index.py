"""One contract for what is held of a run: in a results folder, a published table, or imported logs."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pneuma.analysis.publishing import CURVES
from pneuma.analysis.stored_studies import study_record

from pneuma.analysis import EPISODE_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.curves import training_curves
from pneuma.analysis.export import encode_table
from pneuma.analysis.frames import StudyData
from pneuma.analysis.run_index import RunIndex, open_published, open_study
from pneuma.errors import UserError
from pneuma.study.imported import import_tensorboard
from pneuma.study.store import Status, Store

from ..hand_made import record_of, write_events
from .published_runs import publish, republished, save_run

BUDGET = 1000  # the grid is 5, 10, … 1,000, and 5 % are 50
SHIPPED = Path(__file__).parents[2] / "results"
B0, B1, A0, A1 = "b0" * 8, "b1" * 8, "a0" * 8, "a1" * 8


def trained(store: Store) -> dict[str, Any]:
    """Store a study: a done run and a diverged one of `b`, a done one of `a`, one that never ran."""
    save_run(store, B0, 0)
    save_run(store, B1, 1, end=400, status="diverged")
    save_run(store, A0, 0)
    return record_of({("b", 0): B0, ("a", 0): A0, ("b", 1): B1, ("a", 1): A1})


def imported(store: Store) -> dict[str, Any]:
    """Import a study of two runs of `b`, one of them cut short, and one of `a`."""
    logs = store.root.parent / "logs"
    for number, (name, end) in enumerate((("b_0", BUDGET), ("b_1", 400), ("a_0", BUDGET))):
        points = []
        for k in range(1, end // 100 + 1):
            points += [("rollout/ep_rew_mean", 100 * k, k / 4), ("train/entropy_loss", 100 * k, -k / 8)]
        write_events(logs / name / "events.out.tfevents.1.host", [*points, ("time/fps", end, float(number))])
    import_tensorboard([logs], store)
    return store.selection("logs") or {}


def partly_published(store: Store, record: dict[str, Any], **options: Any) -> StudyData:
    """Publish a study, lose two of its runs, and open it again."""
    publish(open_study(store, record), store, **options)
    gone = [run["run_id"] for run in record["runs"][1:3]]
    for name in gone:
        shutil.rmtree(store.run_folder(name))
    data = open_study(store, record)
    assert {run.run_id for run in data.published} == {*gone}
    return data


@pytest.fixture(params=["runs", "logs", "published runs", "published logs", "partly runs", "partly logs"])
def data(request: pytest.FixtureRequest, tmp_path: Path) -> StudyData:
    store = Store(tmp_path / "results")
    record = imported(store) if "logs" in request.param else trained(store)
    if request.param.startswith("partly"):
        return partly_published(store, record)
    found = open_study(store, record)
    return republished(found, tmp_path) if request.param.startswith("published") else found


# --- The contract ---------------------------------------------------------------------------------


def test_every_quantity_has_a_curve_that_ends_with_its_run(data: StudyData) -> None:
    assert {"return", "entropy"} <= {*data.quantities} <= {*EPISODE_QUANTITIES, *UPDATE_QUANTITIES}
    for quantity in data.quantities:
        for run in data.runs:
            for window in data.windows:
                if run.records.has_curve(quantity, window):
                    curve = data.curve(run, quantity, window)
                    assert curve.shape == (200,)
                    assert np.isfinite(curve[data.grid == run.end]).all()
                    assert np.isnan(curve[data.grid > run.end]).all()
    (b,) = [curve for curve in training_curves(data, "return") if curve.condition == "b"]
    assert [int(b.count[list(data.grid).index(step)]) for step in (400, 405, 1000)] == [2, 1, 1]


@pytest.mark.parametrize("data", ["runs", "logs"], indirect=True)
def test_a_published_table_is_read_as_what_it_was_made_from(data: StudyData, tmp_path: Path) -> None:
    again = republished(data, tmp_path / "again")
    assert again.runs == data.runs
    for key in ("conditions", "left_out", "same", "title", "figure", "environments", "windows"):
        assert getattr(again, key) == getattr(data, key)
    assert {*again.quantities} == {*data.quantities} & {*CURVES}
    for run, other in zip(data.runs, again.runs, strict=True):
        for quantity in again.quantities:
            ours, theirs = data.curve(run, quantity), again.curve(other, quantity)
            np.testing.assert_allclose(theirs, ours, atol=np.ptp(ours[np.isfinite(ours)]) / 512)
    for table in again.tables:
        assert encode_table(again, table, "csv") == encode_table(data, table, "csv")


# --- Values by hand -------------------------------------------------------------------------------


def test_logs_give_what_was_logged(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    points = [("rollout/ep_rew_mean", 100 * k, float("nan") if k == 2 else k / 4) for k in range(1, 11)]
    points += [("train/entropy_loss", 100, -0.125), ("charts/SPS", 150, 9.0), ("own", 1000, 2.0)]
    write_events(tmp_path / "logs" / "a_1" / "events.out.tfevents.1.host", points)
    import_tensorboard([tmp_path / "logs"], store)
    data = open_study(store, store.selection("logs") or {})
    (a,) = data.runs
    at = {int(step): place for place, step in enumerate(data.grid)}
    curve = data.curve(a, "return")
    places = [at[95], at[100], at[195], at[200], at[300]]
    np.testing.assert_array_equal(curve[places], [np.nan, 0.25, 0.25, np.nan, 0.75])
    assert data.curve(a, "entropy")[at[100]] == 0.125
    table = data.table("metrics")
    assert list(table.columns)[3:] == ["step", "return_mean_100", "entropy", "logged/own"]
    np.testing.assert_array_equal(table["return_mean_100"], [0.25, np.nan, *(k / 4 for k in range(3, 11))])


# --- Runs here, and runs that were published ------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"curves": ("entropy",)}, {"curves": ()}])
def test_a_study_is_the_same_whichever_of_its_runs_are_here(tmp_path: Path, options: dict[str, Any]) -> None:
    stores = [Store(tmp_path / name) for name in ("whole", "part")]
    whole = open_study(stores[0], trained(stores[0]))
    part = partly_published(stores[1], trained(stores[1]), **options)
    assert (part.runs, part.left_out) == (whole.runs, 1)
    assert encode_table(part, "evaluations", "csv") == encode_table(whole, "evaluations", "csv")
    kept = options.get("curves", CURVES)
    assert part.quantities == [name for name in whole.quantities if name in kept]
    assert open_study(stores[1], part.record, "none").left_out == 3


def test_a_name_stands_for_its_latest_selection_or_what_is_published(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    record = {**trained(store), "world": "arena"}
    publish(open_study(store, record), store)
    assert study_record(store, "mine", world="arena")["source"] == "published"
    store.save_selection("mine", record)
    assert "source" not in study_record(store, "mine")
    with pytest.raises(UserError, match="unknown study 'other'"):
        study_record(store, "other")
    store.write(store.published_path("bad"), b"PAR1")
    index = RunIndex(store)
    held = index.of_record(record)
    assert held[B0].status == Status("done", BUDGET) and held[A1].status == Status("planned")
    assert len(open_study(index, record).runs) == 3 and len(index.damaged) == 1


def test_a_table_of_another_budget_lends_its_runs_and_their_curves(tmp_path: Path) -> None:
    """On the longer grid a point has the last value up to it, and none beyond the run's end."""
    store = Store(tmp_path / "results")
    record = trained(store)
    publish(open_study(store, {**record, "study": "other"}), clone := Store(tmp_path / "clone"))
    (alone,) = open_published(clone.root)
    longer = {**record, "budget": 2 * BUDGET}
    assert open_study(clone, record).left_out == 1
    data = open_study(clone, longer)
    own, other = alone.curve(alone.runs[0], "return"), data.curve(data.runs[0], "return")
    np.testing.assert_array_equal(other, [*own[1::2], *[np.nan] * 100])


# --- What is left out -----------------------------------------------------------------------------


def test_only_finished_runs_count_and_without_one_the_command_that_trains_is_named(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    record = trained(store)
    store.save_run(A1, Status("crashed"), {})
    assert open_study(store, record).left_out == 1
    crashed = {**record, "runs": record["runs"][3:], "path": "/here/mine.toml"}
    with pytest.raises(UserError, match="no finished run of .* is in .*: run `pneuma study run /here/mine"):
        open_study(store, crashed)
    with pytest.raises(UserError, match="repeat the command that began it first"):
        open_study(store, {**crashed, "study": "fork-abcdef01-64-1a2b", "path": None})
    (store.run_folder(B0) / "episodes.parquet").write_bytes(b"damaged")
    assert open_study(store, record).left_out == 2


@pytest.mark.parametrize("key", ["study", "figure"])
@pytest.mark.parametrize("name", ["../../out", ""])
def test_a_record_whose_names_lead_elsewhere_is_refused(tmp_path: Path, key: str, name: str) -> None:
    """They become the names of figures and published tables, and the folder may be anybody's."""
    store = Store(tmp_path / "results")
    with pytest.raises(UserError, match=f"names its {key} .* no file name"):
        open_study(store, {**trained(store), key: name})


def test_tables_that_come_with_pneuma_stand_beside_runs_of_ones_own(tmp_path: Path) -> None:
    """Two published runs and one of our own, in a folder that holds the latter alone."""
    shipped = study_record(Store(tmp_path / "nowhere"), "activation-arena")
    record, store = trained(Store(tmp_path / "results")), Store(tmp_path / "results")
    tanh = [run for run in shipped["runs"] if run["condition"] == "tanh"][:2]
    ours = {**tanh[0], "condition": "ours", "run_id": A0}
    mine = {**record, "study": "mine", "runs": [*tanh, ours]}
    data = open_study(store, mine)
    assert [(run.condition, run.records.published) for run in data.runs] == [
        ("tanh", True), ("tanh", True), ("ours", False),
    ]  # fmt: skip
    theirs = open_published(SHIPPED, ["activation-arena"])[0]
    for run in data.of_condition("tanh"):
        same = next(own for own in theirs.runs if own.run_id == run.run_id)
        assert np.array_equal(data.curve(run, "return"), theirs.curve(same, "return"), equal_nan=True)
    assert RunIndex(store, shipped=False).of_record(mine)[tanh[0]["run_id"]].status.name == "planned"
    assert open_published(store.root) == []
