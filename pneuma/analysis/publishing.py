"""Publishing: from a study's finished runs to the bytes of the table that `published` reads."""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.analysis import ACTION_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.frames import FinishedRun, StudyData
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.published import (
    EVALUATIONS,
    NO_SUM,
    OUTCOME,
    PEAKS,
    SCHEMA,
    SIGNS,
    SINGLE,
    WIDE,
    PublishedRecords,
    PublishedTable,
    with_sum,
)
from pneuma.analysis.records import Records
from pneuma.analysis.series import EXTREMES, TRAILING_EPISODES, Stretch
from pneuma.errors import UserError
from pneuma.study.provenance import other_processors
from pneuma.study.store import to_json

CURVES = (
    "return", "length", "entropy", "grad_norm", "grad_norm_actor", "grad_norm_critic", "dead_units",
    *ACTION_QUANTITIES,
)  # fmt: skip
"""What a table keeps curves of, unless others are named."""

KEPT_PROVENANCE = ("python", "packages", "commit", "system", "cpu", "threads", "imported", "damage")
"""What produced a run, without the times at which it did: a run that is trained again publishes the same."""
MACHINE = ("system", "cpu", "threads")
LEVELS = 1024
"""Steps that a curve's range is divided into, at most; a figure has fewer points across."""

Columns = dict[str, pa.DataType]


def encode_study(
    data: StudyData, curves: Collection[str] | None = None, before: PublishedTable | None = None
) -> bytes:
    """Return the published table of a study; the same runs give the same bytes.

    Curves are kept to a thousandth of their range, outcomes, signs and evaluations as they are. A table that
    there is keeps its columns, and the runs of it that are not here. Runs of the selection that are finished
    nowhere keep their place, without numbers.

    Args:
        data: the study, with no runs from other tables.
        curves: of which quantities curves are kept; left out: those of the table, else `CURVES`.
        before: the study's table as it is.

    Raises:
        UserError: when runs or curves that are published would be lost.
    """
    here = [run for run in data.runs if not run.records.published]
    if before is None:
        kinds, rounding = _columns(here, CURVES if curves is None else curves), True
    else:
        _refuse_losses(data, here, before, curves)
        types = {own.name: own.type for own in before.rows.schema if own.name not in _NAMING}
        kinds = {
            name: WIDE if own == WIDE else SINGLE if own == SINGLE else own for name, own in types.items()
        }
        rounding = bool(before.head.get("rounded"))
    if EVALUATIONS in data.tables:
        kinds[EVALUATIONS] = _evaluations_type(data.runs)
    finished = {(run.condition, run.run_id): run for run in data.runs}
    rows = []
    for told in data.record["runs"]:
        row = {name: told[name] for name in ("condition", "seed", "run_id")}
        row |= {"status": data.index[told["run_id"]].status.name, "settings": json.dumps(told["run"])}
        if run := finished.get((told["condition"], told["run_id"])):
            row |= _cells(data, run, kinds, rounding)
        rows.append(row)
    columns = {
        name: pa.array([row.get(name) for row in rows], kind) for name, kind in {**_NAMING, **kinds}.items()
    }
    head = {
        "schema": SCHEMA,
        "study": data.study,
        "title": data.title,
        "figure": data.figure,
        "baseline": data.record.get("baseline"),
        "same": data.same,
        "budget": data.budget,
        "tables": [name for name in data.tables if name == EVALUATIONS],
        "windows": list(here[0].records.windows),
        "averaged_over": data.averaged_over,
        "rounded": rounding,
    }
    metadata = {"pneuma": json.dumps(head), "pneuma.checksum": NO_SUM}
    return with_sum(_compressed(pa.table(columns, metadata=metadata)))


def encode_times(data: StudyData) -> bytes:
    """Return seconds and machine of every finished run that tells them, for the file of times."""
    runs = {}
    for run in data.runs:
        if (seconds := run.records.wall_seconds) is None:
            continue
        if run.records.published:
            runs[run.run_id] = dict(run.records.times)
            continue
        about, share = run.records.provenance(), run.records.processor_share
        machine = {key: about[key] for key in MACHINE if key in about} | other_processors(about)
        shared = {} if share is None else {"processor_share": share}
        runs[run.run_id] = {"wall_seconds": round(seconds, 3), **shared, **machine}
    return to_json({"schema": 1, "study": data.study, "runs": runs})


def _refuse_losses(
    data: StudyData, here: Sequence[FinishedRun], before: PublishedTable, curves: Collection[str] | None
) -> None:
    held = {name for run in here for name in run.records.quantities}
    why = ""
    if before.finished - {run.run_id for run in data.runs}:
        why = "has runs that are not of this selection: select them too (--preset, --condition, --seeds)"
    elif curves is not None and held & {*curves} != {*before.quantities}:
        why = f"keeps curves of {', '.join(before.quantities) or 'nothing'}: leave --curves out"
    elif len(here) < len(data.runs) and data.budget != before.budget:
        why = f"ends at step {before.budget:,}, and these runs at {data.budget:,}: name another by --as"
    if why:
        raise UserError(f"study {data.study}: its table {why}; or remove it and publish anew what is here")


# --- Columns and cells ------------------------------------------------------------------------------

_NAMING = {"condition": pa.string(), "seed": pa.int64(), "run_id": pa.string(), "status": pa.string()}


def _columns(runs: Sequence[FinishedRun], curves: Collection[str]) -> Columns:
    """Return the type of every column that finished runs have a value in, in the order of columns."""
    quantities = dict.fromkeys(name for run in runs for name in run.records.quantities)
    windows = runs[0].records.windows
    kinds = {"end": pa.int64(), "settings": pa.string(), "provenance": pa.string()}
    for quantity in quantities:
        kinds[f"final_{quantity}"] = pa.float64()
        if quantity not in curves:
            continue
        kept = windows if quantity == "return" else windows[:1]  # the thesis's figures are of returns
        names = [quantity] if quantity in UPDATE_QUANTITIES else [f"{quantity} {own}" for own in kept]
        peaks = [f"{quantity} {PEAKS}"] if quantity in EXTREMES else []
        kinds |= dict.fromkeys([*names, *peaks], SINGLE)
    kinds |= {OUTCOME + name: pa.float64() for name, own in OUTCOMES.items() if own.source in quantities}
    return {**kinds, SIGNS: pa.string()}


def _evaluations_type(runs: Sequence[FinishedRun]) -> pa.DataType:
    """Return the type of a run's evaluations: a list of rows with the columns of all runs."""
    tables = [run.records.table(EVALUATIONS) for run in runs]
    schemas = [pa.Schema.from_pandas(table, preserve_index=False).remove_metadata() for table in tables]
    return pa.list_(pa.struct(list(pa.unify_schemas(schemas, promote_options="permissive"))))


def _cells(data: StudyData, run: FinishedRun, kinds: Columns, rounding: bool) -> dict[str, Any]:
    """Return what a finished run has in every column but its settings."""
    own = run.records
    if isinstance(own, PublishedRecords):
        return {name: own.cell(name) for name in kinds if name != "settings"}
    found = own.provenance()
    about = {key: found[key] for key in KEPT_PROVENANCE if key in found} | other_processors(found)
    cells: dict[str, Any] = {"end": run.end, "provenance": json.dumps(about)}
    for name, kind in kinds.items():
        quantity, _, window = name.partition(" ")
        if name.startswith("final_"):
            cells[name] = _final(own, name.removeprefix("final_"))
        elif name.startswith(OUTCOME):
            cells[name] = outcome(data, run, name.removeprefix(OUTCOME))
        elif pa.types.is_list(kind) and name != EVALUATIONS:
            values = np.full(data.grid.shape, np.nan)
            if quantity in own.quantities and window == PEAKS:
                values = own.peaks(quantity, data.grid)
            elif quantity in own.quantities:
                values = own.curve(quantity, window or own.windows[0], data.grid, run.slots)
            cells[name] = (rounded(values) if rounding else values).astype(kind.value_type.to_pandas_dtype())
    cells[SIGNS] = pack_signs(own.signs())
    if EVALUATIONS in kinds:
        cells[EVALUATIONS] = own.table(EVALUATIONS).to_dict("records")
    return cells


def _final(own: Records, quantity: str) -> float:
    """Return the mean of the last 100 episodes; the last value of what updates have, or of a log."""
    if quantity not in own.quantities:
        return float("nan")
    _, values = own.series(quantity)
    if own.averaged_over:
        values = values[np.isfinite(values)]
    single = own.averaged_over or quantity in UPDATE_QUANTITIES
    last = values[-1 if single else -TRAILING_EPISODES :]
    return float(last.mean()) if len(last) else float("nan")


def _compressed(table: pa.Table) -> bytes:
    """Return a table as a Parquet file, small: numbers that hardly repeat are no dictionary's."""
    curves = [field for field in table.schema if pa.types.is_list(field.type) and field.name != EVALUATIONS]
    names = {field.name for field in curves}
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=19,
        use_dictionary=[name for name in table.column_names if name not in names],
        use_byte_stream_split=[f"{own.name}.list.element" for own in curves if own.type == SINGLE],
    )
    return sink.getvalue()


# --- In few bytes ----------------------------------------------------------------------------------


def rounded(values: np.ndarray) -> np.ndarray:
    """Return a curve to a thousandth of its range: whole multiples of a power of two, which compress well.

    One over several orders of size, none of it below zero, is rounded in proportion to each value instead.
    """
    known = values[np.isfinite(values)]
    if not len(known) or known.min() == known.max():
        return values
    above = known[known > 0]
    if known.min() >= 0 and known.max() > LEVELS * above.min():
        fraction, exponent = np.frexp(values)
        return np.ldexp(np.round(fraction * LEVELS) / LEVELS, exponent)
    span = float(known.max()) - float(known.min())
    if not sys.float_info.min * LEVELS < span < math.inf:
        return values
    step = 2.0 ** math.ceil(math.log2(span / LEVELS))
    return np.round(values / step) * step


def pack_signs(signs: Mapping[str, list[Stretch]]) -> str:
    """Return where signs hold as JSON: a unit of steps, and each sign's gaps and lengths in it, in turn."""
    ends = [int(end) for parts in signs.values() for stretch in parts for end in stretch]
    unit = math.gcd(*ends) or 1
    packed = {}
    for sign, parts in signs.items():
        places = [0, *(int(end) // unit for stretch in parts for end in stretch)]
        packed[sign] = np.diff(places).tolist()
    return json.dumps({"unit": unit, "signs": packed}, separators=(",", ":"))
