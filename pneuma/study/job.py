"""A job: groups of runs in a file of JSON, of which a worker trains one, on this machine or another.

    python -m pneuma.study.worker JOB.json INDEX

    {"results": "…", "how": {…}, "groups": [{"RUN_ID": {FIELDS}, …}, …]}

Executors write it, and read their own alone.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pneuma.config import Run, as_fields, make_run
from pneuma.files import create_whole
from pneuma.study.executors.base import ExecutorConfig
from pneuma.study.store import Store


@dataclass(frozen=True)
class JobFile:
    """A job as it is read; `groups` have the fields of runs, by their ids."""

    path: Path
    store: Store
    how: ExecutorConfig
    groups: Sequence[Mapping[str, Mapping[str, Any]]]

    def runs(self, index: int) -> dict[str, Run]:
        """Return the runs of a group, by id."""
        return {name: make_run(fields) for name, fields in self.groups[index].items()}


def write_job(path: Path, groups: Sequence[Mapping[str, Run]], store: Store, how: ExecutorConfig) -> JobFile:
    fields = [{name: as_fields(run) for name, run in group.items()} for group in groups]
    document = {"results": str(store.root.resolve()), "how": asdict(how), "groups": fields}
    path.parent.mkdir(parents=True, exist_ok=True)
    create_whole(path, json.dumps(document).encode())
    return JobFile(path, store, how, fields)


def read_job(path: Path) -> JobFile:
    document = json.loads(path.read_bytes())
    how = document["how"] | {"slurm": tuple(map(tuple, document["how"]["slurm"]))}
    return JobFile(path, Store(document["results"]), ExecutorConfig(**how), document["groups"])
