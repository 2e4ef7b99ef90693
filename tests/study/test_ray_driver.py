"""What the Ray executor makes of what nodes tell, with a Ray in its place whose nodes a test writes down."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from pneuma.config import Run, make_run
from pneuma.errors import UserError
from pneuma.study.checkpoints import checkpoint_files, file_name
from pneuma.study.executors import ray, ray_home
from pneuma.study.executors.base import Event, Place, Supervision
from pneuma.study.executors.ray_cluster import Cluster, versions
from pneuma.study.executors.ray_node import Job
from pneuma.study.identity import run_id
from pneuma.study.locks import RunLock
from pneuma.study.store import Store

News = list[dict[str, Any]]
HOW = Supervision(1, place=Place("ray"))
ALL_WELL = {"event": "gone", "reason": ""}
FULL = {"event": "gone", "reason": "Traceback: …\nOSError: No space left on device\n"}


class Lost(Exception):
    """What Ray raises of a node that has gone."""


@dataclass(frozen=True)
class Script:
    """A node that an actor comes to, and what it tells in order; an exception is its loss."""

    news: Sequence[News | Exception]
    node: str = "one"
    versions: Mapping[str, str] | None = None


@dataclass(eq=False)
class Answer:
    """A reference to what an actor answers."""

    told: Any


class Ray(ModuleType):
    """Ray as far as the driver speaks with it: actors come to the nodes of `scripts`, one after another.

    Its cluster has a head without CPUs and two nodes with one each.
    """

    def __init__(self, scripts: Sequence[Script]) -> None:
        super().__init__("ray")
        self.exceptions = SimpleNamespace(RayError=Lost)
        self.scripts = [*scripts]
        self.jobs: list[Job] = []

    def remote(self, kind: object) -> Any:
        return SimpleNamespace(options=lambda **_: SimpleNamespace(remote=self._actor))

    def _actor(self) -> Any:
        script = self.scripts.pop(0)
        news = iter(script.news)
        about = {"node": script.node, "versions": script.versions or versions()}
        answers = {"about": lambda: about, "begin": self.jobs.append, "news": lambda: next(news)}
        return SimpleNamespace(**{name: SimpleNamespace(remote=_answering(f)) for name, f in answers.items()})

    def wait(
        self, awaited: list[Answer], num_returns: int, timeout: float
    ) -> tuple[list[Answer], list[Answer]]:
        return awaited, []

    def get(self, answer: Answer) -> Any:
        if isinstance(answer.told, Exception):
            raise answer.told
        return answer.told

    def kill(self, actor: object) -> None:
        pass

    def nodes(self) -> list[dict[str, Any]]:
        rooms = {"head": {}, "one": {"CPU": 1.0}, "two": {"CPU": 1.0}}
        return [
            {"NodeID": name, "NodeManagerAddress": f"10.0.0.{i}", "Alive": True, "Resources": room}
            for i, (name, room) in enumerate(rooms.items())
        ]


def _answering(function: Any) -> Any:
    return lambda *told: Answer(function(*told))


def runs(*seeds: int) -> dict[str, Run]:
    made = [make_run({"steps": 2048, "seed": seed}) for seed in seeds]
    return {run_id(run): run for run in made}


def checkpoint(name: str, step: int) -> dict[str, Any]:
    data = f"{name} at {step}".encode()
    return {"event": "checkpoint", "run_id": name, "file": file_name(step, data), "data": data}


def done(name: str, **files: bytes) -> dict[str, Any]:
    told = {"status": "done", "step": 2048, "trained": True}
    return {
        "event": "end",
        "run_id": name,
        **told,
        "files": {f"{file}.json": data for file, data in files.items()},
    }


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Store:
    monkeypatch.setattr(ray, "join", lambda address: Cluster("it"))
    monkeypatch.setattr(ray, "WAIT_SECONDS", 0.01)
    monkeypatch.setattr(ray, "BUSY_SECONDS", 0.01)
    monkeypatch.setattr(ray_home, "read_checkpoint", lambda file: file)  # its bytes are as good as any
    return Store(tmp_path / "results")


def train(
    group: Mapping[str, Run], store: Store, monkeypatch: pytest.MonkeyPatch, *scripts: Script
) -> tuple[Ray, list[Event]]:
    """Train a group on nodes that behave as written; return what they were given, and all events."""
    played, events = Ray(scripts), list[Event]()
    monkeypatch.setitem(sys.modules, "ray", played)
    ray.run_groups([group], store, HOW, events.append)
    return played, events


def ends(events: Sequence[Event]) -> list[tuple[str, str, bool]]:
    return [(e["run_id"], e["status"], e["trained"]) for e in events if e["event"] == "end"]


def notes(events: Sequence[Event]) -> list[str]:
    return [event["text"] for event in events if event["event"] == "note"]


def steps_stored(store: Store, name: str) -> list[int]:
    return [file.step for file in checkpoint_files(store.run_folder(name))]


# --- What is said before runs are sent ---------------------------------------------------------------


def test_it_is_said_what_cluster_runs_go_to(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", Ray([]))
    monkeypatch.setattr(ray, "refuse_unlike_nodes", lambda cluster: None)
    monkeypatch.setattr(ray, "join", lambda address: Cluster(f"the cluster at {address}"))
    told = ray.check(runs(0), Supervision(1, place=Place("ray", "10.0.0.5:6379")))
    assert told == "runs are sent to the cluster at 10.0.0.5:6379: 2 CPUs on 2 nodes"  # and not on its head


def test_a_cluster_of_its_own_is_not_started_to_be_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ray, "join", lambda address: pytest.fail("a cluster was started"))
    monkeypatch.setattr(ray, "available_cores", lambda: 5)
    assert ray.most_workers(Place("ray")) == 5


# --- Nodes that fail ---------------------------------------------------------------------------------


def test_what_a_node_that_fails_has_not_ended_goes_to_another(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = group = runs(1, 2)
    failing = Script([[done(first, provenance=b"{}")], [FULL]])
    played, events = train(group, store, monkeypatch, failing, Script([[done(second, x=b"2"), ALL_WELL]]))
    assert ends(events) == [(first, "done", True), (second, "done", True)]
    assert notes(events) == [
        "its node failed (OSError: No space left on device); goes on elsewhere from step 0"
    ]
    assert [[*job.runs] for job in played.jobs] == [[first, second], [second]]


def test_a_group_whose_nodes_fail_three_times_in_a_row_is_killed_and_says_why(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    (name,) = group = runs(1)
    progress: list[News | Exception] = [[checkpoint(name, 128)], Lost("gone with the wind")]
    nodes: list[list[News | Exception]] = [[[FULL]], [[FULL]], progress, [[FULL]], [[FULL]]]
    _, events = train(group, store, monkeypatch, *(Script(news) for news in nodes))
    assert ends(events) == [(name, "killed", True)]
    assert len(notes(events)) == 4  # what came on in between begins the count anew
    assert b"No space left on device" in store.read_file(name, "error.txt")


# --- What comes home ---------------------------------------------------------------------------------


def test_a_checkpoint_takes_the_place_of_those_that_its_node_gave_up(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or they would be the newest here, go to the next node, and be given up again with all that it did."""
    (name,) = group = runs(1)
    for step in (512, 1024):
        told = checkpoint(name, step)
        store.write(store.run_folder(name) / "checkpoints" / told["file"], told["data"])
    seen: list[list[int]] = []
    monkeypatch.setattr(ray_home.Home, "sweep", lambda *_: seen.append(steps_stored(store, name)))
    going = Script([[checkpoint(name, 64)], [checkpoint(name, 128)], Lost("")])
    train(group, store, monkeypatch, going, Script([[done(name, x=b"1"), ALL_WELL]]))
    assert seen == [[1024, 512], [128, 64]]


def test_a_result_that_comes_without_its_files_is_none(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    (name,) = group = runs(1)
    _, events = train(group, store, monkeypatch, Script([[done(name), ALL_WELL]]))
    assert ends(events) == [(name, "crashed", True)]
    assert "could not read what it had stored" in events[-1]["reason"]
    assert not store.status(name).finished


# --- Runs and nodes that are passed over -------------------------------------------------------------


def test_a_command_whose_nodes_are_all_unlike_ends_though_its_head_trains_nothing(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = {**versions(), "numpy": "1.0"}
    nodes = [Script([], "one", other), Script([], "two", other)]
    with pytest.raises(UserError, match=r"the node 10\.0\.0\.2 has numpy 1\.0"):
        train(runs(1), store, monkeypatch, *nodes)


def test_a_run_that_was_anothers_is_trained_once_when_its_group_goes_to_another_node(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    mine, busy = group = runs(1, 2)
    with ExitStack() as other:
        assert other.enter_context(RunLock(store.run_folder(busy)))
        events: list[Event] = []
        monkeypatch.setitem(sys.modules, "ray", played := Ray(()))
        played.scripts = [
            Script([], "one", {**versions(), "numpy": "1.0"}),
            Script([[done(mine, x=b"1"), ALL_WELL]], "two"),
            Script([[done(busy, x=b"2"), ALL_WELL]], "two"),
        ]

        def hear(event: Event) -> None:
            events.append(event)
            if event["event"] == "end":
                other.close()

        ray.run_groups([group], store, HOW, hear)
    assert ends(events) == [(mine, "done", True), (busy, "done", True)]
    assert [[*job.runs] for job in played.jobs] == [[mine], [busy]]


def test_a_run_whose_folder_cannot_be_written_takes_no_other_along(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    barred, free = group = runs(1, 2)
    store.run_folder(barred).parent.mkdir(parents=True)
    store.run_folder(barred).write_text("a file in the folder's place")
    _, events = train(group, store, monkeypatch, Script([[done(free, x=b"1"), ALL_WELL]]))
    assert ends(events) == [(barred, "crashed", True), (free, "done", True)]
    assert "cannot be written (File exists)" in events[0]["reason"]
