"""The records of a study's runs, as one tidy table for other programs."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis import EDGED_BANDS, EXPORT_TABLES
from pneuma.analysis.curves import curve_names, curves_table, study_curves
from pneuma.analysis.study_data import RUN_KEY_COLUMNS, StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.answers.answer import Answer
from pneuma.errors import Hint, UserError
from pneuma.store.quantities import EPISODE_QUANTITIES
from pneuma.store.row_builder import record_frame
from pneuma.store.store import Store


def export_records(
    data: StudyData, table: str, store: Store, window: str | None = None, band: str = EDGED_BANDS[0]
) -> Answer:
    """Return one of `EXPORT_TABLES`. It contains no times, so that the same runs give the same table.

    Args:
        data: an opened study.
        table: its name.
        store: the results folder, which has the records of episodes and updates.
        window: of curves: which episodes a point averages.
        band: of curves: what low and high are, one of `EDGED_BANDS`.

    Raises:
        UserError: if the runs do not have such records.
    """
    if table == "curves":
        frame = _curves(data, window, band)
    elif table == "summary":
        frame = summary_table(data)
    elif table == "evaluations" and data.evaluated:
        frame = data.evaluations
    else:
        frame = _records(data, table, store)
    about = {**data.about, "table": table, "rows": len(frame)}
    return Answer(f"{data.full_title}: {table}", about, {table: frame}, [frame])


def _curves(data: StudyData, window: str | None, band: str) -> pd.DataFrame:
    """Return all curves that every run has. Returns that were averaged when recorded are named so."""
    window = data.checked_window(window)
    recorded = curve_names(data)
    names: list[str] = []
    for name in EPISODE_QUANTITIES:
        if name in recorded and all(window in run.windows_of(name) for run in data.rows):
            names.append(name)
    if "share_killed" in recorded:
        names.append("share_killed")
    if not names:
        raise UserError(f"study {data.study.name}: {data.what} has no returns, and so no curves")
    table = curves_table(study_curves(data, names, window), [band]).rename(columns={"x": "step"})
    if data.averaged_over is not None:
        table["averaged_over"] = data.averaged_over
    return table


def _records(data: StudyData, table: str, store: Store) -> pd.DataFrame:
    """Return the records of all runs, which are stored here alone."""
    if table == "evaluations" or (data.averaged_over and table != "metrics"):
        other_tables = ", ".join(name for name in EXPORT_TABLES if name != table)
        raise UserError(f"study {data.study.name}: {data.what} holds no {table}; try {other_tables}")
    if any(run.published for run in data.rows):
        lack = f"study {data.study.name}: published tables do not contain {table}"
        raise UserError(f"{lack}; train the runs, or choose others with ", Hint("steps"))
    frames: list[pd.DataFrame] = []
    for condition, seed, run_id in data.runs[list(RUN_KEY_COLUMNS)].itertuples(index=False):
        frame = record_frame(store, run_id, table)
        frames.append(frame.assign(condition=condition, seed=seed, run_id=run_id))
    records = pd.concat(frames, ignore_index=True)
    return records[list(dict.fromkeys([*RUN_KEY_COLUMNS, *records]))]
