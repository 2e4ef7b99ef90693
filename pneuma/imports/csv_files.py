"""CSV files as logs: exports of wandb, Stable-Baselines3's monitors and progress, and any other.

files → tables of text → columns of each run by tag → `Log` → `logs.store_logs`

Nothing is left out in silence: rows without a number, steps that come twice or out of order are told.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pneuma.errors import UserError, counted
from pneuma.imports.logs import AGENT_STEPS, ImportedRun, Log, file_facts, store_logs
from pneuma.imports.points import ONE_EPISODE
from pneuma.study.quantities import TAGS
from pneuma.study.series import TRAILING_EPISODES
from pneuma.study.store import Store

SOURCE, IMPORT_VERSION = "csv", 1
MEANS = (TAGS["return"][0], TAGS["length"][0])
PROGRESS_STEP, WANDB_STEPS = "time/total_timesteps", ("Step", "_step", "global_step")
MONITOR = ("r", "l", "t")
"""Columns of a monitor: an episode's return, length, and the seconds when it ended."""

Columns = Mapping[str, tuple[pd.Series, pd.Series]]
"""Steps and values by tag."""


def import_csv(
    paths: Sequence[Path],
    store: Store,
    name: str | None = None,
    step: str = "",
    returns: str = "",
    averaged_over: int | None = None,
) -> tuple[str, list[ImportedRun], list[str]]:
    """Import the runs of CSV files as one study; return its name, its runs, and notes for the user.

    A file NAME_1.csv is the seed 1 of NAME, as a folder of a log is; of wandb, each column is a run. `step`
    and `returns` name columns, of which wandb's are `RUN - returns`. `averaged_over` is the number of
    episodes that a return is the mean of, where the file does not tell; 1 for every single episode.
    """
    paths = [path.resolve() for path in paths]
    places = [path.with_suffix("") if len(paths) == 1 else path.parent for path in paths]
    return store_logs(_read_all(paths, step, returns, averaged_over), store, SOURCE, places, name)


def _read_all(paths: Sequence[Path], step: str, returns: str, averaged_over: int | None) -> Iterator[Log]:
    """Yield each run in some files; the monitors in a folder are of one run."""
    shared = os.path.commonpath([path.parent.parent for path in paths])
    monitors: dict[Path, list[tuple[Path, pd.DataFrame]]] = {}
    for path in sorted({*paths}):
        frame, notes = _read_table(path)
        folder = path.parent.relative_to(shared).parts
        if not (step or returns) and {*MONITOR} <= {*frame}:
            monitors.setdefault(path.parent, []).append((path, frame))
        elif not (step or returns) and PROGRESS_STEP in frame:
            tags = [tag for tag in map(str, frame) if tag.startswith(AGENT_STEPS) and tag != PROGRESS_STEP]
            columns = {tag: _logged(frame, PROGRESS_STEP, tag) for tag in tags}
            yield _log(folder, [path], columns, TRAILING_EPISODES, notes)
        else:
            at = step or next((known for known in WANDB_STEPS if known in frame), "")
            for name, column in _return_columns(path, frame, at, returns).items():
                metric = column.rpartition(" - ")[2]
                told = {ONE_EPISODE[0]: 1, MEANS[0]: TRAILING_EPISODES}.get(metric, averaged_over)
                over = told or TRAILING_EPISODES
                guess = f"its returns are taken for means of {over} episodes;"
                guess += " --averaged-over N tells otherwise"
                points = {(ONE_EPISODE if over == 1 else MEANS)[0]: _logged(frame, at, column, not name)}
                yield _log((name or path.stem,), [path], points, over, [*notes, *[guess] * (not told)])
    for place, read in monitors.items():
        whole = pd.concat([frame for _, frame in read])[[*MONITOR]].apply(_numbers)
        whole = whole.sort_values("t", kind="stable")
        steps = whole["l"].cumsum()
        columns = dict(zip(ONE_EPISODE, ((steps, whole["r"]), (steps, whole["l"])), strict=True))
        yield _log(place.relative_to(shared).parts, [path for path, _ in read], columns, 1, [])


def _log(
    parts: tuple[str, ...], paths: Sequence[Path], columns: Columns, averaged_over: int, notes: list[str]
) -> Log:
    """Return a run of sound points, with notes on those that are not."""
    tables = []
    for tag, (steps, values) in columns.items():
        whole = pd.DataFrame({"tag": tag, "step": steps, "value": values})
        sound = whole[np.isfinite(whole["step"]) & np.isfinite(whole["value"]) & (whole["step"] >= 0)]
        if tag in (*ONE_EPISODE, *MEANS) and (lost := len(whole) - len(sound)):
            notes.append(f"{lost} of {counted(len(whole), 'row')} have no step or no value, and are left out")
        if (sound["step"].diff() < 0).any():
            notes.append(f"the steps of {tag} are out of order, and are sorted")
        sound = sound.astype({"step": np.int64}).sort_values("step", kind="stable")
        tables.append(sound.assign(superseded=sound.duplicated("step", keep="last")))
        if again := int(tables[-1]["superseded"].sum()):
            notes.append(f"{tag}: {counted(again, 'step')} that came again; the last value counts")
    files = [file_facts(path.read_bytes()) for path in paths]
    hashes = [file["sha256"] for file in files]
    about = {"import_version": IMPORT_VERSION, "averaged_over": averaged_over, "files": files}

    def identify(condition: str, seed: int) -> str:
        return repr([SOURCE, IMPORT_VERSION, averaged_over, condition, seed, hashes, sorted(columns)])

    return Log(parts, pd.concat(tables, ignore_index=True), identify, {"imported": SOURCE, **about}, notes)


def _return_columns(path: Path, frame: pd.DataFrame, step: str, returns: str) -> dict[str, str]:
    """Return the columns of returns by the run that each is of, which is empty for a file of one run."""
    columns = [name for name in map(str, frame) if not name.endswith(("__MIN", "__MAX"))]
    of_runs = {name.rpartition(" - ")[0]: name for name in columns if " - " in name}
    metrics = {name.rpartition(" - ")[2] for name in of_runs.values()}
    found = {run: f"{run} - {returns}" for run in of_runs if f"{run} - {returns}" in columns}
    if returns in columns:
        found = {"": returns}
    elif not returns and len(metrics) == 1:
        found = of_runs
    if step not in columns or not found:
        lacking = f"--step {step}" if step and step not in columns else "which columns are steps and returns"
        raise UserError(
            f"{path}: does not tell {lacking}; name two of its columns with --step and --return: "
            f"{', '.join(columns[:10])}"
        )
    return found


def _read_table(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Return a file's columns as text, and notes on how it was read."""
    try:
        text = path.read_bytes().decode("utf-8-sig")
        if text.startswith("#"):  # what a monitor says of its environment
            text = text.partition("\n")[2]
        separator = max(",;\t", key=text.partition("\n")[0].count)
        how: Any = {"sep": separator, "dtype": str, "keep_default_na": False, "index_col": False}
        frame = pd.read_csv(io.StringIO(text), **how)
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise UserError(f"{path}: cannot be read as CSV ({why})") from None
    frame.columns = frame.columns.str.strip()
    commas = any(column.str.fullmatch(r"\s*[+-]?\d+,\d+\s*").any() for _, column in frame.items())
    return frame, ["decimal commas are read as points"] if commas else []


def _numbers(column: pd.Series) -> pd.Series:
    """Return numbers; NaN for what is none, or not finite."""
    read = pd.to_numeric(column.str.strip().str.replace(",", "."), errors="coerce")
    return read.astype(float)


def _logged(frame: pd.DataFrame, step: str, column: str, alone: bool = False) -> tuple[pd.Series, pd.Series]:
    """Return steps and values of a column; blank cells of one that is not alone are of other columns."""
    there = frame[frame[column].str.strip() != ""] if not alone else frame
    return _numbers(there[step]), _numbers(there[column])
