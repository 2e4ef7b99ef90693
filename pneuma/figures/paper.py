"""Everything in `paper_figures/`: `make figures` runs this, and nothing else writes there.

    python -m pneuma.figures.paper FOLDER [--results RESULTS]

The environment's own figures, the thesis's tables of hyperparameters, and what `plates` draws of every
published study in RESULTS/published. Beside them an index: which command drew each, from which runs; and
the same for people.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import starmap
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from pneuma.analysis.export import encode_frame
from pneuma.analysis.run_index import open_published
from pneuma.analysis.tables import tell_figures_apart
from pneuma.analysis.trajectories import read_trajectories
from pneuma.errors import UserError
from pneuma.figures.environment import draw_level, draw_mailman, draw_screens
from pneuma.figures.index import CONTENTS, INDEX, encode_contents, encode_index, read_entries
from pneuma.figures.plates import BESIDE, COMMAND, TABLE_FORMATS, TABLES, draw_published
from pneuma.figures.settings_table import settings_table
from pneuma.study.files import write_whole
from pneuma.study.provenance import available_cores

RESULTS = Path("results")
FEW = 4
"""Studies below which starting processes takes longer than they save."""
SETTINGS_STEM = "table-6-1-and-6-2"

Task = tuple[Path, str, str, str | None, Path]
"""Of one study: the results folder, its name and its figures', the logs to draw beside it, and where to."""


def draw_all(folder: Path, results: Path = RESULTS) -> list[Path]:
    """Draw every figure, write every table, the index and its page; return the files written.

    What the index knew of and is not drawn any more is removed.

    Raises:
        UserError: when a published table, or the index that is there, is damaged.
    """
    (folder / TABLES).mkdir(parents=True, exist_ok=True)
    read_entries(folder)  # so that a damaged one is told before all is drawn
    entries = [*_draw_environment(folder), *_write_settings(folder)]
    studies = open_published(results)
    tell_figures_apart(studies)
    known = {data.study for data in studies}
    logs = {study: name for study, name in BESIDE.items() if name in known}
    tasks = [(results, data.study, data.figure, logs.get(data.study), folder) for data in studies]
    for drawn in _draw_studies(tasks):
        entries += drawn
    gone = _indexed(folder) - {entry["file"] for entry in entries}
    write_whole(folder / INDEX, encode_index(entries))
    write_whole(folder / CONTENTS, encode_contents(entries))
    for name in gone:
        (folder / name).unlink(missing_ok=True)
    return [*(folder / entry["file"] for entry in entries), folder / INDEX, folder / CONTENTS]


def _indexed(folder: Path) -> set[str]:
    """Return the files of a folder's index, if it has one; all lie beside it or in its tables."""
    names = (entry["file"] for entry in read_entries(folder))
    return {name for name in names if name.removeprefix(f"{TABLES}/") == Path(name).name}


def _draw_studies(tasks: Sequence[Task]) -> Iterator[list[dict[str, Any]]]:
    """Draw every study; many at once on all cores, each in the same way as alone."""
    if len(tasks) < FEW:
        yield from starmap(_draw_one, tasks)
        return
    with ProcessPoolExecutor(min(len(tasks), available_cores()), get_context("spawn")) as pool:
        try:
            yield from pool.map(_draw_one, *zip(*tasks, strict=True))
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _draw_one(
    results: Path, study: str, figure: str, beside: str | None, folder: Path
) -> list[dict[str, Any]]:
    """Draw a study, under the name that its figures have among all that are drawn."""
    (data,) = open_published(results, [study])
    data.figure = figure
    logs = open_published(results, [beside])[0] if beside else None
    return draw_published(data, folder, read_trajectories(results, study), logs)


def _draw_environment(folder: Path) -> list[dict[str, Any]]:
    """Draw what the thesis shows of the environment itself, which has more colours than a palette."""
    sources = {
        "pneuma/Mailman-v0": draw_mailman(folder),
        "pneuma/Pneuma-v0, level thesis": [*draw_screens(folder), *draw_level(folder)],
    }
    return [
        {"file": path.name, "command": COMMAND, "from": source, "runs": {}}
        for source, paths in sources.items()
        for path in sorted(paths)
    ]


def _write_settings(folder: Path) -> list[dict[str, Any]]:
    """Write the thesis's two tables of hyperparameters."""
    entries = []
    for form, suffix in TABLE_FORMATS.items():
        name = f"{TABLES}/{SETTINGS_STEM}{suffix}"
        (folder / name).write_bytes(encode_frame(settings_table(), form))
        entries.append({"file": name, "command": COMMAND, "from": "thesis Tables 6.1 and 6.2", "runs": {}})
    return entries


def main(folder: Path, results: Path = RESULTS) -> None:
    """Draw all and say so.

    Raises:
        UserError: where there is no results folder: what was drawn of another would be removed.
    """
    if not results.is_dir():
        raise UserError(f"{results}: is no folder, so nothing is drawn, and nothing removed")
    written = draw_all(folder, results)
    for path in written:
        print(f"wrote {path}")
    if {path.stem for path in written if path.parent.name == TABLES} <= {SETTINGS_STEM}:
        mend = "run `make reproduction`, then `make reproduction DO=publish`"
        print(f"no study is published in {results / 'published'} yet: {mend}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--results", type=Path, default=RESULTS)
    try:
        main(**vars(parser.parse_args()))
    except (UserError, OSError) as error:
        print(f"pneuma: {error}", file=sys.stderr)
        sys.exit(2)
