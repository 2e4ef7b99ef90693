"""The Slurm executor: groups of runs are jobs of the university's queue, on a results folder that all share.

plan → groups → arrays of jobs (`slurm_queue.py`) → each trains its group on a node (`slurm_job.py`)

The command only submits and collects. It can be left at any moment, and jobs go on; the same command finds
them by their names, submits none twice, and hands on what they tell.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from pneuma.config import Run, as_settings
from pneuma.errors import UserError
from pneuma.study.executors import slurm_queue
from pneuma.study.executors.base import TRIES, Detached, Event, OnEvent, Place, Supervision
from pneuma.study.executors.slurm_queue import Job
from pneuma.study.executors.submissions import (
    Submission,
    new_submission,
    open_submissions,
    submissions_folder,
)
from pneuma.study.locks import RunLock
from pneuma.study.store import Status, Store, run_document

MOST_AT_ONCE = 256
MOST_IN_ARRAY = 1000
"""Slurm's usual MaxArraySize is 1001."""
TAIL_SECONDS = 1.0
QUEUE_SECONDS = 5.0
"""How often events are read, and how often the queue is asked: every user's squeue costs the controller."""
LOCK_SECONDS = 60.0

Group = Mapping[str, Run]


def most_workers(place: Place) -> int:
    """Return how many jobs run at once where nobody says it: one a core of the partition."""
    slurm_queue.check_programs()
    return min(MOST_AT_ONCE, slurm_queue.total_cores(dict(place.slurm)))


def check(runs: Mapping[str, Run], supervision: Supervision) -> None:
    """Ask sbatch whether it would take the jobs of these runs."""
    slurm_queue.check_programs()
    for gpu in sorted({name in supervision.on_gpu for name in runs}):
        with TemporaryDirectory() as folder:
            slurm_queue.check_submission(Path(folder), dict(supervision.place.slurm), gpu)


def run_groups(groups: Iterable[Group], store: Store, supervision: Supervision, on_event: OnEvent) -> None:
    """Train every group of runs in a job of its own, as the contract says (`base.Executor`).

    Raises:
        Detached: when the command is to be left, or after Ctrl-C; jobs go on.
        UserError: when jobs are refused.
    """
    wanted = list(groups)
    runs = {name: run for group in wanted for name, run in group.items()}
    desk = Desk(store, supervision)
    collector = Collector(store, desk, runs, on_event)
    try:
        with alone(store):
            under_way = desk.under_way()
            fresh = [{name: run for name, run in own.items() if name not in under_way} for own in wanted]
            desk.submit([group for group in fresh if group], 1)
        if not supervision.place.detach:
            return collector.work()
    except KeyboardInterrupt:
        pass
    raise Detached(desk.farewell(runs))


@contextmanager
def alone(store: Store) -> Iterator[None]:
    """Let no other command submit meanwhile.

    Raises:
        UserError: when another one does for very long.
    """
    folder = submissions_folder(store)
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
                submission.close(keep=not self._all_finished(submission))
        return live

    def _all_finished(self, submission: Submission) -> bool:
        names = (name for group in submission.groups for name in group)
        return all(self._store.status(name).finished for name in names)

    def submit(self, groups: Sequence[Group], tries: int) -> list[Submission]:
        """Submit groups as arrays of jobs, those that want a GPU by themselves.

        Raises:
            UserError: when they are refused.
        """
        made = []
        for gpu in (False, True):
            alike = [group for group in groups if (next(iter(group)) in self._how.on_gpu) == gpu]
            for first in range(0, len(alike), MOST_IN_ARRAY):
                made.append(self._submit_array(alike[first : first + MOST_IN_ARRAY], tries, gpu))
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
            }
            for i, group in enumerate(groups)
        ]
        slurm_queue.submit(submission, works, self._options, self._how.workers, gpu)
        slurm_queue.refuse_hopeless(submission)
        return submission

    def farewell(self, runs: Mapping[str, Run]) -> str:
        """Say what goes on when the command is left."""
        own = [s for s in open_submissions(self._store) if any(n in runs for g in s.groups for n in g)]
        count = sum(len(submission.groups) for submission in own)
        names = ",".join(submission.name for submission in own)
        jobs = "1 job" if count == 1 else f"{count} jobs"
        return (
            f"Left. {jobs} in Slurm's queue go on without this command: `pneuma study status` shows "
            f"them, the same command collects what they leave, `scancel --name={names}` stops them."
        )


@dataclass
class _Followed:
    """A submission and how far the events of each of its groups were read."""

    submission: Submission
    read: dict[int, int] = field(default_factory=dict)
    shown: dict[int, str] = field(default_factory=dict)
    over: set[int] = field(default_factory=set)
    failed: bool = False


class Collector:
    """Hands on what jobs tell until every run that is waited for has ended."""

    def __init__(self, store: Store, desk: Desk, runs: Mapping[str, Run], on_event: OnEvent) -> None:
        self._store = store
        self._desk = desk
        self._waiting = dict(runs)
        self._on_event = on_event
        self._followed: list[_Followed] = []

    def work(self) -> None:
        """Collect; leaving by an exception loses nothing."""
        self._followed = [_Followed(submission) for submission in open_submissions(self._store)]
        next_look = 0.0
        while self._waiting:
            self._read_events()
            if self._waiting and time.monotonic() >= next_look:
                self._look_at_queue()
                next_look = time.monotonic() + QUEUE_SECONDS
            if self._waiting:
                time.sleep(TAIL_SECONDS)
        self._look_at_queue()
        self._close_finished()

    def _look_at_queue(self) -> None:
        """See to jobs that have gone; a queue that cannot be asked now is asked later."""
        with suppress(UserError):
            self._followed = [each for each in self._followed if each.submission.folder.is_dir()]
            jobs = slurm_queue.jobs_of([each.submission for each in self._followed])
            for followed in list(self._followed):
                for i in range(len(followed.submission.groups)):
                    if i not in followed.over:
                        self._see_to(followed, i, jobs.get((followed.submission.name, i)))

    def _see_to(self, followed: _Followed, group: int, job: Job | None) -> None:
        if job and not job.over:
            return self._tell_state(followed, group, job)
        followed.over.add(group)
        self._read_group(followed, group)  # what it told just before it went
        names = [name for name in followed.submission.groups[group] if name in self._waiting]
        lost = [name for name in names if not self._collect(name)]
        if lost:
            self._settle(followed, lost, job)
        return None

    def _tell_state(self, followed: _Followed, group: int, job: Job) -> None:
        """Tell, to who watches, that a job's state changed."""
        names = [name for name in followed.submission.groups[group] if name in self._waiting]
        if names and followed.shown.get(group) != job.state:
            followed.shown[group] = job.state
            text = f"job {job.id} is {job.state.lower()} {job.where}".rstrip()
            self._on_event({"event": "passing", "run_id": names[0], "text": text})

    def _collect(self, name: str) -> bool:
        """End a run that lies in the store though nobody told of it; return whether it does."""
        status = self._store.status(name)
        if status.finished:
            self._end(
                {"event": "end", "run_id": name, "status": status.name, "step": status.step, "trained": True}
            )
        return status.finished

    def _settle(self, followed: _Followed, lost: Sequence[str], job: Job | None) -> None:
        """Try runs again whose job went without an end of theirs; or end them."""
        followed.failed = True
        what = f"job {job.id} is {job.state.lower()}" if job else "their job has gone from the queue"
        tries = followed.submission.tries + (not job or job.state != "PREEMPTED")
        if tries <= TRIES and not (job and job.state == "CANCELLED"):
            for name in lost:
                self._on_event({"event": "note", "run_id": name, "text": f"{what}; tried once more"})
            with alone(self._store):
                again = self._desk.submit([{name: self._waiting[name]} for name in lost], tries)
            self._followed += [_Followed(submission) for submission in again]
            return
        reason = f"{what}; what it printed lies in {followed.submission.jobs_folder}"
        for name in lost:
            self._save_end(name, reason)
            end = {"event": "end", "run_id": name, "status": "killed", "step": 0, "trained": True}
            self._end({**end, "reason": reason})

    def _save_end(self, name: str, reason: str) -> None:
        """Store that a run was killed, unless somebody trains it by now."""
        files = {"run.json": run_document(self._waiting[name], name), "error.txt": reason.encode()}
        with suppress(UserError, OSError), RunLock(self._store.run_folder(name)) as mine:
            if mine:
                self._store.save_run(name, Status("killed"), files)

    # --- Events ------------------------------------------------------------------------------------

    def _read_events(self) -> None:
        for followed in self._followed:
            for i, names in enumerate(followed.submission.groups):
                if any(name in self._waiting for name in names):
                    self._read_group(followed, i)

    def _read_group(self, followed: _Followed, group: int) -> None:
        """Hand on the whole lines that a job has written since the last look."""
        with suppress(OSError), followed.submission.events_path(group).open("rb") as file:
            file.seek(followed.read.get(group, 0))
            whole, newline, _ = file.read().rpartition(b"\n")
            followed.read[group] = followed.read.get(group, 0) + len(whole + newline)
            for line in whole.splitlines():
                self._take(json.loads(line))

    def _take(self, event: Event) -> None:
        if event["run_id"] not in self._waiting:
            return
        if event["event"] != "end":
            self._on_event(event)
        elif event["status"] != "stopped":  # the job goes back to the queue, or is over: the queue tells
            self._end(event)

    def _end(self, event: Event) -> None:
        del self._waiting[event["run_id"]]
        self._on_event(event)

    def _close_finished(self) -> None:
        """Be done with submissions whose jobs have all gone; the others are seen to by the next command."""
        for followed in self._followed:
            if len(followed.over) == len(followed.submission.groups):
                followed.submission.close(keep=followed.failed)
