"""What was submitted to a cluster's queue and not collected yet: a folder of notes beside the results.

    RESULTS-slurm/TOKEN/submission.json   which groups of runs were submitted under that name
                        events-I.jsonl    what the job of group I tells while it trains
                        jobs/             submitit's own files: pickled jobs, and what they printed

It lies beside the results folder, on the same shared disk, and never in it: results hold nothing pickled.
"""

from __future__ import annotations

import json
import shutil
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pneuma.study.files import SCHEMA, replace_file, to_json
from pneuma.study.store import Store

OPEN, CLOSED = "submission.json", "ended.json"


@dataclass(frozen=True)
class Submission:
    """Groups of runs that were submitted together; each is a job.

    Attributes:
        folder: of its notes; its name tells it apart from all others.
        groups: the ids of the runs of each job.
        tries: which go at these runs it is.
    """

    folder: Path
    groups: tuple[tuple[str, ...], ...]
    tries: int = 1

    @property
    def name(self) -> str:
        """What its jobs are called in the queue."""
        return f"pneuma-{self.folder.name}"

    @property
    def jobs_folder(self) -> Path:
        """Where submitit keeps its files."""
        return self.folder / "jobs"

    def events_path(self, group: int) -> Path:
        """Return where the job of a group tells what happens."""
        return self.folder / f"events-{group}.jsonl"

    def close(self, keep: bool) -> None:
        """Be done with it; `keep` what jobs printed, for a person to read."""
        if keep:
            with suppress(OSError):
                (self.folder / OPEN).rename(self.folder / CLOSED)
        else:
            shutil.rmtree(self.folder, ignore_errors=True)


def submissions_folder(store: Store) -> Path:
    """Return the folder of all submissions of a results folder."""
    root = store.root.resolve()
    return root.parent / f"{root.name}-slurm"


def new_submission(store: Store, groups: Sequence[Sequence[str]], tries: int) -> Submission:
    """Note groups before they are submitted, so that no death in between hides a job."""
    token = f"{time.strftime('%Y%m%d-%H%M%S')}-{uuid.uuid4().hex[:6]}"
    submission = Submission(submissions_folder(store) / token, tuple(map(tuple, groups)), tries)
    submission.jobs_folder.mkdir(parents=True)
    note = {"schema": SCHEMA, "tries": tries, "groups": [list(group) for group in groups]}
    replace_file(submission.folder / OPEN, to_json(note))
    return submission


def open_submissions(store: Store) -> list[Submission]:
    """Return the submissions that were not collected yet, the oldest first."""
    found = []
    for path in sorted(submissions_folder(store).glob(f"*/{OPEN}")):
        with suppress(OSError, ValueError, KeyError, TypeError):
            note = json.loads(path.read_bytes())
            found.append(Submission(path.parent, tuple(map(tuple, note["groups"])), int(note["tries"])))
    return found
