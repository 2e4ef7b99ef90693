"""Quantities: each is a column of records and, if it has a title, a curve, drawn and published by its row."""

from __future__ import annotations

from pathlib import Path

from pneuma.analysis.curves import curve_names, find_curves
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS, VALUE_COLUMNS
from pneuma.figures.curves import curves_page
from pneuma.store.quantities import PUBLISHED_CURVES, QUANTITIES, evaluation_column
from pneuma.store.store import Store

from ..hand_made import save_run, study_of
from .published_runs import republished

COLUMNS = {
    "episodes": EPISODE_COLUMNS,
    "metrics": METRIC_COLUMNS,
    "evaluations": (*EVALUATION_COLUMNS, *VALUE_COLUMNS),
}


def test_every_quantity_is_recorded_and_every_metric_is_a_quantity() -> None:
    for name, quantity in QUANTITIES.items():
        assert evaluation_column(name) in COLUMNS[quantity.table], name
    metrics = {name for name, quantity in QUANTITIES.items() if quantity.table == "metrics"}
    assert metrics == {*METRIC_COLUMNS} - {"step"}


def test_a_row_alone_makes_a_recorded_column_a_curve_that_is_drawn_and_published(tmp_path: Path) -> None:
    run_id = "a0" * 8
    steps = range(50, 1001, 50)
    recorded = [{"step": step, "return": 0.5} for step in steps]
    evaluations = [{"step": step, "success": 0.5} for step in steps]
    save_run(store := Store(tmp_path), run_id, recorded, recorded, evaluations, 1000)
    data = study_of(store, {("a", 0): run_id})
    titles = {name: quantity.title for name, quantity in QUANTITIES.items() if quantity.title}
    names = curve_names(data)
    assert sorted(names) == sorted(titles)
    page = curves_page(find_curves({"": data}, names))
    (panels,) = page.grid
    assert [panel.title for panel in panels if panel] == [titles[name] for name in names]
    kept = {name for name in names if QUANTITIES[name].table == "evaluations" or QUANTITIES[name].published}
    assert {*curve_names(republished(data, tmp_path, *PUBLISHED_CURVES))} == kept
    assert {*titles} - kept == {"grad_norm_actor", "grad_norm_critic"}
    (row,) = data.rows
    for name in names:
        quantity = QUANTITIES[name]
        for statistic in (*quantity.exact, *(["peak"] if quantity.extreme else [])):
            assert row.cell(f"{name} {statistic}") is not None, (name, statistic)
