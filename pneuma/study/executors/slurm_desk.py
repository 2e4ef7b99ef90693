"""Submitting to Slurm: groups of runs become arrays of jobs, none of them twice."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from tempfile import TemporaryFile

from pneuma.config import Run, as_settings
from pneuma.errors import UserError
from pneuma.study.executors import slurm_queue
from pneuma.study.executors.base import Supervision
from pneuma.study.executors.submissions import (
    Submission,
    new_submission,
    open_submissions,
    submissions_folder,
)
from pneuma.study.locks import RunLock
from pneuma.study.store import Store

MOST_IN_ARRAY = 1000
"""Slurm's usual MaxArraySize is 1001."""
LOCK_SECONDS = 60.0

Group = Mapping[str, Run]


@contextmanager
def alone(store: Store) -> Iterator[None]:
    """Let no other command submit meanwhile.

    Raises:
        UserError: where notes cannot be written, or when another one submits for very long.
    """
    folder = submissions_folder(store)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise UserError(
            f"{folder}: cannot be written ({error.strerror}); what is submitted is noted there"
        ) from None
    until = time.monotonic() + LOCK_SECONDS
    while True:
        with RunLock(folder) as mine:
            if mine:
                yield
                return
        if time.monotonic() > until:
            raise UserError(f"{folder}: another command is submitting there; try again later")
        time.sleep(0.2)


class Desk:
    """Submits groups of runs, and knows the jobs of all that was submitted."""

    def __init__(self, store: Store, supervision: Supervision) -> None:
        self._store = store
        self._how = supervision
        self._options = dict(supervision.place.slurm)

    def under_way(self) -> set[str]:
        """Return the runs of jobs that are queued or running; be done with submissions that have none."""
        submissions = open_submissions(self._store)
        live = {*slurm_queue.jobs_by_run(submissions)}
        for submission in submissions:
            if not any(name in live for group in submission.groups for name in group):
                submission.close(keep=not all(map(self._finished, submission.groups)))
        return live

    def _finished(self, names: Iterable[str]) -> bool:
        return all(self._store.status(name).finished for name in names)

    def submit(self, groups: Sequence[Group], tries: int) -> list[Submission]:
        """Submit groups as arrays of jobs, those that want a GPU by themselves.

        Raises:
            UserError: when one is refused; those that were taken before it are taken back.
        """
        made: list[Submission] = []
        for gpu in (False, True):
            alike = [group for group in groups if (next(iter(group)) in self._how.on_gpu) == gpu]
            for first in range(0, len(alike), MOST_IN_ARRAY):
                try:
                    made.append(self._submit_array(alike[first : first + MOST_IN_ARRAY], tries, gpu))
                except UserError:
                    for submission in made:
                        with suppress(UserError):  # it is the refusal that a person must know of
                            slurm_queue.take_back(submission)
                    raise
        return made

    def _submit_array(self, groups: Sequence[Group], tries: int, gpu: bool) -> Submission:
        submission = new_submission(self._store, [list(group) for group in groups], tries)
        works = [
            {
                "results": str(self._store.root.resolve()),
                "events": str(submission.events_path(i)),
                "runs": {name: as_settings(run) for name, run in group.items()},
                "checkpoint_seconds": self._how.checkpoint_seconds,
                "timeout_seconds": self._how.timeout_seconds,
                "keep_checkpoints": self._how.keep_checkpoints,
                "gpu": gpu or slurm_queue.ask_for_gpu(self._options),
            }
            for i, group in enumerate(groups)
        ]
        slurm_queue.submit(submission, works, self._options, self._how.workers, gpu)
        slurm_queue.refuse_hopeless(submission)
        return submission

    def farewell(self, runs: Mapping[str, Run]) -> str:
        """Say what goes on when the command is left."""
        own = [s for s in open_submissions(self._store) if any(n in runs for g in s.groups for n in g)]
        count = sum(not self._finished(group) for submission in own for group in submission.groups)
        names = ",".join(submission.name for submission in own)
        jobs = "1 job" if count == 1 else f"{count} jobs"
        return (
            f"Left. {jobs} in Slurm's queue go on without this command: `pneuma study status` shows "
            f"them, the same command collects what they leave, `scancel --name={names}` stops them."
        )
