"""The records of a study's runs, as one tidy table for other programs."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis import EDGED_BANDS, EXPORT_TABLES
from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import curve_names, curves_table, study_curves
from pneuma.analysis.study_data import RUN_KEY_COLUMNS, StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.errors import Hint, UserError
from pneuma.store.quantities import EPISODE_QUANTITIES
from pneuma.store.row_builder import record_frame
from pneuma.store.store import Store


def export_records(
    study_data: StudyData,
    table_name: str,
    store: Store,
    window: str | None = None,
    band: str = EDGED_BANDS[0],
) -> Answer:
    """Return one of `EXPORT_TABLES`. It contains no times, so that the same runs give the same table.

    Args:
        study_data: an opened study.
        table_name: its name.
        store: the results folder, which has the records of episodes and updates.
        window: of curves: which episodes a point averages.
        band: of curves: what low and high are, one of `EDGED_BANDS`.

    Raises:
        UserError: if the runs do not have such records.
    """
    if table_name == "curves":
        frame = _curves(study_data, window, band)
    elif table_name == "summary":
        frame = summary_table(study_data)
    elif table_name == "evaluations" and study_data.evaluated:
        frame = study_data.evaluations
    else:
        frame = _records(study_data, table_name, store)
    about = {**study_data.about, "table": table_name, "rows": len(frame)}
    return Answer(f"{study_data.full_title}: {table_name}", about, {table_name: frame}, [frame])


def _curves(study_data: StudyData, window: str | None, band: str) -> pd.DataFrame:
    """Return all curves that every run has. Returns that were averaged when recorded are named so."""
    window = study_data.checked_window(window)
    recorded_names = curve_names(study_data)
    quantities: list[str] = []
    for quantity in EPISODE_QUANTITIES:
        if quantity in recorded_names and all(window in run.windows_of(quantity) for run in study_data.rows):
            quantities.append(quantity)
    if "share_killed" in recorded_names:
        quantities.append("share_killed")
    if not quantities:
        raise UserError(
            f"study {study_data.study.name}: {study_data.origin} has no returns, and so no curves"
        )
    curve_table = curves_table(study_curves(study_data, quantities, window), [band]).rename(
        columns={"x": "step"}
    )
    if study_data.averaged_over is not None:
        curve_table["averaged_over"] = study_data.averaged_over
    return curve_table


def _records(study_data: StudyData, table_name: str, store: Store) -> pd.DataFrame:
    """Return the records of all runs, which published tables do not have."""
    if table_name == "evaluations" or (study_data.averaged_over and table_name != "metrics"):
        other_tables = ", ".join(other_table for other_table in EXPORT_TABLES if other_table != table_name)
        raise UserError(
            f"study {study_data.study.name}: {study_data.origin} holds no {table_name}; try {other_tables}"
        )
    if any(run.published for run in study_data.rows):
        problem = f"study {study_data.study.name}: published tables do not contain {table_name}"
        raise UserError(f"{problem}; train the runs, or choose others with ", Hint("steps"))
    run_frames: list[pd.DataFrame] = []
    for condition, seed, run_id in study_data.runs[list(RUN_KEY_COLUMNS)].itertuples(index=False):
        frame = record_frame(store, run_id, table_name)
        run_frames.append(frame.assign(condition=condition, seed=seed, run_id=run_id))
    records = pd.concat(run_frames, ignore_index=True)
    return records[list(dict.fromkeys([*RUN_KEY_COLUMNS, *records]))]
