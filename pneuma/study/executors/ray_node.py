"""What a node of a Ray cluster does for a group of runs: trains it, and sends home what it leaves.

driver → group of runs, with their newest checkpoints → here → checkpoints, finished runs, events → driver

The node works in a results folder of its own that goes when the group has ended. Its runs are trained by
the local executor, so that one process of one thread trains each, time-outs and crashes are judged alike,
and what trains can be killed alone.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.study.executors import local
from pneuma.study.executors.base import Event, Supervision
from pneuma.study.executors.interrupts import Interrupts
from pneuma.study.executors.ray_cluster import versions
from pneuma.study.files import CHECKPOINTS, checksum, read_checkpoint_name
from pneuma.study.provenance import CARRIED_CODE
from pneuma.study.store import Store

GATHER_SECONDS = 0.5
"""How long news is gathered before it is sent."""
SILENT_SECONDS = 5.0
"""How long the driver is left waiting when there is none."""
LOOK_SECONDS = 0.1

FOLDER = "pneuma-node-"
"""How the temporary folder of a node begins; its process follows."""

Message = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """What a node is to train.

    Attributes:
        runs: settings by id.
        checkpoints: files to go on from: the id of their run, their name and their contents.
        checkpoint_seconds, timeout_seconds, keep: as in `Supervision`.
        gpu: whether the group has a GPU.
        code: what the provenance says of the code, which came without its repository.
    """

    runs: Mapping[str, Mapping[str, Any]]
    checkpoints: tuple[tuple[str, str, bytes], ...]
    checkpoint_seconds: float
    timeout_seconds: float | None
    keep: int
    gpu: bool
    code: str


class Node:
    """Trains one group; made on its node by Ray, and asked for news by the driver until there is none."""

    def __init__(self) -> None:
        _sweep()
        self._folder = Path(tempfile.mkdtemp(prefix=f"{FOLDER}{os.getpid()}-"))
        self._store = Store(self._folder)
        self._interrupts = Interrupts()
        self._change = threading.Condition()
        self._messages: list[Message] = []
        self._sent: set[Path] = set()

    def about(self) -> Message:
        """Return this node's name in the cluster, and the versions of all that may decide over bits here."""
        import ray

        return {"node": ray.get_runtime_context().get_node_id(), "versions": versions()}

    def begin(self, job: Job) -> None:
        """Begin to train a group; what goes wrong is told as news, as nobody waits for an answer."""
        threading.Thread(target=self._work, args=(job,), daemon=True).start()

    def stop(self) -> None:
        """Let every run come to a checkpoint and end."""
        self._interrupts.interrupt()

    def news(self) -> list[Message]:
        """Return what has happened since the last news, soon after it did; the last of all is `gone`."""
        patience = time.monotonic() + SILENT_SECONDS
        with self._change:
            self._look_for_checkpoints()  # even where other news never lets this wait
            while not self._messages and time.monotonic() < patience:
                self._change.wait(LOOK_SECONDS)
                self._look_for_checkpoints()
            if not any(message["event"] in ("end", "gone") for message in self._messages):
                self._change.wait(GATHER_SECONDS)
            news, self._messages = _latest_steps(self._messages), []
        return news

    def _work(self, job: Job) -> None:
        gone: Message = {"event": "gone", "reason": ""}
        try:
            self._train(job)
        except KeyboardInterrupt:
            pass
        except BaseException:
            gone["reason"] = traceback.format_exc()
        shutil.rmtree(self._folder, ignore_errors=True)
        with self._change:
            self._messages.append(gone)
            self._change.notify()

    def _train(self, job: Job) -> None:
        os.environ[CARRIED_CODE] = job.code
        if not job.gpu:  # Ray hides GPUs from none that asked for none
            os.environ["CUDA_VISIBLE_DEVICES"] = ""
        for name, file, data in job.checkpoints:
            path = self._store.run_folder(name) / CHECKPOINTS / file
            self._sent.add(path)
            self._store.write(path, data)
        runs = {name: make_run(settings) for name, settings in job.runs.items()}
        how = Supervision(1, job.checkpoint_seconds, job.timeout_seconds, job.keep)
        local.run_groups([runs], self._store, how, self._note, self._interrupts)

    def _note(self, event: Event) -> None:
        """Take one event of the local executor; an end takes the run's files along."""
        with self._change:
            if event["event"] == "end":
                self._look_for_checkpoints()
                event = {**event, "files": self._files(event["run_id"])}
            self._messages.append(dict(event))
            self._change.notify()

    def _files(self, name: str) -> dict[str, bytes]:
        """Return every file of a run that has ended."""
        files = {}
        for file in self._store.file_names(name):
            try:
                files[file] = self._store.read_file(name, file)
            except UserError:
                return {}
        return files

    def _look_for_checkpoints(self) -> None:
        """Send every checkpoint that has appeared, the earlier ones first."""
        found = sorted(self._store.root.glob(f"runs/*/{CHECKPOINTS}/*.safetensors"))
        for path in found:
            told = read_checkpoint_name(path.name)
            if path in self._sent or not told:
                continue
            try:
                data = path.read_bytes()
            except OSError:  # it has been replaced by a later one
                continue
            if checksum(data)[:16] == told[1]:
                self._sent.add(path)
                about = {"run_id": path.parent.parent.name, "file": path.name, "data": data}
                self._messages.append({"event": "checkpoint", **about})


def _latest_steps(messages: list[Message]) -> list[Message]:
    """Leave out steps that a later one of the same run makes old."""
    last = {message["run_id"]: message for message in messages if message["event"] == "step"}
    return [
        message for message in messages if message["event"] != "step" or last[message["run_id"]] is message
    ]


def _sweep() -> None:
    """Remove the folders of nodes that were killed on this machine."""
    for path in Path(tempfile.gettempdir()).glob(f"{FOLDER}*-*"):
        process = path.name.removeprefix(FOLDER).partition("-")[0]
        try:
            os.kill(int(process), 0)
        except ProcessLookupError:
            shutil.rmtree(path, ignore_errors=True)
        except (OSError, ValueError):  # another user's, or no node's
            continue
