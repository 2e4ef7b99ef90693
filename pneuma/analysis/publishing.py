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

from pneuma.analysis import PEAKED_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.frames import FinishedRun, StudyData
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.published import (
    EVALUATIONS,
    NAMING,
    NO_SUM,
    OUTCOME,
    PEAKS,
    SCHEMA,
    SIGNS,
    PublishedRecords,
    PublishedTable,
    with_sum,
)
from pneuma.analysis.signs import Stretch
from pneuma.errors import UserError
from pneuma.study.provenance import other_processors
from pneuma.study.store import to_json

KEPT_PROVENANCE = ("python", "packages", "commit", "system", "cpu", "threads", "imported", "damage")
"""What produced a run, without the times at which it did: a run that is trained again publishes the same."""
MACHINE = ("system", "cpu", "threads")
LEVELS = 1024
"""Steps that a rounded curve's range is divided into, at most; a figure has fewer points across."""

_NAMING = dict(zip(NAMING, (pa.string(), pa.int64(), pa.string(), pa.string()), strict=True))

Columns = Mapping[str, pa.DataType]


def encode_study(
    data: StudyData,
    curves: Collection[str] | None = None,
    rounding: bool = False,
    before: PublishedTable | None = None,
) -> bytes:
    """Return the published table of a study; the same runs give the same bytes.

    Runs that are had from the study's own table stay as they are there. Runs of the selection that are
    finished nowhere keep their place, without numbers.

    Args:
        data: the study.
        curves: of which quantities curves are kept; left out: all. Outcomes are kept of all.
        rounding: whether curves are kept to a thousandth of their range.
        before: the study's table as it is.

    Raises:
        UserError: when a run is to stay whose columns are not those of the others.
    """
    here = [run for run in data.runs if not run.records.published]
    kinds = _columns(data, here, curves, rounding)
    if before is not None and len(here) < len(data.runs):
        kinds = _shared_columns(data, kinds, before, rounding)
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
    head = {"pneuma": json.dumps(_head(data, here, rounding)), "pneuma.checksum": NO_SUM}
    return with_sum(_compressed(pa.table(columns, metadata=head)))


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


def _columns(
    data: StudyData, runs: Sequence[FinishedRun], curves: Collection[str] | None, rounding: bool
) -> dict[str, pa.DataType]:
    """Return the type of every column that finished runs have a value in, in the order of columns."""
    quantities = dict.fromkeys(name for run in runs for name in run.records.quantities)
    windows = runs[0].records.windows
    kinds = {"end": pa.int64(), "settings": pa.string(), "provenance": pa.string()}
    for quantity in quantities:
        kinds[f"final_{quantity}"] = pa.float64()
        if curves is not None and quantity not in curves:
            continue
        if quantity in UPDATE_QUANTITIES:
            kinds[quantity] = pa.list_(pa.float32())
        elif rounding:  # of small tables' episodes, only returns have the window of the thesis's figures
            kept = windows if quantity == "return" else windows[:1]
            kinds |= {f"{quantity} {window}": pa.list_(pa.float32()) for window in kept}
        else:  # wide enough to hold every curve exactly
            single = {window: window == "trailing-100" for window in windows}
            wide = {window: pa.float32() if own else pa.float64() for window, own in single.items()}
            kinds |= {f"{quantity} {window}": pa.list_(kind) for window, kind in wide.items()}
        if quantity in PEAKED_QUANTITIES:
            kinds[f"{quantity} {PEAKS}"] = pa.list_(pa.float32())
    kinds |= {OUTCOME + name: pa.float64() for name, own in OUTCOMES.items() if own.source in quantities}
    kinds[SIGNS] = pa.string()
    return kinds | ({EVALUATIONS: _row_type(runs)} if EVALUATIONS in data.tables else {})


def _row_type(runs: Sequence[FinishedRun]) -> pa.DataType:
    """Return the type of a run's evaluations: a list of rows, whole numbers where all runs have such."""
    kinds: dict[str, list[str]] = {}
    for run in runs:
        for name, kind in run.records.table(EVALUATIONS).dtypes.items():
            kinds.setdefault(str(name), []).append(kind.kind)
    whole = {name: set(own) == {"i"} and len(own) == len(runs) for name, own in kinds.items()}
    return pa.list_(pa.struct([(name, pa.int64() if whole[name] else pa.float64()) for name in kinds]))


def _shared_columns(
    data: StudyData, kinds: Columns, before: PublishedTable, rounding: bool
) -> dict[str, pa.DataType]:
    """Return the types of columns that hold both new runs and those that were published before.

    Raises:
        UserError: naming the columns that only one of them has.
    """
    old = dict(before.columns)
    differing = sorted(name for name in {*kinds, *old} - {EVALUATIONS} if kinds.get(name) != old.get(name))
    if before.head.get("rounded", rounding) != rounding:
        differing.insert(0, "rounding")
    if (EVALUATIONS in kinds) != (EVALUATIONS in old):
        differing.append(EVALUATIONS)
    if differing:
        told = ", ".join(differing[:3]) + (f" and {len(differing) - 3} more" if len(differing) > 3 else "")
        raise UserError(
            f"study {data.study}: its table and these runs differ in {told}, and not all runs of the table "
            "are here: publish with the same --curves and --round as before"
        )
    if EVALUATIONS not in kinds:
        return dict(kinds)
    ours, theirs = ({own.name: own.type for own in types[EVALUATIONS].value_type} for types in (kinds, old))
    shared = {name: ours.get(name) == theirs.get(name) for name in {**ours, **theirs}}
    fields = [(name, ours[name] if same else pa.float64()) for name, same in shared.items()]
    return {**kinds, EVALUATIONS: pa.list_(pa.struct(fields))}


def _cells(data: StudyData, run: FinishedRun, kinds: Columns, rounding: bool) -> dict[str, Any]:
    """Return what a finished run has in every column but its settings."""
    if isinstance(run.records, PublishedRecords):
        return {name: run.records.cell(name) for name in kinds if name != "settings"}
    own = run.records
    cells: dict[str, Any] = {"end": run.end, "provenance": _provenance(own.provenance())}
    for name, kind in kinds.items():
        quantity, _, window = name.partition(" ")
        if name.startswith("final_"):
            quantity = name.removeprefix("final_")
            cells[name] = own.final(quantity) if quantity in own.quantities else float("nan")
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


def _provenance(found: Mapping[str, Any]) -> str:
    kept = {key: found[key] for key in KEPT_PROVENANCE if key in found} | other_processors(found)
    return json.dumps(kept)


def _head(data: StudyData, runs: Sequence[FinishedRun], rounding: bool) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "study": data.study,
        "title": data.title,
        "figure": data.figure,
        "baseline": data.record.get("baseline"),
        "same": data.same,
        "budget": data.budget,
        "tables": [name for name in data.tables if name == EVALUATIONS],
        "windows": list(runs[0].records.windows),
        "averaged_over": data.averaged_over,
        "rounded": rounding,
    }


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
        use_byte_stream_split=[
            f"{field.name}.list.element" for field in curves if field.type.value_type == pa.float32()
        ],
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
