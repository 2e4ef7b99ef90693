"""Publishing: from a study's finished runs to the bytes of the table that `published` reads."""

from __future__ import annotations

import io
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.analysis import PEAKED_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.checksums import NO_SUM, with_sum
from pneuma.analysis.outcomes import outcome, outcomes_of_curves
from pneuma.analysis.packed import pack_signs, rounded
from pneuma.analysis.published import (
    EVALUATIONS,
    NAMING,
    OUTCOME,
    PEAKS,
    SCHEMA,
    SIGNS,
    PublishedRuns,
)
from pneuma.analysis.tables import FinishedRun, StudyData
from pneuma.errors import UserError
from pneuma.study.origins import other_processors

KEPT_PROVENANCE = ("python", "packages", "commit", "system", "cpu", "threads", "imported", "damage")
"""What produced a run, without the times at which it did: a run that is trained again publishes the same."""

_NAMING = dict(zip(NAMING, (pa.string(), pa.int64(), pa.string(), pa.string()), strict=True))
_GRID = ("budget", "windows", "averaged_over")


def encode_study(
    data: StudyData,
    curves: Collection[str] | None = None,
    rounding: bool = False,
    published: PublishedRuns | None = None,
) -> bytes:
    """Return the published table of a study; the same runs give the same bytes.

    Runs of the selection that are finished nowhere keep their place, without numbers.

    Args:
        data: the study.
        curves: of which quantities curves are kept; left out: all. Outcomes are kept of all.
        rounding: whether curves are kept to a thousandth of their range.
        published: what was published of it before (`with_other_studies`); those of the selection's runs
            that are finished there alone stay as they are.

    Raises:
        UserError: when a run is to stay whose columns or points are not those of the others.
    """
    finished = {(run.condition, run.run_id): run for run in data.runs}
    staying = {*runs_staying(data, published)}
    kept = tuple(name for name in data.quantities if curves is None or name in curves)
    kinds = _cell_types(data, kept, rounding)
    if published is not None and staying:
        data = _on_its_grid(data, staying, published)
        kinds = _shared_types(data, kinds, published, rounding)
    rows = []
    for told in data.record["runs"]:
        run_id, run = told["run_id"], finished.get((told["condition"], told["run_id"]))
        row = {name: told[name] for name in ("condition", "seed", "run_id")}
        if run:
            row |= {"status": run.status, "settings": json.dumps(told["run"])}
            row |= _cells(data, run, kept, rounding)
        elif published is not None and run_id in staying:
            row |= {"status": published.status(run_id).name, **published.row(run_id)}
            row |= {"settings": json.dumps(told["run"])}
        else:
            row |= {"status": _unfinished(data, run_id, published), "settings": json.dumps(told["run"])}
        rows.append(row)
    columns = {
        name: pa.array([row.get(name) for row in rows], kind) for name, kind in {**_NAMING, **kinds}.items()
    }
    head = {"pneuma": json.dumps(_head(data, rounding)), "pneuma.checksum": NO_SUM}
    return with_sum(_compressed(pa.table(columns, metadata=head)))


def with_other_studies(
    data: StudyData,
    own: PublishedRuns | None,
    others: Iterable[PublishedRuns],
    curves: Collection[str] | None = None,
    rounding: bool = False,
) -> PublishedRuns | None:
    """Return what was published of a selection's runs before, by its study or by others.

    A run has one id in all studies that ask for it, so the runs that one study published need not be
    trained again for the next. Tables with other columns, or other points, are passed over.

    Args:
        data: the study.
        own: what was published of it before, if anything; what it holds is taken from it.
        others: the tables of other studies.
        curves: as for `encode_study`.
        rounding: likewise.
    """
    published, own = own, own if runs_staying(data, own) else None  # one of which nothing stays binds no one
    kept = tuple(name for name in data.quantities if curves is None or name in curves)
    kinds = own.column_types if own else _cell_types(data, kept, rounding)
    head = own.head if own else _head(data, rounding)
    serving = [
        other
        for other in others
        if other.rounds_as(rounding)
        and {**other.column_types, **kinds} == other.column_types
        and all(head[key] == other.head[key] for key in _GRID if key != "budget")
    ]
    budget, found = _found_on_one_grid(data, own, serving)
    if not found:
        return published
    tables = [own.rows([run_id for run_id in own.run_ids if run_id not in found], kinds)] if own else []
    tables += [other.rows([run_id], kinds) for run_id, other in found.items()]
    times = {run_id: other.times[run_id] for run_id, other in found.items() if run_id in other.times}
    both = pa.concat_tables(tables)
    return PublishedRuns({**head, "budget": budget}, both, {**times, **(own.times if own else {})})


def _found_on_one_grid(
    data: StudyData, own: PublishedRuns | None, others: Sequence[PublishedRuns]
) -> tuple[int, dict[str, PublishedRuns]]:
    """Return up to which step the curves of a selection's runs have points, and which table holds which run.

    That is the own table's, or of all runs that are had the most; tables with other points are had no more.
    """
    steps = {run["run_id"]: run["run"]["steps"] for run in data.record["runs"]}
    had = {run.run_id for run in data.runs} | {*(own.finished if own else ())}
    missing = [run_id for run_id in steps if run_id not in had]
    if own:
        return own.head["budget"], _holders(missing, others, own.head["budget"])
    for budget in sorted({table.head["budget"] for table in others}, reverse=True):
        found = _holders(missing, others, budget)
        if max(steps[run_id] for run_id in {*had, *found}) == budget:
            return budget, found
    return data.budget, {}


def _holders(
    run_ids: Sequence[str], tables: Sequence[PublishedRuns], budget: int
) -> dict[str, PublishedRuns]:
    """Return the first table, of those with points up to a budget, that holds each run; of some none does."""
    fitting = [table for table in tables if table.head["budget"] == budget]
    return {run_id: table for table in reversed(fitting) for run_id in run_ids if run_id in table.finished}


def runs_staying(data: StudyData, published: PublishedRuns | None) -> list[str]:
    """Return the ids of a selection's runs that are finished in its published table alone, in its order."""
    if published is None:
        return []
    here = {run.run_id for run in data.runs}
    selected = [run["run_id"] for run in data.record["runs"]]
    return [run_id for run_id in selected if run_id not in here and published.status(run_id).finished]


def runs_leaving(data: StudyData, published: PublishedRuns) -> list[str]:
    """Return the ids of finished runs of the published table that the selection leaves out."""
    selected = {run["run_id"] for run in data.record["runs"]}
    known = [run["run_id"] for run in published.record["runs"]]
    return [run_id for run_id in known if run_id not in selected and published.status(run_id).finished]


def _unfinished(data: StudyData, run_id: str, published: PublishedRuns | None) -> str:
    """Return the status of a run without numbers; one that has finished since the study was opened runs."""
    here = data.source.status(run_id)
    if here.finished:
        return "running"
    return published.status(run_id).name if published and here.name == "planned" else here.name


def _on_its_grid(data: StudyData, staying: Collection[str], published: PublishedRuns) -> StudyData:
    """Return the study on the grid of its published table, whose longest run may not be here.

    Raises:
        UserError: when it is another grid: one of the runs here is longer than all that were published, or
            the longest that was published leaves.
    """
    kept = {*staying, *(run.run_id for run in data.runs)}
    budget = max(run["run"]["steps"] for run in data.record["runs"] if run["run_id"] in kept)
    head = published.head
    ours, theirs = (budget, list(data.windows), data.averaged_over), tuple(head[key] for key in _GRID)
    if ours != theirs:
        raise UserError(
            f"study {data.study}: the curves of its table have points up to step {head['budget']:,}, these "
            f"need {budget:,}, and not all runs of the table are here: publish those of most steps first"
        )
    return StudyData(data.source, {**data.record, "budget": budget})


def _shared_types(
    data: StudyData, kinds: Mapping[str, pa.DataType], published: PublishedRuns, rounding: bool
) -> dict[str, pa.DataType]:
    """Return the types of columns that hold both new runs and those that were published before.

    Raises:
        UserError: when the columns differ.
    """
    before = published.column_types
    differing = {name for name in {**kinds, **before} if kinds.get(name) != before.get(name)} - {EVALUATIONS}
    if not published.rounds_as(rounding):
        differing.add("rounding")
    if differing or (EVALUATIONS in kinds) != (EVALUATIONS in before):
        names = sorted(differing) or [EVALUATIONS]
        told = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        raise UserError(
            f"study {data.study}: its table and these runs differ in {told}, and not all runs of the table "
            "are here: publish with the same --curves and --round as before"
        )
    if EVALUATIONS not in kinds:
        return dict(kinds)
    ours, theirs = (
        {field.name: field.type for field in types[EVALUATIONS].value_type} for types in (kinds, before)
    )
    shared = {name: ours.get(name) == theirs.get(name) for name in {**ours, **theirs}}
    fields = [(name, ours[name] if same else pa.float64()) for name, same in shared.items()]
    return {**kinds, EVALUATIONS: pa.list_(pa.struct(fields))}


def _cell_types(data: StudyData, curves: Collection[str], rounding: bool) -> dict[str, pa.DataType]:
    """Return the type of every column that finished runs have a value in, in the order of columns."""
    kinds = {"end": pa.int64(), "settings": pa.string(), "provenance": pa.string()}
    for quantity in data.quantities:
        kinds[f"final_{quantity}"] = pa.float64()
        if quantity in curves:
            columns = _curve_columns(quantity, data.windows, rounding)
            kinds |= {name: pa.list_(kind) for name, _, kind in columns}
            kinds |= {f"{quantity} {PEAKS}": pa.list_(pa.float32())} if quantity in PEAKED_QUANTITIES else {}
    kinds |= {OUTCOME + name: pa.float64() for name in outcomes_of_curves(data)}
    kinds[SIGNS] = pa.string()
    return kinds | ({EVALUATIONS: _row_type(data)} if EVALUATIONS in data.tables else {})


def _cells(data: StudyData, run: FinishedRun, curves: Collection[str], rounding: bool) -> dict[str, Any]:
    """Return what a finished run has in every column: run by run, each table is read once for all of them."""
    cells: dict[str, Any] = {"end": run.end, "provenance": _provenance(data, run)}
    for quantity in data.quantities:
        cells[f"final_{quantity}"] = data.final(run, quantity)
        if quantity not in curves:
            continue
        for name, window, kind in _curve_columns(quantity, data.windows, rounding):
            values = data.curve(run, quantity, window)
            cells[name] = (rounded(values) if rounding else values).astype(kind.to_pandas_dtype())
        if quantity in PEAKED_QUANTITIES:
            values = data.peaks(run, quantity)
            cells[f"{quantity} {PEAKS}"] = (rounded(values) if rounding else values).astype(np.float32)
    cells |= {OUTCOME + name: outcome(data, run, name) for name in outcomes_of_curves(data)}
    cells[SIGNS] = pack_signs(data.source.signs(run))
    if EVALUATIONS in data.tables:
        cells[EVALUATIONS] = data.source.table(run, EVALUATIONS).to_dict("records")
    return cells


def _curve_columns(
    quantity: str, windows: tuple[str, ...], rounding: bool
) -> list[tuple[str, str, pa.DataType]]:
    """Return name, window and type of every column of a quantity's curves; updates have one window.

    Types are wide enough to hold every curve of `pneuma.analysis.windows` exactly, where none is rounded.
    Of small tables' episodes, only returns have the window of the thesis's figures.
    """
    if quantity in UPDATE_QUANTITIES:
        return [(quantity, windows[0], pa.float32())]
    if rounding:
        kept = windows if quantity == "return" else windows[:1]
        return [(f"{quantity} {window}", window, pa.float32()) for window in kept]
    wide = {window: pa.float32() if window == "trailing-100" else pa.float64() for window in windows}
    return [(f"{quantity} {window}", window, kind) for window, kind in wide.items()]


def _compressed(table: pa.Table) -> bytes:
    """Return a table as a Parquet file, small: numbers that hardly repeat are no dictionary's."""
    curves = [field for field in table.schema if pa.types.is_list(field.type) and field.name != EVALUATIONS]
    single = [f"{field.name}.list.element" for field in curves if field.type.value_type == pa.float32()]
    names = {field.name for field in curves}
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=19,
        use_dictionary=[name for name in table.column_names if name not in names],
        use_byte_stream_split=single,
    )
    return sink.getvalue()


def _head(data: StudyData, rounding: bool) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "study": data.study,
        "title": data.title,
        "figure": data.figure,
        "baseline": data.record.get("baseline"),
        "same": data.same,
        "budget": data.budget,
        "tables": [name for name in data.tables if name == EVALUATIONS],
        "windows": list(data.windows),
        "averaged_over": data.averaged_over,
        "rounded": rounding,
        **({"adaptive": {"looks": [{"seeds": seeds} for seeds in data.looks]}} if data.looks else {}),
    }


def _provenance(data: StudyData, run: FinishedRun) -> str:
    found = data.source.provenance(run)
    kept = {key: found[key] for key in KEPT_PROVENANCE if key in found} | other_processors(found)
    changed = {words for resume in found.get("resumes", ()) for words in resume["differences"]}
    return json.dumps({**kept, "resumed_elsewhere": sorted(changed)} if changed else kept)


def _row_type(data: StudyData) -> pa.DataType:
    """Return the type of a run's evaluations: a list of rows, whole numbers where all runs have such."""
    kinds: dict[str, list[str]] = {}
    for run in data.runs:
        for name, kind in data.source.table(run, EVALUATIONS).dtypes.items():
            kinds.setdefault(str(name), []).append(kind.kind)
    whole = {name: set(own) == {"i"} and len(own) == len(data.runs) for name, own in kinds.items()}
    return pa.list_(pa.struct([(name, pa.int64() if whole[name] else pa.float64()) for name in kinds]))
