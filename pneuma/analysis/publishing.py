"""Publishing: encode a study's finished runs as the table that `published` reads."""

from __future__ import annotations

import io
import json
import math
import sys
from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.analysis import ACTION_QUANTITIES, TRAINING_QUANTITIES, published
from pneuma.analysis.frames import FinishedRun, StudyData
from pneuma.analysis.outcomes import OUTCOMES, outcome
from pneuma.analysis.series import EXTREMES, GRID_POINTS
from pneuma.errors import UserError
from pneuma.files import to_json
from pneuma.study.provenance import other_processors

CURVES = ("return", "length", "entropy", "grad_norm", "dead_units", *ACTION_QUANTITIES)
"""The quantities whose curves a table keeps by default."""
KEPT_PROVENANCE = ("python", "packages", "commit", "system", "cpu", "threads", "imported", "damage")
"""The provenance that a table keeps: without times, so that a run trained again gives the same table."""
LEVELS = 512
"""Most steps into which a curve's range is divided; panels of figures are about as many pixels high."""


def encode_study(
    data: StudyData, curves: Collection[str] | None = None, before: published.PublishedTable | None = None
) -> bytes:
    """Return the published table of a study; the same runs give the same bytes.

    Curves are rounded to a five-hundredth of their range; outcomes, signs and evaluations are exact. An
    existing table keeps its columns, and its runs that are not here. Runs of the selection that are not
    finished anywhere keep their row, without numbers.

    Args:
        data: the study, with no runs from other tables.
        curves: the quantities whose curves are kept; default: those of the existing table, else `CURVES`.
        before: the study's existing table.

    Raises:
        UserError: when runs or curves that are published would be lost.
    """
    if before is None:
        types = {
            name: published.column_types(name)[0]
            for name in _new_columns(data, CURVES if curves is None else curves)
        }
    else:
        _refuse_losses(data, before, curves)
        types = {
            column.name: kind
            for column in before.rows.schema
            for kind in published.column_types(column.name)
            if kind == column.type
        }
    lists = [name for name, kind in types.items() if kind in (published.SINGLE, published.WIDE)]
    if published.EVALUATIONS in data.tables:
        tables = [run.records.table(published.EVALUATIONS) for run in data.runs]
        schemas = [pa.Schema.from_pandas(table, preserve_index=False).remove_metadata() for table in tables]
        rows = list(pa.unify_schemas(schemas, promote_options="permissive"))
        types[published.EVALUATIONS] = pa.list_(pa.struct(rows))
    finished = {(run.condition, run.run_id): run for run in data.runs}
    cells = []
    for entry in data.record["runs"]:
        run = finished.get((entry["condition"], entry["run_id"]))
        naming = {name: entry[name] for name in ("condition", "seed", "run_id")}
        naming |= {"status": data.index[entry["run_id"]].status.name, "settings": json.dumps(entry["run"])}
        cells.append((dict(_cells(data, run, types)) if run else {}) | naming)
    records = next(run.records for run in data.runs if not run.records.published)
    head = {
        "schema": 2,
        **{key: data.record.get(key) for key in published.OF_RECORD},
        "study": data.study,
        "figure": data.figure,
        "budget": data.budget,
        "tables": [published.EVALUATIONS] if published.EVALUATIONS in data.tables else [],
        "windows": list(records.windows),
        "averaged_over": data.averaged_over,
    }
    table = pa.table(
        {name: pa.array([row.get(name) for row in cells], kind) for name, kind in types.items()},
        metadata={"pneuma": json.dumps(head), "pneuma.checksum": published.NO_SUM},
    )
    sink = io.BytesIO()
    pq.write_table(  # a dictionary does not help if numbers hardly repeat
        table,
        sink,
        compression="zstd",
        compression_level=19,
        use_dictionary=[name for name in table.column_names if name not in lists],
        use_byte_stream_split=[f"{name}.list.element" for name in lists if types[name] == published.SINGLE],
    )
    return published.with_sum(sink.getvalue())


def _refuse_losses(data: StudyData, before: published.PublishedTable, curves: Collection[str] | None) -> None:
    recorded = {name for run in data.runs if not run.records.published for name in run.records.quantities}
    why = ""
    if before.finished - {run.run_id for run in data.runs}:
        why = (
            "has runs that are not of this selection: select them too (--preset, --condition, --seeds), "
            "or name another by --as"
        )
    elif curves is not None and recorded & {*curves} != {*before.quantities}:
        why = f"keeps curves of {', '.join(before.quantities) or 'nothing'}: leave --curves out"
    elif data.published and data.budget != before.head["budget"]:
        why = (
            f"ends at step {before.head['budget']:,}, and these runs at {data.budget:,}: name another by --as"
        )
    if why:
        raise UserError(f"study {data.study}: its table {why}; or remove it and publish anew what is here")


def _new_columns(data: StudyData, curves: Collection[str]) -> Iterator[str]:
    """Yield the names of the columns in which some finished run has a value."""
    quantities = dict.fromkeys(name for run in data.runs for name in run.records.quantities)
    yield from published.NAMING
    for quantity in quantities:
        if quantity in curves:
            windows = data.windows if quantity == "return" else data.windows[:1]  # as the thesis's figures
            yield from dict.fromkeys(published.curve_column(quantity, window) for window in windows)
            if quantity in EXTREMES:
                yield f"{quantity} {published.PEAKS}"
    yield from (
        f"{published.OUTCOME} {name}"
        for name, outcome_kind in OUTCOMES.items()
        if outcome_kind.source in quantities
    )
    yield published.SIGNS


def _cells(data: StudyData, run: FinishedRun, columns: Collection[str]) -> Iterator[tuple[str, Any]]:
    """Yield a finished run's cell in each column, apart from those of its record."""
    records = run.records
    for name in columns:
        first, _, second = name.partition(" ")
        if isinstance(records, published.PublishedRecords):
            yield name, records.cell(name)
        elif name == "end":
            yield name, run.end
        elif name == "provenance":
            found = records.provenance()
            about = {key: found[key] for key in KEPT_PROVENANCE if key in found} | other_processors(found)
            yield name, json.dumps(about)
        elif name == published.SIGNS:
            yield name, published.pack_signs(records.signs())
        elif name == published.EVALUATIONS:
            yield name, records.table(published.EVALUATIONS).to_dict("records")
        elif first == published.OUTCOME:
            yield name, outcome(data, run, second)
        elif first in records.quantities:
            curve = (
                records.peaks(first, data.grid)
                if second == published.PEAKS
                else _curve(data, run, first, second)
            )
            yield name, rounded(curve).tolist()
        elif first in TRAINING_QUANTITIES:
            yield name, [math.nan] * GRID_POINTS


def _curve(data: StudyData, run: FinishedRun, quantity: str, window: str) -> np.ndarray:
    return run.records.curve(quantity, window or run.records.windows[0], data.grid, run.slots)


def encode_times(data: StudyData) -> bytes:
    """Encode the file of times: how long each finished run trained, if known, and its share of a core."""
    runs = {}
    for records in (run.records for run in data.runs):
        if (seconds := records.wall_seconds) is not None:
            times = {"wall_seconds": round(seconds, 3), "processor_share": records.processor_share}
            runs[records.run_id] = {key: value for key, value in times.items() if value is not None}
    return to_json({"schema": 1, "study": data.study, "runs": runs})


def rounded(values: np.ndarray) -> np.ndarray:
    """Round a curve to a five-hundredth of its range, to multiples of a power of two, which compress well.

    A curve over several orders of magnitude, without negative values, is rounded in proportion to each value
    instead.
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
    steps = np.round(values / step)
    if known.min() < 0:  # a return's sign tells a collapse, so it stays
        steps = np.where((steps == 0) & (values != 0), np.sign(values), steps)
    return steps * step
