"""Records of a study's runs as tidy tables for other programs, and published tables."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pneuma.analysis import EDGED_BANDS, EXPORT_TABLES
from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import curve_names, curves_table, study_curves
from pneuma.analysis.intervals import decimals, number_text
from pneuma.analysis.study_data import RUN_KEY_COLUMNS, StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.errors import Hint, UserError, printable
from pneuma.store.index import RunIndex
from pneuma.store.published import encode_published
from pneuma.store.quantities import EPISODE_QUANTITIES
from pneuma.store.row_builder import record_frame
from pneuma.store.store import Store

# --- Published tables -----------------------------------------------------------------------------


class Publication(NamedTuple):
    """What `publish_runs` wrote: the file, its runs from here and from before, and its bytes."""

    path: Path
    new: int
    staying: int
    size: int


def publish_runs(store: Store, study_data: StudyData, quantities: Sequence[str]) -> Publication:
    """Write a study's runs as rows of a published table, with the curves of some quantities.

    Rows that the table has already stay in it. The same runs give the same bytes.
    """
    study, table_path = study_data.study, store.published_path(study_data.table_name)
    new_rows = {run.run_id: run for run in study_data.rows if not run.published}
    if not new_rows:
        raise UserError(
            f"study {study.name}: none of its runs is in {store.root}; train some before publishing"
        )
    description: dict[str, Any] = {
        "study": study.name,
        "world": study_data.world or None,
        "settings": dict(study.settings),
    }
    listing = store.listing(study.name)
    if study.path is None and listing:
        description["listing"] = listing
    with store.publishing_lock(table_path.stem) as is_alone:
        if not is_alone:
            raise UserError(f"another command is writing {table_path}: try again when it has ended")
        previous = RunIndex(store).tables.get(table_path.stem)  # what Pneuma itself publishes stays, too
        all_rows = new_rows
        if previous:
            all_rows = {**previous.rows(), **new_rows}
        ordered_rows = sorted(
            all_rows.values(),
            key=lambda row: (row.config_id, row.budget, row.cell("seed")),
        )
        encoded = encode_published(ordered_rows, description, quantities)
        store.write(table_path, encoded)
    return Publication(table_path, len(new_rows), len(all_rows) - len(new_rows), len(encoded))


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
_MARKDOWN = {
    "<": "&lt;", "](": r"]\(", "|": r"\|", "\n": "<br>", "://": "&#58;//", "www.": "www&#46;",
}  # fmt: skip
"""What ends a cell of Markdown, or makes a link, a picture or a program of it."""
_CELL = re.compile(r"[-−+]?[\d,.]+(e[-+]?\d+)?( ± \S+| \[[^]]*\])?( \(n = \d+\))?( %)?")
_SIGNS = r"[\w\s^_{}()\[\]+\-*/=<>.,|'\\]*"
_MATHEMATICS = re.compile(rf"\${_SIGNS}[\\^_]{_SIGNS}\$", re.ASCII)
_UNFINISHED = re.compile(r"[_^]\s*[_^}$]")
_COMMAND = re.compile(
    r"\\(alpha|beta|gamma|delta|epsilon|varepsilon|eta|theta|vartheta|kappa|lambda|mu|nu|pi|rho|sigma|tau|phi"
    r"|varphi|psi|omega|Delta|Theta|Lambda|Pi|Sigma|Phi|Psi|Omega|ell|infty|nabla|partial|pm|times|cdot|leq|geq"
    r"|neq|approx|sim|to|rightarrow|log|exp|max|min|sqrt|frac|sum|hat|bar|tilde|mathrm|mathcal|mathbf)"
)
"""What a name's formula may have; others, as \\input, would act in the document."""
FIRST_PRIVATE, MOST_FORMULAS = 0xE000, 6400
"""Letters without a meaning, of which visible text has none."""
_FORMULA = re.compile(r"(^|;)(?=\s*[=+\-@＝＋－＠])")
"""Where a spreadsheet takes text for a formula; where commas are decimal, its cells may end at semicolons."""
_NUMBER = re.compile(r"[+-]?[\d.]+(e[+-]?\d+)?", re.IGNORECASE | re.ASCII)


def encode_frame(frame: pd.DataFrame, form: str) -> bytes:
    """Encode a table as csv, parquet, latex or markdown; the last two have rounded numbers.

    Names may be untrusted: as text they drive no terminal, and a spreadsheet or a page runs none of them.
    """
    if form == "parquet":
        return bytes(frame.to_parquet(index=False))
    if form == "csv":
        texts = frame.select_dtypes(include=["object", "string"])
        safe_texts = {str(name): texts[name].map(_without_formula) for name in texts}
        safe_frame = frame.assign(**safe_texts).rename(columns=_without_formula)
        return safe_frame.to_csv(index=False, lineterminator="\n").encode()
    cells = pd.DataFrame(_formatted_rows(frame), columns=frame.columns).map(_visible)
    cells.columns = cells.columns.map(_visible)
    is_numeric = list(map(pd.api.types.is_numeric_dtype, frame.dtypes))
    if form == "latex":
        return _latex(cells, is_numeric).encode()
    return _markdown(cells, is_numeric).encode()


def _is_number(text: str) -> bool:
    """Return whether a cell is a number, perhaps with its interval or deviation, or has no value."""
    return text in ("–", "never") or _CELL.fullmatch(text) is not None


def _visible(text: str) -> str:
    """Return text with the codes of invisible characters, but with its line ends."""
    return "\n".join(map(printable, str(text).split("\n")))


def _without_formula(cell: object) -> object:
    """Return a cell with a ' before text that a spreadsheet would calculate."""
    if not isinstance(cell, str):
        return cell
    visible_text = _visible(cell)
    if _NUMBER.fullmatch(visible_text):
        return visible_text
    return _FORMULA.sub(r"\1'", visible_text)


def _formatted_rows(frame: pd.DataFrame) -> list[list[str]]:
    """Return the cells of each row as text with rounded numbers.

    A number with an interval is rounded with it; any other keeps six digits.
    """
    columns = list(frame.columns)  # two may have the same name, as conditions of two studies have
    formatted_rows = []
    for row_values in frame.itertuples(index=False, name=None):
        cells = list(row_values)
        if {"value", "low", "high"} <= set(columns):
            row = dict(zip(columns, row_values, strict=True))
            digits = decimals(row["value"], row["low"], row["high"])
            if row.get("statistic") == "count":
                digits = 0
            for column in ("value", "low", "high"):
                cells[columns.index(column)] = number_text(row[column], digits)
        formatted_rows.append(list(map(_formatted, cells)))
    return formatted_rows


def _formatted(value: object) -> str:
    if not isinstance(value, float):
        return str(value)
    return "–" if math.isnan(value) else f"{value:.6g}"


def _latex(cells: pd.DataFrame, is_numeric: Sequence[bool]) -> str:
    formulas: list[str] = []

    def keep(formula: re.Match[str]) -> str:
        """Put a letter that no text has in the place of a formula of known commands, which is not escaped."""
        is_known = all(map(_COMMAND.fullmatch, re.findall(r"\\[a-zA-Z]*", formula[0])))
        is_whole = formula[0].count("{") == formula[0].count("}") and not _UNFINISHED.search(formula[0])
        if not (is_known and is_whole) or len(formulas) == MOST_FORMULAS:
            return formula[0]
        formulas.append(formula[0])
        return chr(FIRST_PRIVATE + len(formulas) - 1)

    cells = cells.map(lambda text: _MATHEMATICS.sub(keep, text))
    cells.columns = cells.columns.map(lambda text: _MATHEMATICS.sub(keep, text))
    column_format = ""
    for position, is_number in enumerate(is_numeric):
        if cells.iloc[:, position].str.len().max() > LONGEST_IN_A_LINE:
            column_format += PARAGRAPH
        else:
            texts = cells.iloc[:, position]  # which may be numbers with their intervals
            is_number = is_number or bool(texts.map(_is_number).all() and texts.str.contains(r"\d").any())
            column_format += "r" if is_number else "l"
    is_long = len(cells) > LINES_OF_A_PAGE
    latex = cells.to_latex(index=False, escape=True, column_format=column_format, longtable=is_long)
    with_signs = re.sub(r"(?<![\w-])-(?=\d)", "$-$", latex)  # no hyphens before numbers
    packages = "packages booktabs and longtable" if is_long else "package booktabs"
    latex = with_signs.translate(_LATEX)
    latex = re.sub(r"[\ue000-\uf8ff]", lambda letter: formulas[ord(letter[0]) - FIRST_PRIVATE], latex)
    return f"% needs the {packages}\n{latex}"


def _markdown(cells: pd.DataFrame, is_numeric: Sequence[bool]) -> str:
    """Return a table in Markdown. `to_markdown` of pandas needs another package, and escapes nothing."""
    rules = np.where(is_numeric, "---:", "---")
    lines = []
    for row in (cells.columns, rules, *cells.to_numpy()):
        escaped_cells = []
        for cell in map(str, row):
            for characters, replacement in _MARKDOWN.items():
                cell = cell.replace(characters, replacement)
            escaped_cells.append(cell)
        lines.append(f"| {' | '.join(escaped_cells)} |\n")
    return "".join(lines)


# --- Records ----------------------------------------------------------------------------------------


def export_records(
    study_data: StudyData,
    table_name: str,
    store: Store,
    window: str | None = None,
    band: str = EDGED_BANDS[0],
) -> Answer:
    """Return one of `EXPORT_TABLES`. It contains no times, so that the same runs give the same table.

    Args:
        study_data: an opened study.
        table_name: its name.
        store: the results folder, which has the records of episodes and updates.
        window: of curves: which episodes a point averages.
        band: of curves: what low and high are, one of `EDGED_BANDS`.

    Raises:
        UserError: if the runs do not have such records.
    """
    if table_name == "curves":
        frame = _curves(study_data, window, band)
    elif table_name == "summary":
        frame = summary_table(study_data)
    elif table_name == "evaluations" and study_data.evaluated:
        frame = study_data.evaluations
    else:
        frame = _records(study_data, table_name, store)
    about = {**study_data.about, "table": table_name, "rows": len(frame)}
    return Answer(f"{study_data.full_title}: {table_name}", about, {table_name: frame}, [frame])


def _curves(study_data: StudyData, window: str | None, band: str) -> pd.DataFrame:
    """Return all curves that every run has. Returns that were averaged when recorded are named so."""
    window = study_data.checked_window(window)
    recorded_names = curve_names(study_data)
    quantities: list[str] = []
    for quantity in EPISODE_QUANTITIES:
        if quantity in recorded_names and all(window in run.windows_of(quantity) for run in study_data.rows):
            quantities.append(quantity)
    if "share_killed" in recorded_names:
        quantities.append("share_killed")
    if not quantities:
        raise UserError(
            f"study {study_data.study.name}: {study_data.origin} has no returns, and so no curves"
        )
    curve_table = curves_table(study_curves(study_data, quantities, window), [band]).rename(
        columns={"x": "step"}
    )
    if study_data.averaged_over is not None:
        curve_table["averaged_over"] = study_data.averaged_over
    return curve_table


def _records(study_data: StudyData, table_name: str, store: Store) -> pd.DataFrame:
    """Return the records of all runs, which published tables do not have."""
    if table_name == "evaluations" or (study_data.averaged_over and table_name != "metrics"):
        other_tables = ", ".join(other_table for other_table in EXPORT_TABLES if other_table != table_name)
        raise UserError(
            f"study {study_data.study.name}: {study_data.origin} holds no {table_name}; try {other_tables}"
        )
    if any(run.published for run in study_data.rows):
        problem = f"study {study_data.study.name}: published tables do not contain {table_name}"
        raise UserError(f"{problem}; train the runs, or choose others with ", Hint("steps"))
    run_frames: list[pd.DataFrame] = []
    for condition, seed, run_id in study_data.runs[list(RUN_KEY_COLUMNS)].itertuples(index=False):
        frame = record_frame(store, run_id, table_name)
        run_frames.append(frame.assign(condition=condition, seed=seed, run_id=run_id))
    records = pd.concat(run_frames, ignore_index=True)
    return records[list(dict.fromkeys([*RUN_KEY_COLUMNS, *records]))]
