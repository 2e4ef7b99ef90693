"""A queue in Slurm's place, given by hand: what it runs, the states of its jobs, what was told of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest

from pneuma.config import Run, make_run
from pneuma.errors import UserError
from pneuma.study.executors import slurm, slurm_collector, slurm_queue
from pneuma.study.executors.base import Event, Place, Supervision
from pneuma.study.executors.slurm_job import Training
from pneuma.study.executors.slurm_queue import Job
from pneuma.study.executors.submissions import Submission
from pneuma.study.identity import run_id
from pneuma.study.store import Store

submitit = pytest.importorskip("submitit")

SETTINGS = {
    "env": "pneuma/Mailman-v0",
    "engine": "tabular",
    "algorithm": "q-learning",
    "steps": 500,
    "horizon": 10,
}
HOW = Supervision(2, place=Place("slurm"))


def group(*seeds: int) -> dict[str, Run]:
    runs = [make_run({**SETTINGS, "learning_rate": 0.5, "seed": seed}) for seed in seeds]
    return {run_id(run): run for run in runs}


class Queue:
    """A queue in Slurm's place, whose jobs a test says the state of, or submitit's local executor runs."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, states: Sequence[str | None] = ()) -> None:
        self.states = states
        self.submitted: list[tuple[Submission, Sequence[Mapping[str, Any]]]] = []
        self.jobs: dict[tuple[str, int], Any] = {}
        monkeypatch.setattr(slurm_queue, "submit", self.submit)
        monkeypatch.setattr(slurm_queue, "jobs_of", self.jobs_of)
        monkeypatch.setattr(slurm_collector, "TAIL_SECONDS", 0.05)
        monkeypatch.setattr(slurm_collector, "QUEUE_SECONDS", 0.1)

    def submit(self, submission: Submission, works: Sequence[Mapping[str, Any]], *_: object) -> None:
        self.submitted.append((submission, works))
        if not self.states:
            executor = submitit.LocalExecutor(submission.jobs_folder)
            executor.update_parameters(timeout_min=2)
            for i, job in enumerate(executor.submit_array([Training(work) for work in works])):
                self.jobs[submission.name, i] = job

    def jobs_of(self, submissions: Sequence[Submission]) -> dict[tuple[str, int], Job]:
        found = {}
        for submission in submissions:
            for i in range(len(submission.groups)):
                state = self._state(submission, i)
                if state:
                    found[submission.name, i] = Job(f"7_{i}", state)
        return found

    def _state(self, submission: Submission, i: int) -> str | None:
        if self.states:
            place = [own.name for own, _ in self.submitted].index(submission.name)
            return self.states[min(place, len(self.states) - 1)]
        return "COMPLETED" if self.jobs[submission.name, i].done() else "RUNNING"


def collect(groups: Sequence[Mapping[str, Run]], store: Store, how: Supervision = HOW) -> list[Event]:
    events: list[Event] = []
    slurm.run_groups(groups, store, how, events.append)
    return events


def ends(events: Sequence[Event]) -> dict[str, str]:
    return {event["run_id"]: event["status"] for event in events if event["event"] == "end"}


def notes(events: Sequence[Event]) -> list[str]:
    return [event["text"] for event in events if event["event"] == "note"]


def answer_in_turn(queue: Queue, monkeypatch: pytest.MonkeyPatch, *answers: Callable[[], str | None]) -> None:
    """Let the queue say the state of the jobs of the first submission by one answer after another.

    The first is for who submits, the next for who collects; the last is for all that ask later.
    """
    left = list(answers)

    def jobs_of(submissions: Sequence[Submission]) -> dict[tuple[str, int], Job]:
        if not submissions:
            return {}
        state = (left.pop(0) if len(left) > 1 else left[0])()
        names = [submission.name for submission, _ in queue.submitted]
        states = [state, *["RUNNING"] * (len(names) - 1)]
        return {
            (name, 0): Job(f"{i}_0", told)
            for i, (name, told) in enumerate(zip(names, states, strict=True))
            if told
        }

    monkeypatch.setattr(slurm_queue, "jobs_of", jobs_of)


def no_answer() -> str | None:
    raise UserError("squeue: Slurm's controller does not answer")
