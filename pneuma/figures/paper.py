"""Everything in `paper_figures/`; `make figures` runs this module.

    python -m pneuma.figures.paper FOLDER [--results RESULTS] [--beside STUDY=LOGS]

It draws the environment's own figures; the thesis's tables of hyperparameters; the curves, summaries,
collapses, maps and numbers of every study in RESULTS/published; and the verdicts on all claims. Files of an
earlier run that are no longer drawn are removed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.asked import open_study
from pneuma.analysis.curves import curve_names
from pneuma.analysis.export import encode_frame
from pneuma.analysis.frames import StudyData, figure_basename
from pneuma.analysis.run_index import RunIndex
from pneuma.analysis.summaries import summary_table
from pneuma.config import BASES, as_fields, make_run
from pneuma.errors import UserError
from pneuma.figures.collapse import collapsed_shares, draw_collapse
from pneuma.figures.curves import (
    AS_IN_THESIS,
    MOST_CURVES,
    TRAILING_WINDOW,
    USUAL_QUANTITIES,
    draw_study,
    settle,
)
from pneuma.figures.environment import draw_level, draw_mailman, draw_screens
from pneuma.figures.maps import draw_robustness, study_maps
from pneuma.figures.origin import read_origin
from pneuma.figures.style import shrink
from pneuma.figures.summary import draw_summary
from pneuma.figures.verdicts import judged_claims, write_verdicts
from pneuma.study.plan import Selection
from pneuma.study.provenance import available_cores
from pneuma.study.store import Store
from pneuma.values import shown_value

RESULTS = Path("results")
COMMAND = "make figures"
TABLES = "tables"
SETTINGS_FILE = "table-6-1-and-6-2.md"

CONTRASTED = {
    "optimizer": ("stationary", "non-stationary"),
    "actor-size": ("smallest", "small"),
}
"""Conditions in the thesis's own figure, for studies that have more."""
MORE_BUDGETS = {"architecture": (40_000,)}
"""Budgets that are drawn beside the one of most runs."""
MORE_CURVES = {"gradient-limits": "grad_norm", "collapse": "entropy"}
"""More quantities that a study is about, beside the share killed and the return."""
BESIDE_QUANTITIES = ("return", "length", "entropy")

SETTINGS = (
    "gamma", "gae_lambda", "learning_rate", "clip_range", "horizon", "minibatch", "epochs",
    "value_coefficient", "entropy_coefficient", "optimizer", "betas", "epsilon", "activation",
    "gradient_limit", "actor", "critic",
)  # fmt: skip
"""Fields that the thesis's Tables 6.1 and 6.2 state or leave to the library."""


def draw_all(folder: Path, results: Path = RESULTS, beside: Mapping[str, str] | None = None) -> list[Path]:
    """Draw all figures and write all tables; return the files written.

    `beside` gives for a study's name the imported logs to draw with it.
    """
    (folder / TABLES).mkdir(parents=True, exist_ok=True)
    written = [*_draw_environment(folder), *_write_settings(folder)]
    index = RunIndex(Store(results), stored=False, shipped=False)
    largest_first = sorted(index.tables, key=lambda name: -len(index.tables[name].index))
    with ProcessPoolExecutor(available_cores(), get_context("spawn")) as pool:
        verdicts = pool.submit(_draw_verdicts, folder, results)
        for paths in pool.map(partial(_draw_one, folder, results, beside or {}), largest_first):
            written += paths
    written += verdicts.result()
    _remove_others(folder, written)
    return written


def _remove_others(folder: Path, written: Collection[Path]) -> None:
    """Remove tables and figures of an earlier run, which a figure's origin tells."""
    for path in {*folder.glob("*.*"), *(folder / TABLES).glob("*.md")} - {*written}:
        if path.parent.name == TABLES or _is_of_earlier_run(path):
            path.unlink()


def _is_of_earlier_run(path: Path) -> bool:
    try:
        return read_origin(path).command == COMMAND
    except UserError:
        return False


def _draw_verdicts(folder: Path, results: Path) -> list[Path]:
    """Draw the verdicts on the thesis's claims; nothing where no study is published."""
    store = Store(results)
    if not store.published(shipped=False):
        return []
    return write_verdicts(judged_claims(store, stored=False)[0], folder, COMMAND)


def _draw_environment(folder: Path) -> list[Path]:
    """Draw the figures of the environment itself, which have more colours than a palette."""
    return [path for draw in (draw_mailman, draw_screens, draw_level) for path in draw(folder, COMMAND)]


def _write_settings(folder: Path) -> list[Path]:
    """Write the thesis's two tables of hyperparameters."""
    path = folder / TABLES / SETTINGS_FILE
    path.write_bytes(encode_frame(settings_table(), "markdown"))
    return [path]


THESIS_BASES = ("table-6-1", "table-6-2")


def settings_table() -> pd.DataFrame:
    """Return the thesis's two bases of studies: a row per field, with both values and whether they differ."""
    bases = [as_fields(make_run(BASES[name])) for name in THESIS_BASES]
    rows = [[name, *(shown_value(base[name]) for base in bases)] for name in SETTINGS]
    table = pd.DataFrame(rows, columns=["setting", *THESIS_BASES])
    table["differs"] = ["yes" if one != other else "" for _, one, other in rows]
    return table


# --- One study ---------------------------------------------------------------------------------------


def _draw_one(folder: Path, results: Path, beside: Mapping[str, str], table: str) -> list[Path]:
    """Draw all figures of what a published table answers, and write its numbers; return the files written.

    Files are made small, because they are committed.
    """
    index = RunIndex(Store(results), stored=False, shipped=False)
    about = index.tables[table].about
    study, world, picked = about["study"], about.get("world"), Selection(settings=about.get("settings"))
    logs = open_study(index, beside[study]) if study in beside else None
    paths: list[Path] = []
    for steps in (None, *MORE_BUDGETS.get(study, ())):
        data = open_study(index, study, replace(picked, steps=steps), world)
        data = replace(data, figure=f"{data.figure}-{steps}") if steps else data
        drawn = [path for figure in _figures(data, folder, logs) for path in figure]
        for path in drawn:
            shrink(path)
        numbers = folder / TABLES / f"{table}{f'-{steps}' if steps else ''}.md"
        numbers.write_bytes(encode_frame(summary_table(data), "markdown"))
        paths += [*drawn, numbers]
    return paths


def _figures(data: StudyData, folder: Path, logs: StudyData | None) -> Iterator[list[Path]]:
    """Draw curves and a summary, and if there are any, collapses and maps.

    There are curves of the conditions in the thesis's figure, also drawn as there; of all conditions, if the
    study has more; and with imported logs beside them.
    """

    def draw(data: StudyData, shown: str = "", beside: StudyData | None = None, **how: Any) -> list[Path]:
        return draw_study(data, folder, settle(data, **how), shown=shown, beside=beside, command=COMMAND)

    if len(data.conditions) <= MOST_CURVES and set(USUAL_QUANTITIES) & set(curve_names(data)):
        names = [name for name in CONTRASTED.get(data.study, ()) if name in data.conditions]
        contrasted = data.of_conditions(names) if names else data
        yield draw(contrasted)
        if data.figure.startswith("fig-") and "return" in data.quantities:
            yield draw(contrasted, **AS_IN_THESIS)
        if 0 < len(names) < len(data.conditions):
            yield draw(replace(data, figure=f"{data.figure}-all"), "every condition")
    more = MORE_CURVES.get(data.study)
    if more in data.quantities:
        yield draw(data, quantities=(more,))
    if logs:
        held = [name for name in BESIDE_QUANTITIES if data.has_curve(name, TRAILING_WINDOW)]
        yield draw(data, "", logs, band="runs", window=TRAILING_WINDOW, quantities=held)
    yield draw_summary(data, folder, command=COMMAND)
    if len(collapsed_shares(data)):
        yield draw_collapse(data, folder, figure_basename(data, "collapses"), command=COMMAND)
    if maps := study_maps(data):
        yield draw_robustness(data, maps, folder, figure_basename(data, "map"), command=COMMAND)


def main(folder: Path, results: Path = RESULTS, beside: Sequence[str] = ()) -> None:
    """Draw everything and print what was written.

    Raises:
        UserError: when there is no results folder, because figures drawn from another one would be removed.
    """
    if not results.is_dir():
        raise UserError(f"{results}: is no folder, so nothing is drawn, and nothing removed")
    logs = dict(each.partition("=")[::2] for each in beside)
    if missing := [name for name in logs.values() if not Store(results).published_path(name).exists()]:
        raise UserError(f"--beside: no logs {missing[0]!r} are published in {results}; give STUDY=LOGS")
    for path in draw_all(folder, results, logs):
        print(f"wrote {path}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--beside", action="append", default=[], metavar="STUDY=LOGS")
    try:
        main(**vars(parser.parse_args()))
    except (UserError, OSError) as error:
        sys.exit(f"pneuma: {error}")
