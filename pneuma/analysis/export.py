"""Encode tables for other programs, and publish a study's rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from pneuma.analysis.intervals import decimals, shown
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.store import Store

# --- Published tables -----------------------------------------------------------------------------


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
    new = {run.run_id: run for run in data.rows if not run.published}
    if not new:
        raise UserError(
            f"study {study.name}: none of its runs is in {store.root}; train some before publishing"
        )
    about: dict[str, Any] = {
        "study": study.name,
        "world": data.world or None,
        "settings": dict(study.settings),
    }
    listing = store.listing(study.name)
    if study.path is None and listing:
        about["listing"] = listing
    with store.publishing_lock(path.stem) as is_alone:
        if not is_alone:
            raise UserError(f"another command is writing {path}: try again when it has ended")
        before = RunIndex(store).tables.get(path.stem)  # what Pneuma itself publishes stays, too
        rows = new
        if before:
            rows = {**before.rows(), **new}
        order = sorted(rows.values(), key=lambda row: (row.config_id, row.budget, row.cell("seed")))
        encoded = encode_published(order, about, curves)
        store.write(path, encoded)
    return Publication(path, len(new), len(rows) - len(new), len(encoded))


# --- Files ----------------------------------------------------------------------------------------

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
_MARKDOWN = {"|": r"\|", "\n": "<br>", "://": "&#58;//", "www.": "www&#46;"}
"""What ends a cell of Markdown, or makes a link of it."""


def encode_frame(frame: pd.DataFrame, form: str) -> bytes:
    """Encode a table as csv, parquet, latex or markdown; the last two have rounded numbers."""
    if form == "csv":
        return frame.to_csv(index=False, lineterminator="\n").encode()
    if form == "parquet":
        return bytes(frame.to_parquet(index=False))
    cells = pd.DataFrame(_formatted_rows(frame), columns=frame.columns)
    is_numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    encode = _latex if form == "latex" else _markdown
    return encode(cells, is_numeric).encode()


def _formatted_rows(frame: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each row as text with rounded numbers.

    Numbers with an interval are rounded with it; others keep six digits.
    """
    rows = []
    for row in frame.to_dict("records"):
        if {"value", "low", "high"} <= row.keys():
            digits = decimals(row["value"], row["low"], row["high"])
            if row.get("statistic") == "count":
                digits = 0
            for key in ("value", "low", "high"):
                row[key] = shown(row[key], digits)
        rows.append([_formatted(value) for value in row.values()])
    return rows


def _formatted(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.6g}"


def _latex(cells: pd.DataFrame, is_numeric: Sequence[bool]) -> str:
    columns = ""
    for name, is_number in zip(cells, is_numeric, strict=True):
        if cells[name].str.len().max() > LONGEST_IN_A_LINE:
            columns += PARAGRAPH
        else:
            columns += "r" if is_number else "l"
    is_long = len(cells) > LINES_OF_A_PAGE
    text = cells.to_latex(index=False, escape=True, column_format=columns, longtable=is_long)
    return text.translate(_LATEX)


def _markdown(cells: pd.DataFrame, is_numeric: Sequence[bool]) -> str:
    """Return a table in Markdown. `to_markdown` of pandas needs another package, and escapes nothing."""
    rules = ["---:" if is_number else "---" for is_number in is_numeric]
    lines = []
    for row in (cells.columns, rules, *cells.to_numpy()):
        line = []
        for cell in map(str, row):
            for text, code in _MARKDOWN.items():
                cell = cell.replace(text, code)
            line.append(cell)
        lines.append(f"| {' | '.join(line)} |\n")
    return "".join(lines)
