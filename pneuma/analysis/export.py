"""Export a study's records as one table in a file for other programs."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator

import pandas as pd

from pneuma.analysis import EPISODE_QUANTITIES, EXPORTED_BAND
from pneuma.analysis.curves import curves_table, evaluation_curves, training_curves
from pneuma.analysis.frames import StudyData
from pneuma.analysis.intervals import decimals, shown
from pneuma.analysis.summaries import summary_table
from pneuma.errors import UserError


def encode_table(
    data: StudyData, table: str, form: str, window: str | None = None, band: str = EXPORTED_BAND
) -> tuple[bytes, int]:
    """Return one of `EXPORT_TABLES` in one of `EXPORT_FORMATS`, and its number of rows.

    The same runs give the same bytes; no table holds wall-clock values.

    Args:
        data: the study's finished runs.
        table: which.
        form: as what kind of file.
        window: of curves, one of `WINDOWS`; the study's usual one when left out.
        band: of curves, one of `EDGED_BANDS`, whose edges are the columns `low` and `high`.

    Raises:
        UserError: where the data holds no such table or window.
    """
    if table == "curves":
        frame = _curves(data, window, band)
    else:
        frame = summary_table(data) if table == "summary" else data.table(table)
    return encode_frame(frame, form), len(frame)


def _curves(data: StudyData, window: str | None, band: str) -> pd.DataFrame:
    """Return every curve there is; returns that were averaged when they were recorded say so."""
    lacking = lacks_window(data, window)
    names = [name for name in EPISODE_QUANTITIES if name in data.quantities and name not in lacking]
    curves = {name: training_curves(data, name, window) for name in names}
    if "evaluations" in data.tables:
        curves["share_killed"] = evaluation_curves(data)
    if not curves:
        raise UserError(f"study {data.study}: {data.what} holds no returns, and so no curves")
    table = curves_table(curves, band)
    if data.averaged_over is not None:
        table["averaged_over"] = data.averaged_over
    return table


def lacks_window(data: StudyData, window: str | None) -> list[str]:
    """Return the quantities of episodes that are not held with a window: small published tables hold few.

    Raises:
        UserError: for a window that the data cannot have.
    """
    data.checked_window(window)
    held = [name for name in EPISODE_QUANTITIES if name in data.quantities]
    return [name for name in held if not _is_held(data, name, window)]


def _is_held(data: StudyData, quantity: str, window: str | None) -> bool:
    try:
        data.curve(data.runs[0], quantity, window)
    except UserError:
        return False
    return True


def encode_frame(frame: pd.DataFrame, form: str) -> bytes:
    """Return a table in one of `EXPORT_FORMATS`."""
    if form == "csv":
        return _unrunnable(frame).to_csv(index=False, lineterminator="\n").encode()
    if form == "parquet":
        return bytes(frame.to_parquet(index=False))
    return (_to_latex if form == "latex" else _to_markdown)(frame).encode()


def _unrunnable(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table in which a spreadsheet runs no text: names may be untrusted."""
    safe = frame.copy()
    for name in safe.select_dtypes(include=["object", "string"]):
        safe[name] = safe[name].map(_as_text)
    return safe


def _as_text(cell: object) -> object:
    """Return a cell, with a quotation mark before a text that would be a formula."""
    if not isinstance(cell, str) or not cell.startswith(("=", "+", "-", "@", "\t", "\r")):
        return cell
    return cell if re.fullmatch(r"[+-][\d.]+(e[+-]?\d+)?", cell) else "'" + cell


def _to_latex(frame: pd.DataFrame) -> str:
    """Return a plain LaTeX tabular; written here because pandas' own wants Jinja2."""
    columns = "".join("r" if pd.api.types.is_numeric_dtype(kind) else "l" for kind in frame.dtypes)
    lines = [r"\begin{tabular}{" + columns + "}", r"\hline", _latex_row(frame.columns), r"\hline"]
    lines += [_latex_row(row) for row in _read_rows(frame)]
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def _to_markdown(frame: pd.DataFrame) -> str:
    """Return a pipe table; written here because pandas' own wants tabulate."""
    numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    rule = ["---:" if right else "---" for right in numeric]
    rows = [[cell.translate(_MARKDOWN) for cell in row] for row in _read_rows(frame)]
    lines = ["| " + " | ".join(cells) + " |" for cells in ([*map(str, frame.columns)], rule, *rows)]
    return "\n".join([*lines, ""])


def _read_rows(frame: pd.DataFrame) -> Iterator[list[str]]:
    """Yield the cells of every row as people read them.

    A number beside an interval is rounded with it; others keep six digits.
    """
    for row in frame.to_dict("records"):
        if {"value", "low", "high"} <= row.keys():
            places = decimals(row["value"], row["low"], row["high"])
            row |= {key: shown(row[key], places) for key in ("value", "low", "high")}
        yield [_cell(cell) for cell in row.values()]


def _cell(cell: object) -> str:
    if isinstance(cell, float):
        return "–" if math.isnan(cell) else f"{cell:.6g}"
    return str(cell)


def _latex_row(cells: Iterable[object]) -> str:
    return " & ".join(_latex_cell(cell) for cell in cells) + r" \\"


def _latex_cell(cell: object) -> str:
    return str(cell).translate(_LATEX).replace("–", "--")


_LATEX = str.maketrans(
    {
        **{special: "\\" + special for special in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "^": r"\textasciicircum{}",
        "~": r"\textasciitilde{}",
    }
)

_MARKDOWN = str.maketrans({"|": r"\|", "\\": r"\\", "<": "&lt;", "*": r"\*", "_": r"\_", "`": r"\`"})
