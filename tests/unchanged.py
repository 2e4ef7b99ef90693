"""What a rewrite must not move, as checksums: `python -m tests.unchanged` compares, `--record` writes them.

The ids of the configuration and of a run of every condition of every shipped study in each world, also with
one slot where the file says four; the rows of published tables; the tables that `study export` makes of each
study's preset `paper`; the verdicts of `study verify`. Nothing is trained, as the last bits of a training
depend on the processor. Golden traces of rules and engines are tests of their own.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pyarrow as pa

from pneuma.analysis.export import encode_frame, export_records
from pneuma.analysis.runs import open_study
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Query, configure
from pneuma.study.shipped import list_studies
from pneuma.study.spec import Study, load_study

from .cli.calls import described

RECORD = Path(__file__).with_name("unchanged.json")
TABLES = ("evaluations", "curves", "summary")
CONTRAST = (
    "outcome", "a", "b", "effect", "low", "high", "simultaneous_low", "simultaneous_high", "seeds_a",
    "seeds_b", "verdict", "reason",
)  # fmt: skip
"""What a verdict comes from, of each of its contrasts."""
PUBLISHED = Path(__file__).parents[1] / "results" / "published"
NOWHERE = Path(__file__).with_name("no-results")
"""A results folder that does not exist: only published tables are read."""


def compare() -> int:
    """Compare with the record, or write it; return 1 where anything differs."""
    current = {"run ids": _run_ids(), "rows": _rows(), "tables": _tables(), "verdicts": _verdicts()}
    if "--record" in sys.argv:
        RECORD.write_text(json.dumps(current, indent=1) + "\n")
        return 0
    changes = []
    for kind, recorded in json.loads(RECORD.read_text()).items():
        for name in recorded | current[kind]:
            if recorded.get(name) != current[kind].get(name):
                changes.append(f"{kind}: {name}")
    print("\n".join(changes) or "unchanged")
    return 1 if changes else 0


def _run_ids() -> dict[str, str]:
    ids = {}
    for name in list_studies():
        for world in load_study(name).worlds:
            study = load_study(name, world)
            for suffix, settings in _with_slots(study):
                runs = configure(study, settings).runs
                ids_by_condition = {name: [config_id(run), run_id(run)] for name, run in sorted(runs.items())}
                ids[f"{name} {world}{suffix}"] = _digest(json.dumps(ids_by_condition))
    return dict(sorted(ids.items()))


def _with_slots(study: Study) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the study as it is, and with one slot where its own file, not the world, says four."""
    yield "", {}
    if study.run.get("slots") == 4 and study.world != "godot":
        yield " slots=1", {"slots": 1}


def _rows() -> dict[str, str]:
    """Digest the rows of the published tables."""
    digests = {}
    for name, table in RunIndex(Store(NOWHERE)).tables.items():
        rows = pa.concat_tables([row.table for row in table.rows().values()], promote_options="permissive")
        digests[name] = _digest(rows.to_pandas().to_csv(index=False))
    return digests


def _tables() -> dict[str, str]:
    """Digest the tables that are exported from the published preset of each study."""
    digests, store = {}, Store(NOWHERE)
    index = RunIndex(store)
    for name, published in index.tables.items():
        about = published.about
        query = Query(study=about["study"], world=about["world"], settings=about["settings"])
        try:
            data = open_study(index, query)
        except UserError:  # runs of earlier settings, which are in no preset
            continue
        for table in TABLES:
            try:
                encoded = encode_frame(export_records(data, table, store).table, "csv")
                digests[f"{name} {table}"] = _digest(encoded.decode())
            except UserError:
                digests[f"{name} {table}"] = "refused"
    return digests


def _verdicts() -> dict[str, str]:
    """Return each verdict on the published tables, and a digest of the numbers that it comes from."""
    with TemporaryDirectory() as folder:
        shutil.copytree(PUBLISHED, Path(folder) / "published")
        document = described("study", "verify", "--json", "--results", folder)
    verdicts = {}
    for verdict in document["claims"]:
        tested = [row for row in verdict["contrasts"] if row["effect"] is not None]
        numbers = [[row[key] for key in CONTRAST] for row in tested]
        words = f"{verdict['verdict']} {_digest(json.dumps(numbers))}"
        verdicts[f"{verdict['claim']} {verdict['world']}"] = words
    return verdicts


def _digest(text: str) -> str:
    """Return a checksum of a text, its numbers to nine digits: the last ones depend on the processor."""
    coarse = re.sub(r"-?\d+\.\d+(e[+-]?\d+)?", lambda number: f"{float(number[0]):.9g}", text)
    return hashlib.sha256(coarse.encode()).hexdigest()[:16]


if __name__ == "__main__":
    sys.exit(compare())
