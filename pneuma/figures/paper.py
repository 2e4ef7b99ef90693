"""Everything in `paper_figures/`: `make figures` runs this, and nothing else writes there.

    python -m pneuma.figures.paper FOLDER [RESULTS]

The environment's own figures, and of every published study in RESULTS/published its curves, in the thesis's
layout too where the thesis has that figure, its summary, its collapses and maps if it has some, and its
numbers as tables. Beside them an index: which command drew each, from which runs.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import starmap
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from PIL import Image

from pneuma.analysis.export import encode_frame
from pneuma.analysis.sources import open_published
from pneuma.analysis.summaries import summary_table
from pneuma.analysis.tables import StudyData, tell_figures_apart
from pneuma.figures import FIGURE_LAYOUTS
from pneuma.figures.collapse import collapsed_shares, draw_collapse
from pneuma.figures.curves import draw_study, settle
from pneuma.figures.environment import draw_level, draw_mailman, draw_screens
from pneuma.figures.index import INDEX, encode_index, index_entries
from pneuma.figures.robustness import draw_robustness, study_maps
from pneuma.figures.settings_table import settings_table
from pneuma.figures.summary import draw_summary, shown_outcome

COMMAND = "make figures"
RESULTS = Path("results")
TABLES = "tables"
OF_THE_THESIS = "fig-"
CONTRASTED = {
    "optimizer": ("stationary", "non-stationary"),
    "actor-size": ("smallest", "small"),
}
"""Conditions of the thesis's own figure, of studies that have more."""

MORE_CURVES = {"gradient-limits": ("grad_norm",)}
"""What else a study is about, beside the share killed and the return."""

COLOURS = 256
FEW = 4
"""Studies below which starting processes takes longer than they save."""

SETTINGS_STEM = "table-6-1-and-6-2"
TABLE_FORMATS = {"latex": ".tex", "markdown": ".md", "csv": ".csv"}


def draw_all(folder: Path, results: Path = RESULTS) -> list[Path]:
    """Draw every figure, write every table and the index; return the files written.

    What the index knew of and is not drawn any more is removed.

    Raises:
        UserError: when a published table is damaged.
    """
    (folder / TABLES).mkdir(parents=True, exist_ok=True)
    entries = [*_environment(folder), *_settings(folder)]
    studies = open_published(results)
    tell_figures_apart(studies)
    tasks = [(results, data.study, data.figure, folder) for data in studies]
    for drawn in _each(tasks):
        entries += drawn
    index = folder / INDEX
    gone = _indexed(index) - {entry["file"] for entry in entries}
    index.write_bytes(encode_index(entries))
    for name in gone:
        (folder / name).unlink(missing_ok=True)
    return [*(folder / entry["file"] for entry in entries), index]


def _indexed(index: Path) -> set[str]:
    """Return the files of an index, of which there may be none yet; all lie beside it or in its tables."""
    names = (entry["file"] for entry in json.loads(index.read_bytes())["figures"]) if index.exists() else ()
    return {name for name in names if name.removeprefix(f"{TABLES}/") == Path(name).name}


def _each(tasks: Sequence[tuple[Path, str, str, Path]]) -> Iterator[list[dict[str, Any]]]:
    """Draw every study; many at once on all cores, each in the same way as alone."""
    if len(tasks) < FEW:
        yield from starmap(_published, tasks)
        return
    with ProcessPoolExecutor(min(len(tasks), os.cpu_count() or 1), get_context("spawn")) as pool:
        try:
            yield from pool.map(_published, *zip(*tasks, strict=True))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _published(results: Path, study: str, figure: str, folder: Path) -> list[dict[str, Any]]:
    (data,) = open_published(results, [study])
    data.figure = figure
    return _study(data, folder)


def _environment(folder: Path) -> list[dict[str, Any]]:
    sources = {
        "pneuma/Mailman-v0": draw_mailman(folder),
        "pneuma/Pneuma-v0, level thesis": [*draw_screens(folder), *draw_level(folder)],
    }
    return [
        {"file": path.name, "command": COMMAND, "from": source, "runs": {}}
        for source, paths in sources.items()
        for path in sorted(paths)
    ]


def _settings(folder: Path) -> list[dict[str, Any]]:
    """Write the thesis's two tables of hyperparameters."""
    entries = []
    for form, suffix in TABLE_FORMATS.items():
        name = f"{TABLES}/{SETTINGS_STEM}{suffix}"
        (folder / name).write_bytes(encode_frame(settings_table(), form))
        entries.append({"file": name, "command": COMMAND, "from": "thesis Tables 6.1 and 6.2", "runs": {}})
    return entries


def _study(data: StudyData, folder: Path) -> list[dict[str, Any]]:
    entries = []
    for drawn, paths in _drawn(data, folder):
        for path in paths:
            _shrink(path)
        entries += index_entries(paths, COMMAND, data, drawn)
    summary = summary_table(data)
    tables = folder / TABLES
    for form, suffix in TABLE_FORMATS.items():
        path = tables / f"{data.study}{suffix}"
        path.write_bytes(encode_frame(summary, form))
        (entry,) = index_entries([path], COMMAND, data, {"table": "summary", "format": form})
        entries.append({**entry, "file": f"{TABLES}/{path.name}"})
    return entries


def _drawn(data: StudyData, folder: Path) -> Iterator[tuple[dict[str, Any], list[Path]]]:
    """Draw a study's figures; yield how each is drawn, and its files."""
    contrasted = [own for own in CONTRASTED.get(data.own_name, ()) if data.of_condition(own)]
    yield from _curves(data, contrasted or data.conditions, folder, data.figure)
    if contrasted:
        yield from _curves(data, data.conditions, folder, f"{data.figure}-all")
    for quantity in MORE_CURVES.get(data.own_name, ()):
        if quantity in data.quantities:
            drawn = {"figure": "curves", **asdict(settle(data, quantities=(quantity,)))}
            yield drawn, draw_study(data, folder, quantities=(quantity,))
    drawn = {"figure": "summary", "size": "page", "outcome": shown_outcome(data)}
    yield drawn, draw_summary(data, folder)
    if len(collapsed_shares(data)):
        yield {"figure": "collapses"}, draw_collapse(data, folder, f"{data.figure}-collapses")
    for found in study_maps(data):
        stem = f"{data.figure}-{found.setting.replace('_', '-')}"
        yield {"figure": "map", "contrast": found.setting}, draw_robustness(found, folder, stem)


def _curves(
    data: StudyData, conditions: Sequence[str], folder: Path, stem: str
) -> Iterator[tuple[dict[str, Any], list[Path]]]:
    """Draw curves of some conditions; as the thesis does too, where it has the figure."""
    if "return" not in data.quantities:
        return
    shown = data.of_conditions(conditions)
    shown.figure = stem
    as_in_thesis = stem.startswith(OF_THE_THESIS) and not stem.endswith("-all")
    for layout in FIGURE_LAYOUTS if as_in_thesis else FIGURE_LAYOUTS[:1]:
        drawn = {"figure": "curves", "conditions": list(conditions), **asdict(settle(shown, layout=layout))}
        yield drawn, draw_study(shown, folder, layout=layout)


def _shrink(path: Path) -> None:
    """Give a PNG a palette: figures have few colours, and take a third of the space."""
    if path.suffix != ".png":
        return
    with Image.open(path) as image:
        resolution = image.info["dpi"]
        small = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
    small.save(path, "PNG", optimize=True, dpi=resolution)


def main(folder: Path, results: Path = RESULTS) -> None:
    """Draw all and say so."""
    written = draw_all(folder, results)
    for path in written:
        print(f"wrote {path}")
    if {path.stem for path in written if path.parent.name == TABLES} <= {SETTINGS_STEM}:
        print(f"no study is published in {results / 'published'}: its figures and tables are still to come")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
