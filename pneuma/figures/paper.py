"""Everything in `paper_figures/`; `make figures` runs this module.

    python -m pneuma.figures.paper FOLDER [--results RESULTS] [--beside STUDY=LOGS]

It draws the environment's own figures; the thesis's tables of hyperparameters; the curves, summaries,
collapses, maps and numbers of every study in RESULTS/published; and the verdicts on all claims. An index, as
JSON and as a page, has the command and runs of each file.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.curves import curve_names
from pneuma.analysis.export import encode_frame
from pneuma.analysis.frames import StudyData
from pneuma.analysis.run_index import open_published
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
from pneuma.figures.index import CONTENTS, INDEX, encode_contents, encode_index, index_entries, read_index
from pneuma.figures.maps import draw_robustness, study_maps
from pneuma.figures.panels import stem_of
from pneuma.figures.style import shrink
from pneuma.figures.summary import draw_summary, shown_outcome
from pneuma.figures.verdicts import judged_claims, write_verdicts
from pneuma.files import write_whole
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
MORE_CURVES = {"gradient-limits": "grad_norm", "collapse": "entropy"}
"""More quantities that a study is about, beside the share killed and the return."""
BESIDE_QUANTITIES = ("return", "length", "entropy")

SETTINGS = (
    "gamma", "gae_lambda", "learning_rate", "clip_range", "horizon", "minibatch", "epochs",
    "value_coefficient", "entropy_coefficient", "optimizer", "betas", "epsilon", "activation",
    "gradient_limit", "actor", "critic",
)  # fmt: skip
"""Fields that the thesis's Tables 6.1 and 6.2 state or leave to the library."""

Entries = list[dict[str, Any]]
"""Entries of the index."""


def draw_all(folder: Path, results: Path = RESULTS, beside: Mapping[str, str] | None = None) -> list[Path]:
    """Draw all figures and write all tables, the index and its page; return the files written.

    Files in the old index that are no longer drawn are removed.

    `beside` gives for a study's name the imported logs to draw with it.
    """
    (folder / TABLES).mkdir(parents=True, exist_ok=True)
    known = {entry["file"] for entry in read_index(folder)}  # which refuses a damaged index
    entries = [*_draw_environment(folder), *_write_settings(folder)]
    studies = open_published(results)
    stems = Counter(data.figure for data in studies)
    names = [
        (data.study, data.figure + (f"-{data.study}" if stems[data.figure] > 1 else "")) for data in studies
    ]
    logs = {study: log for study, log in (beside or {}).items() if log in dict(names)}
    sizes = {data.study: len(data.runs) for data in studies}
    largest_first = sorted(names, key=lambda name: -sizes[name[0]])
    with ProcessPoolExecutor(available_cores(), get_context("spawn")) as pool:
        verdicts = pool.submit(_draw_verdicts, folder, results)
        entries_by_study = pool.map(partial(_draw_one, folder, results, logs), largest_first)
        drawn = dict(zip(largest_first, entries_by_study, strict=True))
    entries += [entry for name in names for entry in drawn[name]]
    written = {entry["file"] for entry in entries}
    write_whole(folder / INDEX, encode_index(entries))
    write_whole(folder / CONTENTS, encode_contents(entries))
    for name in known - written:
        (folder / name).unlink()
    paths = [*(folder / entry["file"] for entry in entries), *verdicts.result()]
    return [*paths, folder / INDEX, folder / CONTENTS]


def _draw_verdicts(folder: Path, results: Path) -> list[Path]:
    """Draw the verdicts on the thesis's claims; nothing where no study is published."""
    store = Store(results)
    if not store.published(shipped=False):
        return []
    return write_verdicts(judged_claims(store, stored=False)[0], folder)


def _draw_environment(folder: Path) -> Entries:
    """Draw the figures of the environment itself, which have more colours than a palette."""
    level = sorted([*draw_screens(folder), *draw_level(folder)])
    drawn = [("pneuma/Mailman-v0", path) for path in sorted(draw_mailman(folder))]
    drawn += [("pneuma/Pneuma-v0, level thesis", path) for path in level]
    return [{"file": path.name, "command": COMMAND, "from": source, "runs": {}} for source, path in drawn]


def _write_settings(folder: Path) -> Entries:
    """Write the thesis's two tables of hyperparameters."""
    name = f"{TABLES}/{SETTINGS_FILE}"
    (folder / name).write_bytes(encode_frame(settings_table(), "markdown"))
    return [{"file": name, "command": COMMAND, "from": "thesis Tables 6.1 and 6.2", "runs": {}}]


def settings_table() -> pd.DataFrame:
    """Return the two bases of studies: one row per field, with its value in each and whether they differ."""
    bases = [as_fields(make_run(settings)) for settings in BASES.values()]
    rows = [[name, *(shown_value(base[name]) for base in bases)] for name in SETTINGS]
    table = pd.DataFrame(rows, columns=["setting", *BASES])
    table["differs"] = ["yes" if one != other else "" for _, one, other in rows]
    return table


# --- One study ---------------------------------------------------------------------------------------


def _draw_one(folder: Path, results: Path, beside: Mapping[str, str], names: tuple[str, str]) -> Entries:
    """Draw all figures of a study and write its tables; return their index entries.

    The names of figures are unique among all that are drawn. Files are made small, because they are
    committed.
    """
    study, figure = names
    (data,) = open_published(results, [study])
    data.figure = figure
    logs = open_published(results, [beside[study]])[0] if study in beside else None
    entries = []
    for shown, paths, look in _figures(data, folder, logs):
        for path in paths:
            shrink(path)
        entries += index_entries(paths, COMMAND, shown, look)
    path = folder / TABLES / f"{data.study}.md"
    path.write_bytes(encode_frame(summary_table(data), "markdown"))
    (entry,) = index_entries([path], COMMAND, data, {"table": "summary", "format": "markdown"})
    return [*entries, {**entry, "file": f"{TABLES}/{path.name}"}]


Drawn = tuple[StudyData, list[Path], dict[str, Any]]
"""What a figure shows, its files, and how it was drawn."""


def _figures(data: StudyData, folder: Path, logs: StudyData | None) -> Iterator[Drawn]:
    """Draw curves and a summary, and if there are any, collapses and maps.

    There are curves of the conditions in the thesis's figure, also drawn as there; of all conditions, if the
    study has more; and with imported logs beside them.
    """

    def drawn(shown_data: StudyData, shown: str = "", beside: StudyData | None = None, **how: Any) -> Drawn:
        drawing = settle(shown_data, **how)
        look = {"figure": "curves", "conditions": shown_data.conditions, **asdict(drawing)}
        look |= {"beside": beside.study} if beside else {}
        return shown_data, draw_study(shown_data, folder, drawing, shown=shown, beside=beside), look

    if len(data.conditions) <= MOST_CURVES and set(USUAL_QUANTITIES) & set(curve_names(data)):
        names = [name for name in CONTRASTED.get(data.own_name, ()) if name in data.conditions]
        contrasted = data.of_conditions(names) if names else data
        yield drawn(contrasted)
        if data.figure.startswith("fig-") and "return" in data.quantities:
            yield drawn(contrasted, **AS_IN_THESIS)
        if 0 < len(names) < len(data.conditions):
            every = data.of_conditions(data.conditions)
            every.figure = f"{data.figure}-all"
            yield drawn(every, "every condition")
    more = MORE_CURVES.get(data.own_name)
    if more in data.quantities:
        yield drawn(data, quantities=(more,))
    if logs:
        held = [name for name in BESIDE_QUANTITIES if data.has_curve(name, TRAILING_WINDOW)]
        yield drawn(data, "", logs, band="runs", window=TRAILING_WINDOW, quantities=held)
    yield data, draw_summary(data, folder), {"figure": "summary", "outcome": shown_outcome(data)}
    if len(collapsed_shares(data)):
        yield data, draw_collapse(data, folder, stem_of(data, "collapses")), {"figure": "collapses"}
    if maps := study_maps(data):
        look = {"figure": "map", "contrasts": [each.setting for each in maps]}
        yield data, draw_robustness(data, maps, folder, stem_of(data, "map")), look


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
