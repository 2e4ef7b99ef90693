"""Export a study's records as one table in a file for other programs, and publish its rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from pneuma.analysis import EDGED_BANDS, EXPORT_TABLES
from pneuma.analysis.curves import curve_names, curves_table, study_curves
from pneuma.analysis.intervals import decimals, shown
from pneuma.analysis.study_data import NAMING, StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.quantities import EPISODE_QUANTITIES
from pneuma.store.row_builder import record_frame
from pneuma.store.store import Store


def encode_table(
    data: StudyData,
    table: str,
    form: str,
    store: Store,
    window: str | None = None,
    band: str = EDGED_BANDS[0],
) -> tuple[bytes, int]:
    """Encode one of `EXPORT_TABLES` as a file of one of `EXPORT_SUFFIXES`; also return its number of rows.

    The same runs give the same bytes, as tables contain no times. `form` is csv, parquet, latex or markdown.
    `window` and `band` (whose edges are low and high) are for curves.
    """
    if table == "curves":
        frame = _curves(data, window, band)
    elif table == "summary":
        frame = summary_table(data)
    else:
        frame = _records(data, table, store)
    return encode_frame(frame, form), len(frame)


def _records(data: StudyData, table: str, store: Store) -> pd.DataFrame:
    """Return a table of records: evaluations from rows, all others from the runs' folders."""
    if table == "evaluations" and data.evaluated:
        return data.evaluations
    if table == "evaluations" or (data.averaged_over and table != "metrics"):
        known = ", ".join(name for name in EXPORT_TABLES if name != table)
        raise UserError(f"study {data.study.name}: {data.what} holds no {table}; try {known}")
    if any(run.published for run in data.rows):
        train = "train the runs, or choose others by --steps"
        raise UserError(f"study {data.study.name}: published tables hold no {table}; {train}")
    frames = []
    for named in data.runs[[*NAMING]].to_dict("records"):
        frame = record_frame(store, str(named["run_id"]), table).drop(columns=[*NAMING], errors="ignore")
        for place, (key, value) in enumerate(named.items()):
            frame.insert(place, str(key), value)
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def _curves(data: StudyData, window: str | None, band: str) -> pd.DataFrame:
    """Return all curves that every run has. Returns that were averaged when recorded are named so."""
    window_name = data.checked_window(window)
    known = curve_names(data)
    names = [name for name in EPISODE_QUANTITIES if name in known and data.has_curve(name, window_name)]
    names += ["share_killed"] if "share_killed" in known else []
    if not names:
        raise UserError(f"study {data.study.name}: {data.what} holds no returns, and so no curves")
    table = curves_table(study_curves(data, names, window), band)
    if data.averaged_over is not None:
        table["averaged_over"] = data.averaged_over
    return table


class Publication(NamedTuple):
    """What `publish_runs` wrote: the file, its runs from here and from before, and its bytes."""

    path: Path
    new: int
    staying: int
    size: int


def publish_runs(store: Store, data: StudyData, curves: Sequence[str]) -> Publication:
    """Write a study's runs as rows of a published table, with the curves of some quantities.

    Rows that the table has already stay in it. The same runs give the same bytes.
    """
    study, path = data.study, store.published_path(data.table_name)
    with store.publishing_lock(path.stem) as alone:
        if not alone:
            raise UserError(f"another command publishes {path}: try again when it has ended")
        new = {run.run_id: run for run in data.rows if not run.published}
        if not new:
            nothing = f"its runs are not in {store.root}: nothing is new to publish"
            raise UserError(f"study {study.name}: {nothing}")
        before = RunIndex(store).tables.get(path.stem)  # what Pneuma itself publishes stays, too
        rows = {**(before.rows() if before else {}), **new}
        about: dict[str, Any] = {
            "study": study.name,
            "world": data.world or None,
            "settings": dict(study.settings),
        }
        if listing := store.listing(study.name) if study.path is None else None:
            about["listing"] = listing
        order = sorted(rows.values(), key=lambda row: (row.config_id, row.budget, row.cell("seed")))
        encoded = encode_published(order, about, curves)
        store.write(path, encoded)
    return Publication(path, len(new), len(rows) - len(new), len(encoded))


LINES_OF_A_PAGE = 40
"""Most rows of a LaTeX table that is not broken over pages."""
LONGEST_IN_A_LINE = 40
"""Most characters of a cell in LaTeX whose text does not break into lines."""
PARAGRAPH = r"p{0.2\linewidth}"
_LATEX = str.maketrans({
    "−": "$-$", "±": r"$\pm$", "×": r"$\times$", "≤": r"$\leq$", "∞": r"$\infty$", "∇": r"$\nabla$",
    "‖": r"$\|$", "α": r"$\alpha$", "β": r"$\beta$", "γ": r"$\gamma$", "λ": r"$\lambda$",
    "ϵ": r"$\epsilon$", "ϑ": r"$\vartheta$", "₀": "$_0$", "₁": "$_1$", "₂": "$_2$", "ₜ": "$_t$", "²": "$^2$",
})  # fmt: skip
"""What pdfLaTeX stops at."""


def encode_frame(frame: pd.DataFrame, form: str) -> bytes:
    """Encode a table as csv, parquet, latex or markdown; the last two have rounded numbers."""
    if form == "csv":
        return frame.to_csv(index=False, lineterminator="\n").encode()
    if form == "parquet":
        return bytes(frame.to_parquet(index=False))
    cells = pd.DataFrame(_formatted_rows(frame), columns=frame.columns)
    numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    text = _latex(cells, numeric) if form == "latex" else _markdown(cells, numeric)
    return text.encode()


def _formatted_rows(frame: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each row as text with rounded numbers.

    Numbers with an interval are rounded with it; others keep six digits.
    """
    rows = []
    for row in frame.to_dict("records"):
        if {"value", "low", "high"} <= row.keys():
            is_count = row.get("statistic") == "count"
            places = 0 if is_count else decimals(row["value"], row["low"], row["high"])
            for key in ("value", "low", "high"):
                row[key] = shown(row[key], places)
        rows.append([_formatted(value) for value in row.values()])
    return rows


def _formatted(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.6g}"


def _latex(cells: pd.DataFrame, numeric: Sequence[bool]) -> str:
    columns = []
    for name, is_numeric in zip(cells, numeric, strict=True):
        longest = cells[name].str.len().max()
        column = "r" if is_numeric else "l"
        columns.append(PARAGRAPH if longest > LONGEST_IN_A_LINE else column)
    is_long = len(cells) > LINES_OF_A_PAGE
    text = cells.to_latex(index=False, escape=True, column_format="".join(columns), longtable=is_long)
    return text.translate(_LATEX)


def _markdown(cells: pd.DataFrame, numeric: Sequence[bool]) -> str:
    """Return a table in Markdown. `to_markdown` of pandas needs another package, and escapes nothing."""
    rules = ["---:" if is_numeric else "---" for is_numeric in numeric]
    lines = []
    for row in (cells.columns, rules, *cells.to_numpy()):
        line = " | ".join(str(cell).replace("|", r"\|").replace("\n", "<br>") for cell in row)
        lines.append(f"| {line} |\n")
    return "".join(lines)
