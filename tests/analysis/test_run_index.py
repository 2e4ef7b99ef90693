"""Finished runs of a study, wherever they are: in a results folder, published tables, or imported logs."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pneuma.analysis.curves import study_curves
from pneuma.analysis.export import export_records
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.imports.tensorboard import import_tensorboard
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.quantities import TRAINING_QUANTITIES
from pneuma.store.store import Status, Store
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study
from pneuma.training.execute import prepare

from ..cli.calls import save_finished
from ..hand_made import save_listing, study_of, write_events
from .published_runs import outcomes_of, publish, republished, save_run

BUDGET = 1000  # the grid is 5, 10, … 1,000, and 5 % are 50
B0, B1, A0, A1 = "b0" * 8, "b1" * 8, "a0" * 8, "a1" * 8
CELLS = {("b", 0): B0, ("a", 0): A0, ("b", 1): B1}


def trained(store: Store) -> StudyData:
    """Store a study: a done run and a diverged one of `b`, a done one of `a`."""
    save_run(store, B0, 0)
    save_run(store, B1, 1, end=400, status="diverged")
    save_run(store, A0, 0)
    return study_of(store, CELLS)


def imported(store: Store) -> StudyData:
    """Import a study of two runs of `b`, one of them cut short, and one of `a`."""
    logs = store.root.parent / "logs"
    for number, (name, end) in enumerate((("b_0", BUDGET), ("b_1", 400), ("a_0", BUDGET))):
        points = []
        for k in range(1, end // 100 + 1):
            points += [("rollout/ep_rew_mean", 100 * k, k / 4), ("train/entropy_loss", 100 * k, -k / 8)]
        write_events(logs / name / "events.out.tfevents.1.host", [*points, ("time/fps", end, float(number))])
    import_tensorboard([logs], store)
    return open_study(RunIndex(store, shipped=False), Query(study="logs"))


@pytest.fixture(params=["runs", "logs", "published runs", "published logs", "partly runs", "partly logs"])
def data(request: pytest.FixtureRequest, store: Store, tmp_path: Path) -> StudyData:
    """Three runs: stored, published, or one of both, one published alone and one trained again in vain."""
    data = imported(store) if "logs" in request.param else trained(store)
    if request.param.startswith("published"):
        return republished(data, tmp_path)
    if request.param.startswith("partly"):
        publish(data, store)
        for run in data.rows[1:]:
            shutil.rmtree(store.run_folder(run.run_id))
        store.save_run(data.rows[2].run_id, Status("crashed", 100), {})
        data = open_study(RunIndex(store, shipped=False), Query(study=data.study.name))
        assert [run.published for run in data.rows] == [False, True, True]
    return data


def test_every_quantity_has_a_curve_that_ends_with_its_run(data: StudyData) -> None:
    assert {"return", "entropy"} <= {*data.quantities} <= {*TRAINING_QUANTITIES}
    for quantity in data.quantities:
        for run in data.rows:
            for window in {*data.windows} & {*run.windows_of(quantity)}:
                curve = data.curve(run, quantity, window)
                assert curve.shape == (200,)
                if window == data.windows[0]:
                    assert np.isfinite(curve[data.grid == run.end]).all()
                assert np.isnan(curve[data.grid > run.end]).all()
    (b,) = [curve for curve in study_curves(data, ["return"])["return"] if curve.condition == "b"]
    assert b.frame().set_index("x")["runs"][[400, 405, 1000]].tolist() == [2, 1, 1]


@pytest.mark.parametrize("data", ["runs", "logs"], indirect=True)
def test_a_published_table_is_read_as_what_it_was_made_from(
    data: StudyData, store: Store, tmp_path: Path
) -> None:
    again = republished(data, tmp_path / "again")
    for key in ("study", "conditions", "duplicates", "fields", "windows", "quantities"):
        assert getattr(again, key) == getattr(data, key)
    assert outcomes_of(again) == outcomes_of(data)
    for run, other in zip(data.rows, again.rows, strict=True):
        assert other.same_numbers(run) and other.fields == run.fields
    assert again.runs[["condition", "seed"]].equals(data.runs[["condition", "seed"]])
    for table in ("curves", "summary", *(["evaluations"] if data.evaluated else [])):
        ours, theirs = export_records(again, table, store), export_records(data, table, store)
        pd.testing.assert_frame_equal(ours.table, theirs.table)
    with pytest.raises(UserError, match="published tables do not contain episodes|holds no episodes"):
        export_records(again, "episodes", store)


def test_a_run_that_has_other_numbers_than_its_published_row_is_reported_and_used(store: Store) -> None:
    publish(trained(store), store)
    save_run(store, A0, 1)  # as if trained again, with other returns
    index = RunIndex(store, shipped=False)
    lines: list[str] = []
    data = open_study(index, Query(study="mine"), say=lines.append)
    returns = {run.run_id: run.statistic("return", "last") for run in data.rows}
    assert returns[A0] == pytest.approx(returns[B0] + 1 / 3)
    table = store.published_path("mine")
    assert f"{table}: its run {A0} has other numbers here; those here are used" in index.problems


def test_logs_give_what_was_logged(store: Store, tmp_path: Path) -> None:
    points = [("rollout/ep_rew_mean", 100 * k, float("nan") if k == 2 else k / 4) for k in range(1, 11)]
    points += [("train/entropy_loss", 100, -0.125), ("charts/SPS", 150, 9.0), ("own", 1000, 2.0)]
    points += [("train/entropy_loss", 200, -0.0625), ("train/approx_kl", 100, 0.5)]  # at unlike steps
    write_events(tmp_path / "logs" / "a_1" / "events.out.tfevents.1.host", points)
    import_tensorboard([tmp_path / "logs"], store)
    data = open_study(RunIndex(store), Query(study="logs"))
    (a,) = data.rows
    at = {int(step): place for place, step in enumerate(data.grid)}
    curve = data.curve(a, "return")
    places = [at[95], at[100], at[195], at[200], at[300]]
    np.testing.assert_array_equal(curve[places], [np.nan, 0.25, np.nan, np.nan, 0.75])
    assert data.curve(a, "entropy")[at[100]] == 0.125 and a.signs == {"no entropy": [(200, 200)]}
    table = export_records(data, "metrics", store).table
    assert list(table.columns)[3:] == ["step", "return_mean_100", "entropy", "approx_kl", "logged/own"]
    np.testing.assert_array_equal(table["return_mean_100"], [0.25, np.nan, *(k / 4 for k in range(3, 11))])


# --- What is left out -----------------------------------------------------------------------------


def test_only_finished_runs_count_and_the_others_are_counted(store: Store) -> None:
    trained(store)
    store.save_run(A1, Status("crashed"), {})
    save_listing(store, {**CELLS, ("a", 1): A1})
    lines: list[str] = []
    assert len(open_study(RunIndex(store, shipped=False), Query(study="mine"), say=lines.append).runs) == 3
    assert lines == ["mine: 3 of 4 runs."]
    with pytest.raises(UserError, match="study mine has no finished run in"):
        open_study(RunIndex(store, shipped=False), Query(study="mine", seeds=(1,), conditions=("a",)))


def test_untrusted_a_table_that_lists_a_study_by_another_name_than_its_own_is_not_a_study(
    store: Store,
) -> None:
    """Names become those of figures, and the folder may be anybody's."""
    row = trained(store).rows[0]
    runs = [{"run_id": row.run_id, "condition": "a", "seed": 0}]
    listing = {"study": "../../out", "title": "", "baseline": "a", "runs": runs}
    store.write(
        store.published_path("table"), encode_published([row], {"study": "table", "listing": listing})
    )
    with pytest.raises(UserError, match="unknown study 'table'"):
        open_study(RunIndex(store, shipped=False), Query(study="table"))


def test_every_listed_study_that_comes_with_pneuma_can_be_opened(store: Store) -> None:
    index = RunIndex(store)
    names = index.listings()
    assert "author-logs" in names and all(map(index.listing, names))


OWN = """
title = "Own"
base = "table-6-2"
[run]
env = "CartPole-v1"
env_module = "of_mine_alone"
[conditions.one]
[presets.quick]
seeds = 2
steps = 256
"""


def test_runs_of_a_changed_module_count_as_of_another_version_without_the_studys_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    module, study, store = Path("of_mine_alone.py"), Path("mine.toml"), Store("results")
    module.write_text("import gymnasium\n")
    study.write_text(OWN)
    plan = make_plan(load_study("mine"), Query(study="mine"))
    prepare(plan, store)
    save_finished(store, plan.cells[0].run)
    study.unlink()
    lines: list[str] = []

    def coverage() -> str:
        assert len(open_study(RunIndex(store), Query(study="mine"), say=lines.append).runs) == 1
        return lines[-1].partition(": ")[2]

    assert coverage() == "1 of 2 runs."
    module.write_text("import gymnasium  # as before\n")
    assert coverage() == "1 of 2 runs (1 by an earlier version)."
    save_finished(store, make_plan(load_study("mine", copies=store.studies), Query(seeds=(0,))).cells[0].run)
    assert coverage() == "1 of 2 runs."
    module.unlink()  # its runs are still known by its name
    assert coverage() == "1 of 2 runs (1 by an earlier version)."
