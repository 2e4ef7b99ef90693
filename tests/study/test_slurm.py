"""The Slurm executor without a Slurm: jobs of submitit's local executor, and a queue given by hand."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.errors import UserError
from pneuma.study.execute import execute
from pneuma.study.executors import local, slurm, slurm_collector, slurm_job, slurm_queue
from pneuma.study.executors.base import Detached, Place, Supervision
from pneuma.study.executors.slurm_desk import alone
from pneuma.study.executors.slurm_job import Teller
from pneuma.study.executors.slurm_queue import Job
from pneuma.study.executors.submissions import (
    Submission,
    new_submission,
    open_submissions,
    submissions_folder,
)
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store

from .hand_queue import HOW, Queue, answer_in_turn, collect, ends, group, no_answer, notes


@pytest.fixture
def store(tmp_path: Path) -> Store:
    store = Store(tmp_path / "results")
    store.check_writable()
    return store


# --- Jobs of submitit's local executor -----------------------------------------------------------


@pytest.mark.slow
def test_jobs_leave_what_local_leaves_and_no_pickle_in_the_results(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch)
    groups = [group(0, 1), group(2)]
    with pytest.raises(Detached, match="2 jobs in Slurm's queue go on"):
        collect(groups, store, replace(HOW, place=Place("slurm", detach=True)))
    assert len(list(submissions_folder(store).rglob("*_submitted.pkl"))) == 2
    assert ends(collect(groups, store)) == dict.fromkeys({**groups[0], **groups[1]}, "done")
    assert len(queue.submitted) == 1  # the second command found the jobs of the first
    for job in queue.jobs.values():
        job.wait()

    beside = Store(tmp_path / "beside")
    local.run_groups(groups, beside, HOW, lambda event: None)
    for name in store.runs():
        files = [file for file in store.file_names(name) if file != "provenance.json"]
        assert all(store.read_file(name, file) == beside.read_file(name, file) for file in files)
    assert store.runs() == beside.runs()
    assert not list(store.root.rglob("*.pkl"))


# --- A queue given by hand -----------------------------------------------------------------------


def test_a_run_whose_job_dies_twice_is_killed_and_says_where_to_look(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["NODE_FAIL", "OUT_OF_MEMORY"])
    (name,) = group(3)
    events = collect([group(3)], store)
    assert [event["text"] for event in events if event["event"] == "note"] == [
        "job 7_0 is node_fail; tried once more"
    ]
    assert ends(events) == {name: "killed"}
    assert len(queue.submitted) == 2
    assert b"out_of_memory" in store.read_file(name, "error.txt")
    assert not open_submissions(store)


@pytest.mark.parametrize(
    ("states", "goes"), [(["CANCELLED"], 1), (["PREEMPTED", "PREEMPTED", "CANCELLED"], 3)]
)
def test_a_cancelled_job_is_not_tried_again_and_a_preempted_one_always(
    states: list[str], goes: int, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, states)
    assert set(ends(collect([group(4)], store)).values()) == {"killed"}
    assert len(queue.submitted) == goes


def test_what_a_job_told_is_handed_on_and_a_run_that_lies_there_needs_no_word(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first run's end is told, the line after it is not whole; the second lies in the store."""
    runs = group(5, 6)
    first, second = runs
    submission = new_submission(store, [list(runs)], 1)
    told = [
        {"event": "note", "run_id": first, "text": "goes on from step 10"},
        {"event": "end", "run_id": first, "status": "stopped", "step": 20, "trained": True},
        {"event": "end", "run_id": first, "status": "diverged", "step": 30, "trained": True},
    ]
    lines = "".join(json.dumps(event) + "\n" for event in told)
    submission.events_path(0).write_text(lines + '{"event": "e')
    store.save_run(second, Status("done", 500), {"run.json": b"{}"})
    queue = Queue(monkeypatch, ["COMPLETED"])
    queue.submitted.append((submission, []))
    monkeypatch.setattr(slurm_queue, "jobs_by_run", lambda _: dict.fromkeys(runs, Job("7_0", "RUNNING")))
    events = collect([runs], store)
    assert events[0]["text"] == "goes on from step 10"
    assert ends(events) == {first: "diverged", second: "done"}
    assert len(queue.submitted) == 1 and not submission.folder.exists()


def test_runs_that_another_command_collected_are_not_waited_for(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["RUNNING"])
    done, lost = group(7, 8)
    submit = queue.submit

    def submit_and_lose(submission: Submission, works: Sequence[Mapping[str, Any]], *_: object) -> None:
        submit(submission, works)
        store.save_run(done, Status("done", 500), {"run.json": b"{}"})
        submission.close(keep=False)

    monkeypatch.setattr(slurm_queue, "submit", submit_and_lose)
    assert ends(collect([group(7, 8)], store)) == {done: "done", lost: "killed"}


def test_a_run_that_was_submitted_anew_is_not_ended_by_what_its_first_job_told(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It crashed once, in a submission whose other job still runs."""
    (name,), (other,) = group(5), group(6)
    monkeypatch.setattr(time, "strftime", lambda _: "20200101-000000")
    before = new_submission(store, [[name], [other]], 1)
    monkeypatch.undo()
    end = {"event": "end", "run_id": name, "step": 500, "trained": True}
    before.events_path(0).write_text(json.dumps({**end, "status": "crashed"}) + "\n")
    queue = Queue(monkeypatch)

    def submit(submission: Submission, works: Sequence[Mapping[str, Any]], *_: object) -> None:
        queue.submitted.append((submission, works))
        submission.events_path(0).write_text(json.dumps({**end, "status": "done"}) + "\n")

    monkeypatch.setattr(slurm_queue, "submit", submit)
    monkeypatch.setattr(slurm_queue, "jobs_of", lambda _: {(before.name, 1): Job("7_1", "RUNNING")})
    assert ends(collect([group(5)], store)) == {name: "done"}
    assert len(queue.submitted) == 1


def test_half_a_line_that_a_killed_job_left_harms_no_other(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = group(5, 6)
    first, second = runs
    submission = new_submission(store, [list(runs)], 1)
    submission.events_path(0).write_text('3\n{"event": "step", "run_i')
    with submission.events_path(0).open("a") as file:
        teller = Teller(file)
        for name in (first, second):
            teller.tell({"event": "end", "run_id": name, "status": "done", "step": 500, "trained": True})
    queue = Queue(monkeypatch, ["COMPLETED"])
    queue.submitted.append((submission, []))
    monkeypatch.setattr(slurm_queue, "jobs_by_run", lambda _: dict.fromkeys(runs, Job("7_0", "RUNNING")))
    assert ends(collect([runs], store)) == {first: "done", second: "done"}


@pytest.mark.parametrize(
    ("refusals", "reason"),
    [
        (11, "job 7_0 is cancelled"),
        (12, "could not be submitted again (sbatch: QOSMaxSubmitJobPerUserLimit)"),
    ],
)
def test_a_run_that_is_refused_when_it_is_to_be_tried_again_is_not_waited_for_without_end(
    refusals: int, reason: str, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["NODE_FAIL", "CANCELLED"])
    monkeypatch.setattr(slurm_collector, "QUEUE_SECONDS", 0.0)
    monkeypatch.setattr(slurm_collector, "TAIL_SECONDS", 0.0)
    submit, left = queue.submit, [None, *[UserError("sbatch: QOSMaxSubmitJobPerUserLimit")] * refusals, None]

    def submit_or_refuse(submission: Submission, *about: Any) -> None:
        if error := left.pop(0):
            submission.close(keep=False)
            raise error
        submit(submission, *about)

    monkeypatch.setattr(slurm_queue, "submit", submit_or_refuse)
    (name,) = group(9)
    events = collect([group(9)], store)
    assert ends(events) == {name: "killed"}
    assert reason in events[-1]["reason"]
    assert len(notes(events)) == (refusals == 11)


def test_where_an_array_is_refused_those_submitted_before_it_are_taken_back(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["PENDING"])
    submit, taken_back = queue.submit, list[Sequence[str]]()

    def refuse_gpus(submission: Submission, works: Sequence[Mapping[str, Any]], *about: object) -> None:
        if about[-1]:
            submission.close(keep=False)
            raise UserError("sbatch: Invalid generic resource (gres) specification")
        submit(submission, works)

    monkeypatch.setattr(slurm_queue, "submit", refuse_gpus)
    monkeypatch.setattr(slurm_queue, "_answer", taken_back.append)
    groups = [group(14), group(15)]
    with pytest.raises(UserError, match="Invalid generic resource"):
        collect(groups, store, replace(HOW, on_gpu=frozenset(groups[1])))
    ((first, _),) = queue.submitted
    assert taken_back == [["scancel", f"--name={first.name}"]]
    assert not open_submissions(store)


def test_of_two_commands_that_see_a_job_die_one_submits_again(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["-"])
    (name,) = group(10)

    def die_while_another_submits_again() -> str:
        queue.submitted.append((new_submission(store, [[name]], 2), []))
        return "NODE_FAIL"

    def die() -> str:
        return "NODE_FAIL"

    def end_under_the_other() -> str:
        store.save_run(name, Status("done", 500), {"run.json": b"{}"})
        queue.submitted[1][0].events_path(0).write_text(
            json.dumps({"event": "end", "run_id": name, "status": "done", "step": 500, "trained": True})
            + "\n"
        )
        return "NODE_FAIL"

    answer_in_turn(
        queue, monkeypatch, lambda: "PENDING", die_while_another_submits_again, die, die, end_under_the_other
    )
    assert ends(collect([group(10)], store)) == {name: "done"}
    assert len(queue.submitted) == 2


def test_a_job_that_the_queue_is_only_about_to_know_is_not_submitted_again(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["-"])
    (name,) = group(11)
    answer_in_turn(
        queue,
        monkeypatch,
        lambda: "PENDING",
        lambda: None,
        lambda: "PENDING",
        lambda: "RUNNING",
        lambda: "CANCELLED",
    )
    events = collect([group(11)], store)
    assert ends(events) == {name: "killed"}
    assert "is cancelled" in events[-1]["reason"] and not notes(events)
    assert len(queue.submitted) == 1


def test_nor_is_one_given_up_that_the_queue_is_only_about_to_know_at_its_second_try(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["-"])
    (name,) = group(11)
    second = iter(["PENDING", None, "RUNNING"])  # for who submits, who collects, who looks again

    def jobs_of(submissions: Sequence[Submission]) -> dict[tuple[str, int], Job]:
        names = [submission.name for submission, _ in queue.submitted]
        states = {names[0]: "NODE_FAIL"} if names else {}
        for own in submissions:
            if own.name in names[1:] and (state := next(second, "CANCELLED")):
                states[own.name] = state
        return {(own, 0): Job("7_0", state) for own, state in states.items()}

    monkeypatch.setattr(slurm_queue, "jobs_of", jobs_of)
    events = collect([group(11)], store)
    assert ends(events) == {name: "killed"}
    assert "is cancelled" in events[-1]["reason"]
    assert len(queue.submitted) == 2


def test_a_queue_that_does_not_answer_is_said_once_and_asked_again(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even the first look, after which jobs that cannot run are taken back, ends the command."""
    queue = Queue(monkeypatch, ["-"])
    (name,) = group(12)
    answer_in_turn(queue, monkeypatch, no_answer, no_answer, no_answer, lambda: "CANCELLED")
    events = collect([group(12)], store)
    assert ends(events) == {name: "killed"}
    (note,) = notes(events)
    assert "does not answer; it is asked again" in note


# --- GPUs ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "marked", "has_one"),
    [
        ({}, False, False),
        ({}, True, True),
        ({"gpus-per-node": "1"}, False, True),
        ({"gres": "gpu:a100:1"}, False, True),
        ({"gres": "license:1", "partition": "gpu"}, False, False),
    ],
)
def test_a_job_sees_gpus_only_where_it_asked_for_one(
    options: dict[str, str], marked: bool, has_one: bool, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(monkeypatch, ["RUNNING"])
    runs = group(13)
    place = Place("slurm", slurm=tuple(options.items()), detach=True)
    with pytest.raises(Detached):
        collect([runs], store, Supervision(2, place=place, on_gpu=frozenset(runs if marked else ())))
    ((_, (work,)),) = queue.submitted
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "all of the node's")
    monkeypatch.setenv("XDG_CACHE_HOME", str(store.root))
    seen: list[str] = []
    monkeypatch.setattr(local, "run_groups", lambda *_: seen.append(os.environ["CUDA_VISIBLE_DEVICES"]))
    slurm_job.train(work)
    assert seen == ["all of the node's" if has_one else ""]


def test_what_ended_while_nobody_waited_is_put_away_by_the_same_command(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command was left, and all runs lie in the store when it is given again: none is to be trained."""
    queue = Queue(monkeypatch, ["RUNNING"])
    groups = [group(11), group(12)]
    detached = replace(HOW, place=Place("slurm", detach=True))
    with pytest.raises(Detached, match="2 jobs in Slurm's queue go on"):
        collect(groups, store, detached)
    for name in group(11):
        store.save_run(name, Status("done", 500), {"run.json": b"{}"})
    with pytest.raises(Detached, match="1 job in Slurm's queue go"):
        collect([group(12)], store, detached)
    for name in group(12):
        store.save_run(name, Status("done", 500), {"run.json": b"{}"})
    collect([], store, detached)
    assert open_submissions(store)  # its last job is still ending
    queue.states = ["COMPLETED"]
    collect([], store, detached)
    assert len(queue.submitted) == 1 and not queue.submitted[0][0].folder.exists()


def test_a_study_that_is_stored_whole_still_has_its_jobs_put_away(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[object] = []
    monkeypatch.setattr(slurm, "run_groups", lambda groups, *_: asked.append(groups))
    monkeypatch.setattr(local, "run_groups", lambda *_: pytest.fail("nothing is to be trained here"))
    planned = make_plan(load_study("activation"), Selection(seeds=(0,), steps=256))
    for how in (HOW, replace(HOW, place=Place())):
        execute(planned, {}, store, how, lambda progress: None)
    assert asked == [[]]


def test_notes_that_cannot_be_written_are_refused_in_a_line(store: Store) -> None:
    submissions_folder(store).write_text("a file in the folder's place")
    with pytest.raises(UserError, match="-slurm: cannot be written"), alone(store):
        pass


def test_a_folder_of_results_that_nothing_was_submitted_from_gets_no_folder_beside_it(store: Store) -> None:
    assert collect([], store) == []
    assert not submissions_folder(store).exists()
