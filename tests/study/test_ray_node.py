"""What a node sends home, without a cluster: events, whole checkpoints, files of runs; what is refused."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.config import as_settings, make_run
from pneuma.engines.base import checkpoint_steps
from pneuma.errors import UserError
from pneuma.study.checkpoints import file_name
from pneuma.study.executors import ray, ray_node
from pneuma.study.executors.base import HERE, Supervision
from pneuma.study.executors.ray_cluster import Cluster, mismatch, read_address, refuse_lacking_resources
from pneuma.study.executors.ray_node import Job, Message, Node
from pneuma.study.identity import run_id

TINY = {"horizon": 64, "minibatch": 32, "epochs": 1, "evaluation_episodes": 2, "episode_steps": 50}
RUN = make_run({**TINY, "steps": 64 * 40})
JOB = Job({run_id(RUN): as_settings(RUN)}, (), 0.05, None, 0, False, "0.1.0 abc")


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node sets variables of its own process."""
    for name in ("PNEUMA_CODE", "CUDA_VISIBLE_DEVICES"):
        monkeypatch.setenv(name, "before")


def told(node: Node) -> Iterator[Message]:
    """Yield what a node tells, to its end."""
    while True:
        for message in node.news():
            yield message
            if message["event"] == "gone":
                return


def test_a_node_sends_checkpoints_and_the_end_with_every_file_and_leaves_nothing() -> None:
    node = Node()
    folder = node._folder
    node.begin(replace(JOB, keep=3, checkpoint_seconds=1000.0))
    messages = [*told(node)]
    kinds = [message["event"] for message in messages]
    assert kinds[-2:] == ["end", "gone"]
    assert messages[-1]["reason"] == ""
    checkpoints = [message for message in messages if message["event"] == "checkpoint"]
    steps = [int(message["file"][:13]) for message in checkpoints]
    assert steps == sorted(checkpoint_steps(RUN, 3))
    assert len(steps) == 4  # that of the first update too
    assert all(m["file"] == file_name(int(m["file"][:13]), m["data"]) for m in checkpoints)
    end = messages[-2]
    assert (end["run_id"], end["status"], end["step"], end["trained"]) == (run_id(RUN), "done", 64 * 40, True)
    assert {"run.json", "episodes.parquet", "policy.safetensors", "provenance.json"} <= {*end["files"]}
    assert b'"commit": "abc"' in end["files"]["provenance.json"]
    assert not folder.exists()


def test_a_stopped_node_sends_a_checkpoint_from_which_the_next_one_ends_alike() -> None:
    long = make_run({**TINY, "steps": 64 * 600})  # not over before a busy machine has been told to stop
    job = replace(JOB, runs={run_id(long): as_settings(long)}, checkpoint_seconds=1000.0)
    straight, first = Node(), Node()
    straight.begin(job)
    files = next(m["files"] for m in told(straight) if m["event"] == "end")
    first.begin(job)
    messages = list[Message]()
    for message in told(first):
        messages.append(message)
        if message["event"] == "step":
            first.stop()
    (checkpoint,) = (message for message in messages if message["event"] == "checkpoint")
    ends = [message for message in messages if message["event"] == "end"]
    assert [(end["status"], end["files"]) for end in ends] == [("stopped", {})]
    kept = (checkpoint["run_id"], checkpoint["file"], checkpoint["data"])
    second = Node()
    second.begin(replace(job, checkpoints=(kept,)))
    messages = [*told(second)]
    assert any("goes on from step" in message.get("text", "") for message in messages)
    assert not any("other bits" in message.get("text", "") for message in messages)
    gone_on = next(message["files"] for message in messages if message["event"] == "end")
    assert {**gone_on, "provenance.json": b""} == {**files, "provenance.json": b""}


def test_a_checkpoint_is_sent_at_once_where_other_news_never_ends() -> None:
    node, data = Node(), b"of a run that tells steps faster than its driver hears them"
    path = node._store.run_folder(run_id(RUN)) / "checkpoints" / file_name(64, data)
    node._store.write(path, data)
    node._note({"event": "step", "run_id": run_id(RUN), "step": 128})
    assert {message["event"]: message.get("data") for message in node.news()} == {
        "step": None,
        "checkpoint": data,
    }


@pytest.mark.parametrize(
    ("job", "reason"),
    [
        (replace(JOB, runs={run_id(RUN): {"steps": 64, "nonsense": 1}}), "nonsense"),
        (replace(JOB, checkpoints=(("no-id", file_name(64, b""), b""),)), "no run's id"),
    ],
)
def test_a_node_that_cannot_begin_says_why_and_leaves_nothing(job: Job, reason: str) -> None:
    node = Node()
    node.begin(job)
    (gone,) = told(node)
    assert gone["event"] == "gone" and reason in gone["reason"]
    assert not node._folder.exists()


def test_the_folders_of_killed_nodes_are_removed_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    names = [f"{ray_node.FOLDER}{ended.pid}-x", f"{ray_node.FOLDER}{os.getpid()}-y", "another-1-z"]
    for name in names:
        (tmp_path / name).mkdir()
    ray_node._sweep()
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names[1:])


# --- Refusals ----------------------------------------------------------------------------------------


def test_versions_that_differ_are_named_with_both() -> None:
    here = {"Python": "3.11.7", "numpy": "2.4.6", "jax": "0.10.2"}
    assert mismatch(here, here) == ""
    there = {"Python": "3.11.7", "numpy": "2.3.0", "torch": "2.13.0"}
    assert mismatch(there, here) == (
        "numpy 2.3.0 (here 2.4.6), jax missing (here 0.10.2), torch 2.13.0 (here none)"
    )


@pytest.mark.parametrize(
    "text", ["6379", "host", "host:", ":6379", "host:0", "host:65536", "ray://h:1", "h:x"]
)
def test_what_is_no_address_is_refused(text: str) -> None:
    with pytest.raises(UserError, match=f"--address {text}: must be HOST:PORT"):
        read_address(text)


def test_an_address_is_a_host_and_a_port() -> None:
    assert read_address("10.0.0.5:6379") == ("10.0.0.5", 6379)
    assert read_address("[::1]:6379") == ("::1", 6379)


@pytest.mark.parametrize(
    ("nodes", "on_gpu", "words"),
    [
        ([{"CPU": 2.0}], 0, ""),
        ([{"CPU": 2.0}, {"CPU": 1.0, "GPU": 1.0}], 3, ""),
        ([{}, {"memory": 1.0}], 0, "no node with a free CPU"),
        ([{"CPU": 8.0}], 3, "3 runs want a GPU each"),
        ([{"CPU": 8.0}, {"GPU": 1.0}], 1, "1 run wants a GPU each"),  # one that has no CPU beside it
    ],
)
def test_resources_that_no_node_has_are_refused(
    nodes: list[dict[str, float]], on_gpu: int, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[dict[str, Any]] = [{"Resources": node} for node in nodes]
    monkeypatch.setattr(Cluster, "nodes", lambda self: told)
    if not words:
        return refuse_lacking_resources(Cluster("it"), on_gpu)
    with pytest.raises(UserError, match=words):
        refuse_lacking_resources(Cluster("it"), on_gpu)


def test_runs_that_read_files_of_ones_own_are_refused_before_a_cluster_is_joined() -> None:
    own = replace(RUN, reward=("mine:reward",))
    with pytest.raises(UserError, match="cannot run the reward mine:reward: only Pneuma's own code"):
        ray.check({"0" * 16: own}, Supervision(1, place=replace(HERE, executor="ray")))
