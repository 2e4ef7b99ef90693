"""Read tidy tables, whose columns the user names, and Stable-Baselines3's monitors.

Nothing is guessed: what could be read in two ways is refused.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pneuma.errors import Hint, Message, UserError, counted, unknown_name
from pneuma.files import read_text
from pneuma.imports.logs import (
    MOST_COLUMNS,
    Import,
    Log,
    choose_study_name,
    condition_and_seed,
    file_facts,
    store_logs,
)
from pneuma.store.quantities import (
    EPISODE_QUANTITIES,
    EVALUATION_QUANTITIES,
    QUANTITIES,
    TAGS,
    TRAINING_QUANTITIES,
)
from pneuma.store.store import Store

SOURCE, IMPORT_VERSION = "csv", 2
MONITOR = "monitor.csv"
IMPORTED = [name for name in TRAINING_QUANTITIES + EVALUATION_QUANTITIES if QUANTITIES[name].tags]
"""Quantities that a column may have."""
SUGGESTED = {
    "step": r"_?(global_)?steps?|(total_)?timesteps|time/total_timesteps",
    "values": r".*(return|reward|ep_rew_mean).*",
    "condition": "condition",
    "seed": "seed",
}
"""Names of columns, in lower case, that are suggested for fields of `Columns`."""


@dataclass(frozen=True)
class Columns:
    """The columns of a table to import. By default, a file's name has condition and seed.

    Attributes:
        step: the column of agent steps.
        values: columns of values, COLUMN or COLUMN=QUANTITY; without a quantity they are returns.
        condition: a column, or the condition of all rows.
        seed: a column, or the seed of all rows.
        averaged_over: how many episodes returns and lengths average; None to leave them as they are.
    """

    step: str = ""
    values: tuple[str, ...] = ()
    condition: str = ""
    seed: str = ""
    averaged_over: int | None = None


def import_csv(
    paths: Sequence[Path], columns: Columns, store: Store, study_name: str | None = None
) -> Import:
    """Import the runs in some files as one study; all files are read before anything is written.

    Each monitor is a run. If condition and seed name one run, the monitors are its environments.

    Raises:
        UserError: for files that could be read in two ways.
    """
    shared_folder = Path(os.path.commonpath([path.resolve().parent for path in paths]))
    is_single = len(paths) == 1 and paths[0].name != MONITOR
    chosen_name = choose_study_name(
        study_name, paths[0].with_suffix("") if is_single else shared_folder, store, SOURCE
    )
    logs: list[Log] = []
    monitors: dict[Path, str] = {}
    for path in sorted(set(paths)):
        text = read_text(path)
        _refuse_other_kinds(path, text)
        if text.startswith("#"):
            monitors[path] = text
        else:
            logs += _read_runs(path, shared_folder, text, columns)
    if monitors and (columns.step or columns.values):
        text = f"{next(iter(monitors))}: is a monitor file, which needs no columns: leave out "
        raise UserError(text, Hint("step"), " and ", Hint("values"))
    monitors_of_runs = [{path: text} for path, text in monitors.items()]
    if monitors and columns.condition and columns.seed:
        monitors_of_runs = [monitors]
    for run_monitors in monitors_of_runs:
        logs.append(_read_monitors(run_monitors, shared_folder, columns))
    return store_logs(logs, store, SOURCE, chosen_name, adds_runs=study_name is not None)


def _name_parts(path: Path, shared_folder: Path) -> tuple[str, ...]:
    """Return the names of a file and its folders, below the folder that all files share."""
    file_name = path.name.removesuffix(MONITOR).removesuffix(".csv").rstrip(".")
    folder_names = path.resolve().parent.relative_to(shared_folder).parts
    if file_name:
        return folder_names + (file_name,)
    return folder_names or (shared_folder.name,)


def _make_log(
    log_name: str, run: tuple[str, int], points: list[pd.DataFrame], texts: Iterable[str], **selection: Any
) -> Log:
    """Return the log of a run; `selection` is what selects its data, which is part of its id."""
    identity_facts = {
        "import_version": IMPORT_VERSION,
        **selection,
        "files": [file_facts(text.encode()) for text in texts],
    }
    return Log(
        name=log_name,
        condition=run[0],
        seed=run[1],
        points=pd.concat(points, ignore_index=True).assign(superseded=False),
        identity=repr([SOURCE, run, identity_facts]),
        provenance={"imported": SOURCE, **identity_facts},
    )


# --- Tidy tables ------------------------------------------------------------------------------------


def _read_runs(path: Path, shared_folder: Path, file_text: str, columns: Columns) -> Iterator[Log]:
    """Yield the runs of a table."""
    table = _read_cells(path, file_text)
    if not (columns.step and columns.values):
        raise _columns_to_choose(path, table)
    quantities = dict(_column_and_quantity(table, column_option) for column_option in columns.values)
    if len(set(quantities.values())) < len(columns.values):
        raise UserError(
            Hint("values"), ": two columns are given for one quantity; give one, or write COLUMN=QUANTITY"
        )
    steps = _whole_numbers(path, _find_column(table, "step", columns.step))
    condition, seed = condition_and_seed(_name_parts(path, shared_folder))
    runs = pd.DataFrame({"condition": columns.condition or condition, "seed": seed}, index=table.index)
    if columns.condition and columns.condition in table:
        runs["condition"] = table[columns.condition].str.strip()
        _refuse_cells(path, table[columns.condition][runs["condition"] == ""], "a condition")
    if columns.seed and columns.seed in table:
        runs["seed"] = _whole_numbers(path, table[columns.seed])
    elif columns.seed:
        runs["seed"] = _read_seed(columns.seed, list(table.columns))
    values_by_column = {column: _numbers(path, table[column]) for column in quantities}
    for _, run_rows in runs.groupby(["condition", "seed"], sort=False):
        condition, seed = str(run_rows["condition"].iloc[0]), int(run_rows["seed"].iloc[0])
        run_name = f"{condition} with seed {seed}"
        notes, points = [], []
        for column, quantity in quantities.items():
            run_values = values_by_column[column][run_rows.index]
            finite_values = run_values[np.isfinite(run_values)]
            lost_rows = len(run_values) - len(finite_values)
            if lost_rows:
                row_count = counted(len(run_values), "row")
                notes.append(f"{lost_rows} of {row_count} have no finite {column} and are left out")
            run_steps = steps[finite_values.index]
            _refuse_two_runs(path, run_steps, run_name)
            tag = QUANTITIES[quantity].tags[-1]
            if quantity in EPISODE_QUANTITIES and columns.averaged_over != 1:
                tag = QUANTITIES[quantity].tags[0]
            points.append(pd.DataFrame({"tag": tag, "step": run_steps, "value": finite_values}))
        log = _make_log(
            f"{path.name}, {run_name}",
            (condition, seed),
            points,
            [file_text],
            averaged_over=columns.averaged_over,
            selection=[columns.step, quantities, columns.condition, columns.seed],
        )
        log.notes += notes
        yield log


def _refuse_other_kinds(path: Path, file_text: str) -> None:
    """Refuse a study's file, JSON, and a table with comments above its header, which is no monitor."""
    problem = ""
    if path.suffix == ".toml":
        problem = "a TOML file; `pneuma study run` trains a study"
    elif path.suffix in (".json", ".jsonl") or file_text.lstrip()[:1] in ("{", "["):
        problem = "JSON; write its numbers as a table"
    elif re.match(r"#(?!\s*\{)", file_text):
        problem = "a table with comments; remove the lines that begin with #"
    if problem:
        raise UserError(f"{path}: is {problem}")


def _read_cells(path: Path, file_text: str) -> pd.DataFrame:
    """Return the cells of a table as text, by the number of their row."""
    header_line = file_text.partition("\n")[0]
    for separator, separator_name in ((";", "semicolons"), ("\t", "tabs")):
        if separator in header_line and "," not in header_line:
            raise UserError(
                f"{path}: its cells are separated by {separator_name}; "
                "save it with commas between cells and points in numbers"
            )
    if header_line.count(",") >= MOST_COLUMNS:
        column_count = header_line.count(",") + 1
        raise UserError(f"{path}: has {column_count:,} columns; {MOST_COLUMNS:,} are the most")
    try:
        cell_rows = pd.read_csv(
            io.StringIO(file_text), header=None, dtype=str, keep_default_na=False, skip_blank_lines=False
        )
    except ValueError as error:
        raise UserError(f"{path}: cannot be read as CSV ({str(error).strip()})") from None
    cell_rows.index += 1
    cell_rows = cell_rows[~cell_rows.isin(["", None]).all(axis="columns")]  # blank lines count as rows
    if len(cell_rows) < 2:
        raise UserError(f"{path}: has no rows below its header")
    is_named = cell_rows.iloc[0].str.strip() != ""  # a nameless column is an index, as pandas writes it
    cell_rows = cell_rows.loc[:, is_named]
    header = cell_rows.iloc[0].str.strip()
    if header.duplicated().any():
        raise UserError(f"{path}: has two columns named {header[header.duplicated()].iloc[0]!r}; rename one")
    return cell_rows.iloc[1:].set_axis(list(header), axis="columns")


def _columns_to_choose(path: Path, table: pd.DataFrame) -> UserError:
    """Return the error that lists a table's columns, with those that their names suggest."""
    message_parts: list[str | Hint] = [f"{path}: choose from its columns {', '.join(table.columns)}, as in"]
    for argument, pattern in SUGGESTED.items():
        suggestions = [column for column in table.columns if re.fullmatch(pattern, column.lower())]
        if len(suggestions) == 1:
            message_parts += [" ", Hint(argument, suggestions[0])]
        elif argument in ("step", "values"):
            message_parts += [" ", Hint(argument, "COLUMN")]
    return UserError(*message_parts)


def _find_column(table: pd.DataFrame, argument: str, column: str) -> pd.Series:
    if column not in table:
        raise unknown_name(Message("column in ", Hint(argument)), column, list(table.columns))
    return table[column]


def _read_seed(seed_text: str, columns: Sequence[str] = ()) -> int:
    """Return the seed of all rows."""
    if re.fullmatch("[0-9]{1,18}", seed_text):
        return int(seed_text)
    if columns:
        raise unknown_name(Message("column in ", Hint("seed")), seed_text, columns)
    raise UserError(
        Hint("seed", seed_text), ": must be a number, because a monitor file has no column of seeds"
    )


def _column_and_quantity(table: pd.DataFrame, column_option: str) -> tuple[str, str]:
    column, quantity = column_option, "return"
    if column_option not in table and "=" in column_option:
        column, _, quantity = column_option.rpartition("=")
    _find_column(table, "values", column)
    if quantity not in IMPORTED:
        raise unknown_name(Message("quantity in ", Hint("values", column_option), ":"), quantity, IMPORTED)
    min_column, max_column = f"{column}__MIN", f"{column}__MAX"
    if min_column in table and max_column in table and not table[min_column].equals(table[max_column]):
        raise UserError(
            Hint("values", column), f": holds means, as {min_column} shows; export all rows of single runs"
        )
    return column, quantity


def _numbers(path: Path, cells: pd.Series) -> pd.Series:
    """Return the numbers of a column; NaN where there is none."""
    numbers = pd.to_numeric(cells, errors="coerce").astype(float)
    is_unclear = numbers.isna() & ~cells.str.strip().str.lower().isin(["", "nan"])
    _refuse_cells(path, cells[is_unclear], "a plain number as 1024 or 0.5")
    return numbers


def _whole_numbers(path: Path, cells: pd.Series) -> pd.Series:
    """Return steps or seeds; refuse other numbers, and 1.000, which may be a thousand."""
    numbers = _numbers(path, cells)
    has_thousands = cells.str.strip().str.fullmatch(r"[1-9]\d{0,2}(\.\d{3})+")
    is_integer = numbers.between(0, 2**53) & (numbers % 1 == 0) & ~has_thousands
    _refuse_cells(path, cells[~is_integer], "a whole number as 1024")
    return numbers.astype("int64")


def _refuse_cells(path: Path, wrong_cells: pd.Series, allowed: str) -> None:
    if len(wrong_cells):
        first_cell = (
            f"{path}, row {wrong_cells.index[0]}: {wrong_cells.iloc[0]!r} in column {wrong_cells.name}"
        )
        raise UserError(f"{first_cell} must be {allowed}, without thousands separators")


def _refuse_two_runs(path: Path, steps: pd.Series, run_name: str) -> None:
    backward = steps.index[steps.diff() <= 0]
    if len(backward):
        step = steps[backward[0]]
        problem = f"{path}, row {backward[0]}: step {step:,} of {run_name} is not after the one before: "
        arguments = Hint("condition"), " and ", Hint("seed")
        raise UserError(
            f"{problem}distinguish the runs with ", *arguments, ", and sort the rows of each by step"
        )


# --- Monitors of Stable-Baselines3 ------------------------------------------------------------------


def _read_monitors(monitors: Mapping[Path, str], shared_folder: Path, columns: Columns) -> Log:
    """Return the run of one monitor, or of several environments, whose episodes are ordered by their clock.

    After a restart that appended to a monitor, its clock starts again. A single monitor keeps the order of
    its rows; several are refused.
    """
    episode_tables = []
    for path, file_text in monitors.items():
        episodes = _read_episodes(path, file_text)
        if len(monitors) > 1 and not episodes["t"].is_monotonic_increasing:
            raise UserError(
                f"{path}: its clock restarts, so it cannot join other monitor files; import it alone"
            )
        episode_tables.append(episodes)
    episodes = pd.concat(episode_tables, ignore_index=True)
    if len(monitors) > 1:
        episodes = episodes.sort_values("t", kind="stable")
    steps = episodes["l"].cumsum().astype("int64")
    points = []
    for quantity, column in (("return", "r"), ("length", "l")):
        points.append(pd.DataFrame({"tag": TAGS[quantity][1], "step": steps, "value": episodes[column]}))
    condition, seed = condition_and_seed(_name_parts(next(iter(monitors)), shared_folder))
    if columns.seed:
        seed = _read_seed(columns.seed)
    log_name = ", ".join(path.name for path in monitors)
    run_key = (columns.condition or condition, seed)
    return _make_log(log_name, run_key, points, monitors.values(), averaged_over=1, selection=["monitors"])


def _read_episodes(path: Path, file_text: str) -> pd.DataFrame:
    """Return the episodes of a monitor: return r, length l, and end t in seconds since 1970."""
    header, _, episodes_text = file_text.partition("\n")
    try:
        start_second = float(json.loads(header.removeprefix("#"))["t_start"])
        episodes = pd.read_csv(io.StringIO(episodes_text))[list("rlt")].astype(float)
    except Exception as error:  # of a file that is not a monitor it may be any
        reason = str(error).partition("\n")[0]
        raise UserError(f"{path}: is not a monitor of Stable-Baselines3 ({reason})") from None
    is_sound = episodes["l"].between(1, 2**53) & episodes[["r", "t"]].map(math.isfinite).all(axis="columns")
    if not is_sound.all():
        raise UserError(f"{path}: a row lacks its return r, length l or time t; remove it")
    return episodes.assign(t=episodes["t"] + start_second)
