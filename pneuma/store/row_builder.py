"""Build the row of a finished run: from its records to the cells of `rows.py`.

    tables of an engine's records, or points of an imported log → `Recorded` → `row_cells`

Runs are measured here alone. Functions of series of values are in `series.py`.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pneuma.config import Run
from pneuma.engines.records import POLICY_FILE
from pneuma.errors import UserError
from pneuma.files import parse_json, stored_file
from pneuma.store import rows, series
from pneuma.store.checkpoints import sound_checkpoint, table_files
from pneuma.store.quantities import (
    EPISODE_QUANTITIES,
    LOGGED_BY_EPISODE,
    POWERS,
    QUANTITIES,
    UPDATE_QUANTITIES,
    WINDOWS,
)
from pneuma.store.rows import Row, curve_column, decode_row, encode_row
from pneuma.store.store import ROW_FILE, SCALARS_FILE, Status, Store, run_document, run_identity
from pneuma.store.tables import from_parquet

if TYPE_CHECKING:
    import pandas as pd  # for imported logs alone: workers do not load it

UNKNOWN = "0" * 16
"""The configuration's id of runs without one."""

LEVELS = 512
"""The greatest number of steps in a curve's range; panels of figures are about as many pixels high."""


def recorded_from_tables(fields: Mapping[str, Any], tables: Mapping[str, pa.Table]) -> series.Recorded:
    """Return the records in a run's tables."""
    episodes, updates = _sorted(tables["episodes.parquet"]), _sorted(tables["metrics.parquet"])
    quantities: dict[str, series.Series] = {}
    for record_table, columns in ((episodes, EPISODE_QUANTITIES), (updates, UPDATE_QUANTITIES)):
        steps = record_table["step"].to_numpy().astype(float)
        for column in columns:
            if column in record_table.column_names:
                quantities[column] = steps, record_table[column].to_numpy().astype(float)
    _, first_rows = np.unique(episodes["slot"].to_numpy(), return_index=True)
    first_step = math.inf
    if len(first_rows) == (fields.get("slots") or 0) * fields.get("players", 1) > 0:
        first_step = float(episodes["step"].to_numpy()[first_rows].max())
    return series.Recorded(quantities, tables["evaluations.parquet"].to_pylist(), first_step)


def _sorted(record_table: pa.Table) -> pa.Table:
    return record_table.take(np.argsort(record_table["step"].to_numpy(), kind="stable"))


# --- Of stored runs ----------------------------------------------------------------------------------


def stored_row(store: Store, run_id: str) -> Row:
    """Return the row of a finished run; if it is missing or damaged, make it from the run's other files."""
    with suppress(Exception):  # a damaged row may raise any error
        return decode_row(store.read_file(run_id, ROW_FILE))
    with stored_file(store.run_folder(run_id)):
        status = store.status(run_id, quick=True)
        encoded_row = encode_row(cells_of_files(run_id, status, _stored_files(store, run_id)))
        row = decode_row(encoded_row)
    with suppress(UserError):  # a folder that cannot be written is still read
        store.save_row(run_id, encoded_row)
    return row


def row_until(store: Store, run_id: str, run: Run, step: int) -> Row:
    """Return the row of a run as if it had ended at a step, from its files or its latest checkpoint."""
    if store.status(run_id, quick=True).finished:
        files = _stored_files(store, run_id)
        files.pop(POLICY_FILE, None)  # it is the one at the end
    else:
        latest_checkpoint = sound_checkpoint(store.run_folder(run_id))
        if latest_checkpoint is None or latest_checkpoint.step < step:
            raise UserError(
                f"{store.run_folder(run_id)}: has no valid checkpoint at step {step:,}; search again"
            )
        files = {f"{table}.parquet": data for table, data in table_files(latest_checkpoint.records).items()}
    files |= {"run.json": run_document(replace(run, steps=step), run_id), "provenance.json": b"{}"}
    status = Status("done", step, identity=run_identity(run))
    return decode_row(encode_row(cells_of_files(run_id, status, files, until=step)))


def _stored_files(store: Store, run_id: str) -> dict[str, bytes]:
    return {file: store.read_file(run_id, file) for file in store.checksums(run_id) if file != ROW_FILE}


def cells_of_files(
    run_id: str, status: Status, files: Mapping[str, bytes], until: int | None = None
) -> dict[str, Any]:
    """Return the cells of a finished run's row, from its files, or their rows up to a step."""
    fields, provenance = parse_json(files["run.json"])["run"], parse_json(files["provenance.json"])
    tables_by_file = {}
    for file_name, contents in files.items():
        if file_name.endswith(".parquet"):
            record_table = from_parquet(contents)
            if until is not None:
                record_table = record_table.filter(pc.field("step") <= until)
            tables_by_file[file_name] = record_table
    if SCALARS_FILE in tables_by_file:
        from pneuma.store.points import recorded_from_log

        recorded = recorded_from_log(tables_by_file[SCALARS_FILE].to_pandas(use_threads=False), provenance)
    else:
        recorded = recorded_from_tables(fields, tables_by_file)
    cells = row_cells(run_id, status, fields, recorded, provenance)
    if POLICY_FILE in files:
        from pneuma.engines.policy import checksum_of_file  # its networks are compiled: rows are read without

        cells[rows.POLICY] = checksum_of_file(files[POLICY_FILE])
    return cells


def record_frame(store: Store, run_id: str, table_name: str) -> pd.DataFrame:
    """Return a run's episodes or metrics for export; those of an imported log are all its scalars by step."""
    file_name = SCALARS_FILE if SCALARS_FILE in store.checksums(run_id) else f"{table_name}.parquet"
    with stored_file(store.run_folder(run_id) / file_name):
        frame = from_parquet(store.read_file(run_id, file_name)).to_pandas()
    if file_name == SCALARS_FILE:
        from pneuma.store.points import log_table

        frame = log_table(frame, parse_json(store.read_file(run_id, "provenance.json")))
    return frame


# --- The cells --------------------------------------------------------------------------------------


def row_cells(
    run_id: str,
    status: Status,
    fields: Mapping[str, Any],
    recorded: series.Recorded,
    provenance: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the cells of a finished run's row, by column; those of an import have fewer `fields`."""
    update_values: dict[str, np.ndarray] = {}
    update_steps = np.empty(0)
    for quantity in UPDATE_QUANTITIES:
        if quantity in recorded.series:
            steps, values = recorded.series[quantity]
            if not update_values:
                update_steps = steps
            if np.array_equal(steps, update_steps):  # quantities of an imported log may have other steps
                update_values[quantity] = values
    signs, stuck_counts = series.update_signs(update_steps, update_values)
    cells: dict[str, Any] = {
        "run_id": run_id,
        "config_id": status.identity.config_id if status.identity else UNKNOWN,
        "status": status.name,
        "end": status.step,
        "seed": fields.get("seed") or 0,
        "steps": fields["steps"],
        "fields": json.dumps(fields),
        "provenance": json.dumps(provenance),
        "signs": series.pack_signs(signs),
    }
    if recorded.averaged_over:
        cells[rows.AVERAGED_OVER] = recorded.averaged_over
    if update_values:
        cells |= dict(zip(rows.STUCK, stuck_counts, strict=True))
    grid = series.make_grid(fields["steps"])
    with np.errstate(over="ignore"):  # sums of returns of 1e308 are infinite
        for quantity in recorded.series:
            cells |= _quantity_cells(recorded, quantity, grid, status.step)
    if "return" in recorded.series and not recorded.averaged_over:
        curve = np.array(cells[curve_column("return", WINDOWS[0])])
        cells[rows.LAST_EPISODES] = _last_episodes(recorded.series["return"][0], curve, grid)
    return {**cells, rows.EVALUATIONS: list(recorded.evaluations)}


def _last_episodes(step: np.ndarray, curve: np.ndarray, grid: np.ndarray) -> float:
    """Return how many episodes the last point of a curve of returns averages."""
    curve_steps, _ = series.finite_points(grid, curve)
    if not len(curve_steps):
        return 0.0
    window = grid[-1] * series.WINDOW_POINTS / series.GRID_POINTS
    is_averaged = (step > curve_steps[-1] - window) & (step <= curve_steps[-1])
    return float(is_averaged.sum())


def _quantity_cells(recorded: series.Recorded, quantity: str, grid: np.ndarray, end: int) -> dict[str, Any]:
    """Return the cells of one quantity: its rounded curves, and the exact numbers of these."""
    curves = _curves(recorded, quantity, grid, end)
    step, values = series.finite_points(grid, next(iter(curves.values())))
    cells: dict[str, Any] = {}
    if len(values):
        for statistic in QUANTITIES[quantity].exact:
            column = f"{quantity} {statistic}"
            cells[column] = series.curve_statistic(statistic, step, values, float(grid[-1]))
    if quantity in series.EXTREMES:
        extreme = series.EXTREMES[quantity]
        curve = series.peak_curve(*recorded.series[quantity], grid, extreme)
        curves[f"{quantity} {rows.PEAKS}"] = curve
        if np.isfinite(curve).any():
            cells[f"{quantity} {rows.PEAK}"] = float(extreme.reduce(curve))
    rounded_curves = {column: _rounded(curve, quantity).tolist() for column, curve in curves.items()}
    return rounded_curves | cells


def _curves(recorded: series.Recorded, quantity: str, grid: np.ndarray, end: int) -> dict[str, np.ndarray]:
    """Return a quantity's curves by their columns, the default one first."""
    step, values = recorded.series[quantity]
    if recorded.averaged_over:
        step, values = series.joined_points(step, values, grid)
    if quantity in UPDATE_QUANTITIES:
        return {quantity: series.update_curve(step, values, grid, end)}
    if recorded.averaged_over:
        single_values = values.astype(np.float32).astype(float)
        return {curve_column(quantity, WINDOWS[1]): series.held_curve(step, single_values, grid, end)}
    mean_curve = partial(series.episode_curve, step, values, grid, from_step=recorded.first_step, end=end)
    curves = {curve_column(quantity, WINDOWS[0]): mean_curve(trailing=False)}
    if quantity in LOGGED_BY_EPISODE:
        curves[curve_column(quantity, WINDOWS[1])] = mean_curve(trailing=True)
    return curves


def _rounded(values: np.ndarray, quantity: str) -> np.ndarray:
    """Round a curve to a five-hundredth of its range, to multiples of a power of two, which compress well.

    A curve of powers or over several orders of magnitude, without negative values, is rounded in proportion
    to each value instead, as its logarithm is what matters.
    """
    finite_values = values[np.isfinite(values)]
    if not len(finite_values) or finite_values.min() == finite_values.max():
        return values
    lowest, highest = float(finite_values.min()), float(finite_values.max())
    is_of_powers = QUANTITIES[quantity].kind == POWERS
    if lowest >= 0 and (is_of_powers or highest > LEVELS * finite_values[finite_values > 0].min()):
        fraction, exponent = np.frexp(values)
        return np.ldexp(np.round(fraction * LEVELS) / LEVELS, exponent)
    span = highest - lowest
    if not sys.float_info.min * LEVELS < span < math.inf:
        return values
    level = _power_of_two_from(span / LEVELS)
    levels = np.round(values / level)
    if lowest < 0:  # the sign of a return is a sign of collapse, so it stays
        levels = np.where((levels == 0) & (values != 0), np.sign(values), levels)
    return levels * level


def _power_of_two_from(number: float) -> float:
    """Return the least power of two that is not below a positive number."""
    fraction, exponent = math.frexp(number)  # a half or more, and below 1
    return math.ldexp(1.0, exponent - 1 if fraction == 0.5 else exponent)
