"""Collecting from Slurm: what jobs tell is handed on, and runs whose job went are seen to."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from pneuma.config import Run
from pneuma.errors import UserError
from pneuma.study.executors import slurm_queue
from pneuma.study.executors.base import TRIES, Event, OnEvent, read_event
from pneuma.study.executors.slurm_desk import Desk, alone
from pneuma.study.executors.slurm_queue import Job
from pneuma.study.executors.submissions import Submission, open_submissions
from pneuma.study.store import Status, Store, run_document

TAIL_SECONDS = 1.0
QUEUE_SECONDS = 5.0
"""How often events are read, and how often the queue is asked: every user's squeue costs the controller."""
MOST_REFUSALS = 12
"""How often, a look at the queue apart, runs that are to be tried again may be refused: for a minute."""
MOST_LOOKS = 5
"""How often the queue is asked, once all runs have ended, whether their jobs have gone."""


@dataclass
class _Followed:
    """A submission and, by group, how far its events were read, what was shown, how often it was refused."""

    submission: Submission
    read: dict[int, int] = field(default_factory=dict)
    shown: dict[int, str] = field(default_factory=dict)
    refused: Counter[int] = field(default_factory=Counter)
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
        self._newest: dict[str, str] = {}
        self._told_silence = False

    def work(self) -> None:
        """Collect; leaving by an exception loses nothing."""
        self._find_submissions()
        next_look = 0.0
        while self._waiting:
            self._read_events()
            if self._waiting and time.monotonic() >= next_look:
                self._look_at_queue()
                next_look = time.monotonic() + QUEUE_SECONDS
            if self._waiting:
                time.sleep(TAIL_SECONDS)
        self._close_finished()

    def _find_submissions(self) -> None:
        """Follow all submissions of runs that are waited for, those that other commands made among them."""
        self._followed = [each for each in self._followed if each.submission.folder.is_dir()]
        known = {each.submission.name for each in self._followed}
        for submission in open_submissions(self._store):
            if submission.name not in known and any(n in self._waiting for g in submission.groups for n in g):
                self._follow(submission)
        followed = {name for each in self._followed for group in each.submission.groups for name in group}
        for name in [name for name in self._waiting if name not in followed]:
            if not self._collect(name):
                text = "another command was done with its job; the same command goes on"
                end = {"event": "end", "run_id": name, "status": "killed", "step": 0, "trained": True}
                self._end({**end, "reason": text})

    def _follow(self, submission: Submission) -> None:
        """Follow a submission that is newer than those followed so far."""
        self._followed.append(_Followed(submission))
        self._newest |= {name: submission.name for group in submission.groups for name in group}

    def _look_at_queue(self) -> None:
        """See to jobs that have gone; a queue that cannot be asked now is asked later."""
        self._find_submissions()
        try:
            jobs = slurm_queue.jobs_of([each.submission for each in self._followed])
        except UserError as error:
            return self._tell_silence(error)
        for followed in list(self._followed):
            for i in range(len(followed.submission.groups)):
                if i not in followed.over:
                    self._see_to(followed, i, jobs.get((followed.submission.name, i)))
        return None

    def _tell_silence(self, error: UserError) -> None:
        """Say once why the queue cannot be asked."""
        if self._waiting and not self._told_silence:
            self._told_silence = True
            self._note(next(iter(self._waiting)), f"{error}; it is asked again every few seconds")

    def _see_to(self, followed: _Followed, group: int, job: Job | None) -> None:
        if job and not job.over:
            return self._tell_state(followed, group, job)
        followed.over.add(group)
        self._read_group(followed, group)  # what it told just before it went
        names = [name for name in followed.submission.groups[group] if name in self._waiting]
        lost = [name for name in names if not self._collect(name)]
        if lost:
            self._settle(followed, group, lost, job)
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

    def _settle(self, followed: _Followed, group: int, lost: Sequence[str], job: Job | None) -> None:
        """Try runs again whose job went without an end of theirs; or end them."""
        followed.failed = True
        what = f"job {job.id} is {job.state.lower()}" if job else "their job has gone from the queue"
        tries = followed.submission.tries + (not job or job.state != "PREEMPTED")
        if tries <= TRIES and not (job and job.state == "CANCELLED"):
            try:
                return self._try_again(followed, group, lost, tries, what)
            except UserError as error:  # what is refused now, by a busy controller say, may not be later
                followed.refused[group] += 1
                if followed.refused[group] < MOST_REFUSALS:
                    return followed.over.discard(group)
                what = f"{what}, and could not be submitted again ({error})"
        elif job is None and self._lives(followed, group):  # it was being submitted when the queue was asked
            return followed.over.discard(group)
        reason = f"{what}; what it printed lies in {followed.submission.jobs_folder}"
        for name in lost:
            self._save_end(name, reason)
            end = {"event": "end", "run_id": name, "status": "killed", "step": 0, "trained": True}
            self._end({**end, "reason": reason})
        return None

    def _try_again(self, followed: _Followed, group: int, lost: Sequence[str], tries: int, what: str) -> None:
        """Submit runs once more, but for those that another command has submitted meanwhile.

        Raises:
            UserError: when they are refused.
        """
        with alone(self._store):
            submissions = open_submissions(self._store)
            jobs = slurm_queue.jobs_of(submissions)
            live = slurm_queue.live_runs(submissions, jobs)
            again = [name for name in lost if name not in live]
            made = self._desk.submit([{name: self._waiting[name]} for name in again], tries)
        job = jobs.get((followed.submission.name, group))
        if job and not job.over:  # it was being submitted when the queue was asked
            followed.over.discard(group)
        for name in again:
            self._note(name, f"{what}; tried once more")
        for submission in made:
            self._follow(submission)

    def _lives(self, followed: _Followed, group: int) -> bool:
        """Ask the queue for a job once more, while nobody submits any."""
        with suppress(UserError), alone(self._store):
            job = slurm_queue.jobs_of([followed.submission]).get((followed.submission.name, group))
            return job is not None and not job.over
        return False

    def _note(self, name: str, text: str) -> None:
        self._on_event({"event": "note", "run_id": name, "text": text})

    def _save_end(self, name: str, reason: str) -> None:
        """Store that a run was killed, unless somebody trains it by now."""
        files = {"run.json": run_document(self._waiting[name], name), "error.txt": reason.encode()}
        with suppress(UserError, OSError), self._store.lock(name) as mine:
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
                if event := read_event(line):  # a job that was killed while it wrote leaves half a line
                    self._take(event, followed.submission)

    def _take(self, event: Event, told_by: Submission) -> None:
        """Hand on an event of a run that is waited for, unless it was submitted anew since."""
        name = event["run_id"]
        if name not in self._waiting or told_by.name != self._newest[name]:
            return
        if event["event"] != "end":
            self._on_event(event)
        elif event["status"] != "stopped":  # the job goes back to the queue, or is over: the queue tells
            self._end(event)

    def _end(self, event: Event) -> None:
        del self._waiting[event["run_id"]]
        self._on_event(event)

    def _close_finished(self) -> None:
        """Be done with submissions whose jobs have all gone, the last of them within moments."""
        for _ in range(MOST_LOOKS):
            self._look_at_queue()
            open_ones = [each for each in self._followed if len(each.over) < len(each.submission.groups)]
            for followed in self._followed:
                if followed not in open_ones:
                    followed.submission.close(keep=followed.failed)
            self._followed = open_ones
            if not open_ones:
                return
            time.sleep(TAIL_SECONDS)
