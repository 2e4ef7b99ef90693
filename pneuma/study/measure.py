"""Measuring: from what a finished run recorded to the cells of its row (`rows.py`).

    tables of an engine's records, or points of an imported log → `Measured` → `row_cells`

Nothing else measures a run. Functions of series of values are in `series.py`.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pneuma.config import Run, as_fields, make_run
from pneuma.errors import UserError
from pneuma.files import parse_json
from pneuma.study import identity
from pneuma.study.checkpoints import TABLES, checkpoint_files, read_checkpoint, table_files
from pneuma.study.identity import own_names, run_id
from pneuma.study.quantities import (
    ACTION_QUANTITIES,
    EPISODE_QUANTITIES,
    EVALUATION_TAGS,
    UPDATE_QUANTITIES,
    WINDOWS,
)
from pneuma.study.rows import (
    AVERAGED_OVER,
    EVALUATIONS,
    EXACT,
    LAST_EPISODES,
    PEAKS,
    STUCK,
    Row,
    curve_column,
    decode_row,
    encode_row,
)
from pneuma.study.series import (
    EXTREMES,
    GRID_POINTS,
    STATISTICS,
    TRAILING_EPISODES,
    WINDOW_POINTS,
    Series,
    Stretch,
    episode_curve,
    held_curve,
    make_grid,
    pack_signs,
    peak_curve,
    stuck_updates,
    update_curve,
    update_signs,
)
from pneuma.study.store import ROW_FILE, SCALARS_FILE, Identity, Status, Store
from pneuma.study.tables import record_table

if TYPE_CHECKING:
    import pandas as pd  # of logs alone: workers do not load it

UNKNOWN = "0" * 16
"""The configuration id of a run that this version of Pneuma, or this machine's files, would not give."""

RELATIVE = ("grad_norm", "grad_norm_actor", "grad_norm_critic")
"""Quantities that are rounded in proportion to each value, as their logarithm is what matters."""
LEVELS = 512
"""Most steps into which a curve's range is divided; panels of figures are about as many pixels high."""

TAGS = {
    "return": ("rollout/ep_rew_mean", "charts/episodic_return"),
    "length": ("rollout/ep_len_mean", "charts/episodic_length"),
    "policy_loss": ("train/policy_gradient_loss", "losses/policy_loss"),
    "value_loss": ("train/value_loss", "losses/value_loss"),
    "entropy": ("train/entropy_loss", "losses/entropy"),
    "approx_kl": ("train/approx_kl", "losses/approx_kl"),
    "clip_fraction": ("train/clip_fraction", "losses/clipfrac"),
    "explained_variance": ("train/explained_variance", "losses/explained_variance"),
}
"""The tags of Stable-Baselines3 and CleanRL for each quantity."""
NEGATED = "train/entropy_loss"
ONE_EPISODE = ("charts/episodic_return", "charts/episodic_length")
"""Tags of single episodes, which are averaged as Stable-Baselines3 does before it logs."""
WALL_CLOCK = ("time/", "charts/SPS")


@dataclass(frozen=True)
class Measured:
    """A finished run that is to become a row.

    Attributes:
        fields: its resolved configuration, with steps and seed; of an import, what is known.
        end: agent steps trained.
        series: step and value of every episode or update, by quantity; steps do not decrease.
        evaluations: rows of the evaluations.
        first_step: from which every slot has finished an episode; infinite if one has none.
        averaged_over: episodes over which returns were averaged when they were logged; None if they were not.
    """

    run_id: str
    config_id: str
    fields: Mapping[str, Any]
    status: str
    end: int
    series: Mapping[str, Series]
    evaluations: Sequence[Mapping[str, Any]]
    provenance: Mapping[str, Any]
    first_step: float = math.inf
    averaged_over: int | None = None


def series_of_records(fields: Mapping[str, Any], tables: Mapping[str, pa.Table]) -> dict[str, Any]:
    """Return the series, evaluations and first step of a run's record tables, as keywords of `Measured`."""
    series: dict[str, Series] = {}
    for name, quantities in (("episodes", EPISODE_QUANTITIES), ("metrics", UPDATE_QUANTITIES)):
        table = tables[name]
        steps = table["step"].to_numpy().astype(float)
        order = np.argsort(steps, kind="stable")
        for quantity in quantities:
            if quantity in table.column_names:
                values = table[quantity].to_numpy().astype(float)
                series[quantity] = steps[order], values[order]
    episodes = tables["episodes"]
    firsts = episodes.group_by("slot").aggregate([("step", "min")])["step_min"].to_numpy()
    slots, players = fields.get("slots"), fields.get("players", 1)
    all_began = isinstance(slots, int) and isinstance(players, int) and len(firsts) == slots * players
    return {
        "series": series,
        "evaluations": tables["evaluations"].to_pylist(),
        "first_step": float(firsts.max()) if all_began and len(firsts) else math.inf,
    }


def series_of_log(scalars: pd.DataFrame) -> dict[str, Any]:
    """Return the series of an imported log's points (tag, step, value, superseded), likewise."""
    named = named_scalars(scalars)
    series = {}
    for quantity in (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES):
        points = named[named["name"] == quantity]
        if len(points):
            series[quantity] = points["step"].to_numpy(float), points["value"].to_numpy(float)
    return {"series": series, "evaluations": _logged_evaluations(named), "averaged_over": TRAILING_EPISODES}


_OF_RUNS = ("run_id", "condition", "seed")
"""Columns of which run an evaluation is; a log's tags of these names are left out."""


def _logged_evaluations(named: pd.DataFrame) -> list[Any]:
    """Return evaluations as rows, from the points of an imported log."""
    columns = {tag: name for name, tag in EVALUATION_TAGS.items()}
    found = named[named["tag"].str.startswith("eval/") & (named["tag"] != "eval/step")]
    found = found.assign(name=found["tag"].map(columns).fillna(found["tag"].str.removeprefix("eval/")))
    found = found[~found["name"].isin(_OF_RUNS)].drop_duplicates(["name", "step"], keep="last")
    return found.pivot(index="step", columns="name", values="value").reset_index().to_dict("records")


def named_scalars(scalars: pd.DataFrame) -> pd.DataFrame:
    """Return name, step and value of every point that no restart superseded, in the order of writing."""
    scalars = scalars[~scalars["superseded"].astype(bool)]
    values = scalars["value"].mask(scalars["tag"] == NEGATED, -scalars["value"])
    for tag in ONE_EPISODE:
        rows = scalars["tag"] == tag
        values[rows] = values[rows].rolling(TRAILING_EPISODES, 1).mean()
    plain = scalars["tag"].where(scalars["tag"].str.contains("/"), "logged/" + scalars["tag"])
    names = {tag: name for name, tags in TAGS.items() for tag in tags}
    return scalars.assign(name=scalars["tag"].map(names).fillna(plain), value=values)


# --- Of stored runs ----------------------------------------------------------------------------------


def stored_row(store: Store, name: str) -> Row:
    """Return the row of a finished run; if it is missing or damaged, it is made from the run's other files.

    Raises:
        UserError: when the run's own files are missing, damaged or invalid.
    """
    try:
        return decode_row(store.read_file(name, ROW_FILE))
    except (UserError, ValueError):
        pass
    folder = store.run_folder(name)
    try:
        files = {file: store.read_file(name, file) for file in store.checksums(name) if file != ROW_FILE}
        known = store.identity(name)
        found = known.config_id if known else _config_id(name, parse_json(files["run.json"])["run"])
        cells = cells_of_files(name, found, store.status(name, quick=True), files)
        data = encode_row(cells)
    except (KeyError, TypeError, ValueError) as error:
        raise UserError(f"{folder}: its records make no sense ({error})") from None
    with suppress(UserError):  # a folder that cannot be written is still read
        store.save_row(name, data, known or Identity(cells["config_id"], cells["seed"], cells["steps"]))
    return decode_row(data)


def row_until(store: Store, name: str, run: Run, step: int) -> Row:
    """Return the row that a run would have if it had ended at a step, from its files or latest checkpoint.

    Raises:
        UserError: when its files are missing or make no sense, or it has not been trained so far.
    """
    if store.status(name, quick=True).finished:
        files = {table: store.read_file(name, f"{table}.parquet") for table in TABLES}
    else:
        read = next(filter(None, map(read_checkpoint, checkpoint_files(store.run_folder(name)))), None)
        if read is None or read[0].step < step:
            raise UserError(
                f"{store.run_folder(name)}: has no sound checkpoint at step {step:,}; search again"
            )
        files = table_files(read[0].records)
    tables = {table: record_table(data, table) for table, data in files.items()}
    tables = {key: table.filter(pc.less_equal(table["step"], step)) for key, table in tables.items()}
    fields = as_fields(run)
    found = series_of_records(fields, tables)
    measured = Measured(name, identity.config_id(run), fields, "done", step, provenance={}, **found)
    return decode_row(encode_row(row_cells(measured)))


def cells_of_files(name: str, config_id: str, status: Status, files: Mapping[str, bytes]) -> dict[str, Any]:
    """Return the cells of a finished run's row, from the files that it leaves.

    Raises:
        KeyError, TypeError, ValueError: for files that make no sense.
    """
    fields = parse_json(files["run.json"])["run"]
    tables = {
        file.removesuffix(".parquet"): record_table(data, file.removesuffix(".parquet"))
        for file, data in files.items()
        if file.endswith(".parquet")
    }
    if "scalars" in tables:
        found = series_of_log(tables["scalars"].to_pandas(use_threads=False))
    else:
        found = series_of_records(fields, tables)
    about = parse_json(files["provenance.json"])
    return row_cells(Measured(name, config_id, fields, status.name, status.step, provenance=about, **found))


def _config_id(name: str, fields: Mapping[str, Any]) -> str:
    """Return the configuration id of a run that was stored without one.

    It is unknown if the fields do not give the run's id any more, or name a user's files, which are not read.
    """
    with suppress(UserError, OSError):
        run = make_run(fields)
        if not own_names(fields) and run_id(run) == name:
            return identity.config_id(run)
    return UNKNOWN


def record_frame(store: Store, name: str, table: str) -> pd.DataFrame:
    """Return a run's episodes or metrics as recorded, for export; of a log, all its scalars by step.

    Raises:
        UserError: when the file is missing, damaged or no such table.
    """
    logged = SCALARS_FILE in store.checksums(name)
    file = SCALARS_FILE if logged else f"{table}.parquet"
    try:
        frame = record_table(store.read_file(name, file), file.removesuffix(".parquet")).to_pandas()
    except ValueError as error:
        raise UserError(f"{store.run_folder(name) / file}: {error}") from None
    return _wide(frame) if logged else frame


def _wide(scalars: pd.DataFrame) -> pd.DataFrame:
    """Return a log's points with a column for each quantity or tag; returns are named as averaged."""
    named = named_scalars(scalars).drop_duplicates(["name", "step"], keep="last")
    named = named[~named["name"].str.startswith(WALL_CLOCK)]
    frame = named.pivot(index="step", columns="name", values="value")
    known = [name for name in TAGS if name in frame]
    frame = frame[[*known, *sorted(str(name) for name in frame if name not in known)]]
    frame.columns.name = None
    averaged = {name: f"{name}_mean_{TRAILING_EPISODES}" for name in EPISODE_QUANTITIES}
    return frame.rename(columns=averaged).reset_index()


# --- The cells --------------------------------------------------------------------------------------


def row_cells(run: Measured) -> dict[str, Any]:
    """Return the cells of a run's row, by column."""
    cells: dict[str, Any] = {
        **{key: getattr(run, key) for key in ("run_id", "config_id", "status", "end")},
        "seed": run.fields.get("seed") or 0,
        "steps": run.fields["steps"],
        "fields": json.dumps(run.fields),
        "provenance": json.dumps(run.provenance),
        "signs": pack_signs(_signs(run.series)),
        EVALUATIONS: list(run.evaluations),
    }
    if run.averaged_over:
        cells[AVERAGED_OVER] = run.averaged_over
    columns = {name: values for name, (_, values) in run.series.items() if name in UPDATE_QUANTITIES}
    if columns:
        step, _ = run.series[next(iter(columns))]
        cells |= dict(zip(STUCK, stuck_updates(step, columns), strict=True))
    for quantity in run.series:
        cells |= _of_quantity(run, quantity)
    if "return" in run.series and not run.averaged_over:
        cells[LAST_EPISODES] = _last_episodes(run, cells[curve_column("return", WINDOWS[0])])
    return cells


def _last_episodes(run: Measured, curve: Sequence[float]) -> float:
    """Return how many episodes the last point of a curve of returns averages."""
    known = np.flatnonzero(np.isfinite(curve))
    if not len(known):
        return 0.0
    steps, end = run.series["return"][0], make_grid(run.fields["steps"])[known[-1]]
    window = run.fields["steps"] * WINDOW_POINTS / GRID_POINTS
    return float(np.count_nonzero((steps > end - window) & (steps <= end)))


def _of_quantity(run: Measured, quantity: str) -> dict[str, Any]:
    """Return the cells of one quantity: its curves, rounded, and what of them is kept exact."""
    (step, values), grid = run.series[quantity], make_grid(run.fields["steps"])
    curves = dict(_curves(run, quantity, step, values, grid))
    exact = {name: next(iter(curves.values())) for name in EXACT.get(quantity, ())}
    if quantity in EXTREMES:
        curves[f"{quantity} {PEAKS}"] = exact["peak"] = peak_curve(step, values, grid, EXTREMES[quantity])
    cells: dict[str, Any] = {name: _rounded(curve, quantity).tolist() for name, curve in curves.items()}
    for name, curve in exact.items():
        known = np.isfinite(curve)
        if known.any():
            take = STATISTICS.get(name) or (lambda _, values, end: EXTREMES[quantity].reduce(values))
            cells[f"{quantity} {name}"] = float(take(grid[known], curve[known], float(run.fields["steps"])))
    return cells


def _curves(
    run: Measured, quantity: str, step: np.ndarray, values: np.ndarray, grid: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield a quantity's curves with their columns, the usual one first."""
    if quantity in UPDATE_QUANTITIES:
        yield quantity, update_curve(step, values, grid, run.end)
    elif run.averaged_over:
        single = values.astype(np.float32).astype(float)
        yield curve_column(quantity, "trailing-100"), held_curve(step, single, grid, run.end)
    else:
        for window in WINDOWS if quantity in ("return", "length") else WINDOWS[:1]:  # as SB3 logs
            trailing = window != WINDOWS[0]
            curve = episode_curve(
                step, values, grid, trailing=trailing, from_step=run.first_step, end=run.end
            )
            yield curve_column(quantity, window), curve


def _signs(series: Mapping[str, Series]) -> dict[str, list[Stretch]]:
    """Return where each recorded sign of collapse holds."""
    columns = {name: series[name] for name in ("entropy", "dead_units", *ACTION_QUANTITIES) if name in series}
    if "action_0" in columns and np.isnan(columns["action_0"][1]).all():
        columns.pop("entropy", None)  # of actions that are numbers it may be of any size
    if not columns:
        return {}
    step, _ = next(iter(columns.values()))
    return update_signs(step, {name: values for name, (_, values) in columns.items()})


def _rounded(values: np.ndarray, quantity: str) -> np.ndarray:
    """Round a curve to a five-hundredth of its range, to multiples of a power of two, which compress well.

    A curve over several orders of magnitude, without negative values, is rounded in proportion to each value
    instead.
    """
    known = values[np.isfinite(values)]
    if not len(known) or known.min() == known.max():
        return values
    above = known[known > 0]
    if known.min() >= 0 and (quantity in RELATIVE or known.max() > LEVELS * above.min()):
        fraction, exponent = np.frexp(values)
        return np.ldexp(np.round(fraction * LEVELS) / LEVELS, exponent)
    span = float(known.max()) - float(known.min())
    if not sys.float_info.min * LEVELS < span < math.inf:
        return values
    step = 2.0 ** math.ceil(math.log2(span / LEVELS))
    steps = np.round(values / step)
    if known.min() < 0:  # a return's sign tells a collapse, so it stays
        steps = np.where((steps == 0) & (values != 0), np.sign(values), steps)
    return steps * step
