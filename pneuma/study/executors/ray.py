"""The Ray executor: groups of runs go to the nodes of a cluster, and all that they leave comes back here.

plan → groups → Ray actors, one a group (`ray_node`) → this process → store

This process alone writes the store, so that no disk is shared. It holds the lock of every run that is
away, keeps the newest checkpoint of each in the store as the local executor does, and gives it to the next
node when one is lost. Nodes may come and go: more may be asked for (`--workers`) than there is room for,
and what does not fit yet waits for a node.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from typing import Any

from pneuma.config import Run, as_settings
from pneuma.errors import UserError
from pneuma.study.cores import available_cores
from pneuma.study.executors.base import OnEvent, Place, Supervision
from pneuma.study.executors.interrupts import Interrupts
from pneuma.study.executors.local import BUSY_SECONDS
from pneuma.study.executors.ray_cluster import (
    NODE_LABEL,
    Cluster,
    join,
    mismatch,
    refuse_lacking_resources,
    refuse_unlike_nodes,
    unlike,
)
from pneuma.study.executors.ray_home import Home
from pneuma.study.executors.ray_node import Job, Message, Node
from pneuma.study.provenance import carried_code
from pneuma.study.store import Status, Store
from pneuma.study.trust import own_things

LOSSES = 3
"""How many nodes a group may lose one after another, without a checkpoint in between, before that counts."""
WAIT_SECONDS = 0.2
"""How long to wait for news before Ctrl-C is looked for."""
TOLD_SECONDS = 15.0
"""How long a group may wait for a node before that is said."""


def most_workers(place: Place) -> int:
    """Return how many runs the cluster's CPUs can train at once.

    Raises:
        UserError: where the cluster cannot be joined.
    """
    if place.address is None:  # a cluster of its own is not started only to be counted
        return available_cores()
    return max(1, join(place.address).count("CPU"))


def check(runs: Mapping[str, Run], supervision: Supervision) -> str:
    """Refuse runs that need what does not go to the nodes, and clusters that are not fit for them.

    Returns:
        Which cluster it is and how much room it has: the first run may take a while to tell anything.

    Raises:
        UserError: with the mend.
    """
    for run in runs.values():
        for what in own_things(as_settings(run)).values():
            raise UserError(
                f"--executor ray cannot {what}: only Pneuma's own code goes to the nodes; "
                "--executor local trains such runs"
            )
    cluster = join(supervision.place.address)
    refuse_lacking_resources(cluster, sum(name in supervision.on_gpu for name in runs))
    refuse_unlike_nodes(cluster)
    return f"runs are sent to {cluster.where}: {cluster.room()}"


def run_groups(
    groups: Iterable[Mapping[str, Run]], store: Store, supervision: Supervision, on_event: OnEvent
) -> None:
    """Train every group of runs on some node of the cluster, as the contract says (`base.Executor`).

    Raises:
        KeyboardInterrupt: after Ctrl-C, when every run has come home.
    """
    cluster = join(supervision.place.address)
    with Interrupts() as interrupts:
        _Driver(groups, cluster, store, supervision, on_event, interrupts).work()
        if interrupts.count:
            raise KeyboardInterrupt


@dataclass
class _Task:
    """A group of runs that waits to be sent, from some time on."""

    group: Mapping[str, Run]
    losses: int = 0
    not_before: float = 0.0


@dataclass
class _Away:
    """A group that is on a node, or waits for one.

    Attributes:
        awaited: a reference to what its node tells next.
        locks: by run id, of those that have not ended.
        since: when it was sent.
        gone: why its node has ended, which is nothing where all went well; None until then.
    """

    task: _Task
    actor: Any
    awaited: Any
    locks: dict[str, ExitStack]
    gpu: bool
    since: float = field(default_factory=time.monotonic)
    begun: bool = False
    told_waiting: bool = False
    asked_to_stop: bool = False
    gone: str | None = None


class _Driver:
    """Keeps nodes busy until every task has ended."""

    def __init__(
        self,
        groups: Iterable[Mapping[str, Run]],
        cluster: Cluster,
        store: Store,
        supervision: Supervision,
        on_event: OnEvent,
        interrupts: Interrupts,
    ) -> None:
        self._tasks = deque(_Task(group) for group in groups)
        self._cluster = cluster
        self._store = store
        self._home = Home(store, supervision.keep_checkpoints, self._note)
        self._how = supervision
        self._on_event = on_event
        self._interrupts = interrupts
        self._away: list[_Away] = []
        self._told_busy: set[str] = set()
        self._unlike: set[str] = set()
        self._code = carried_code()

    def work(self) -> None:
        """Work off all tasks; leaving by an exception calls all groups off."""
        import ray

        try:
            while self._tasks or self._away:
                self._send_what_may()
                awaited = {away.awaited: away for away in self._away}
                if awaited:
                    ray.wait([*awaited], num_returns=1, timeout=WAIT_SECONDS)
                    ready, _ = ray.wait([*awaited], num_returns=len(awaited), timeout=0)
                    for reference in ready:  # all: the first in the list is to keep none waiting
                        self._hear(awaited[reference])
                else:
                    time.sleep(WAIT_SECONDS)
                self._tell_waiting()
                self._heed_interrupts()
        finally:
            for away in [*self._away]:
                self._leave(away)

    # --- Sending --------------------------------------------------------------------------------------

    def _send_what_may(self) -> None:
        if len(self._away) >= self._how.workers:
            return
        now = time.monotonic()
        gpus = max(1, self._cluster.count("GPU")) if self._how.on_gpu else 0
        for task in [task for task in self._tasks if task.not_before <= now]:
            gpu = any(name in self._how.on_gpu for name in task.group)
            if len(self._away) < self._how.workers and (not gpu or self._on_gpu() < gpus):
                self._tasks.remove(task)
                self._send(task, gpu)

    def _on_gpu(self) -> int:
        return sum(away.gpu for away in self._away)

    def _send(self, task: _Task, gpu: bool) -> None:
        """Lock the runs of a group and ask for a node for those that are free and not finished."""
        import ray

        locks = {name: lock for name in task.group if (lock := self._lock(task, name))}
        if not locks:
            return
        avoided = {"label_selector": {NODE_LABEL: f"!in({','.join(sorted(self._unlike))})"}}
        kind: Any = ray.remote(Node)
        actor = kind.options(
            num_cpus=1,
            num_gpus=int(gpu),
            max_restarts=0,
            max_concurrency=4,  # about and begin, news, stop
            **(avoided if self._unlike else {}),
        ).remote()
        self._away.append(_Away(task, actor, actor.about.remote(), locks, gpu))

    def _lock(self, task: _Task, name: str) -> ExitStack | None:
        """Return the lock of a run that is to be trained; None where it is another's, or has ended."""
        with ExitStack() as stack:
            try:
                free = stack.enter_context(self._store.lock(name))
            except OSError as error:
                reason = f"{self._store.run_folder(name)}: cannot be written ({error.strerror})"
                self._end(name, Status("crashed"), trained=True, reason=reason)
                return None
            if not free:
                self._tasks.append(
                    _Task({name: task.group[name]}, task.losses, time.monotonic() + BUSY_SECONDS)
                )
                if name not in self._told_busy:
                    self._told_busy.add(name)
                    self._note(name, "another process trains this run; waiting for it")
                return None
            status = self._store.status(name)
            if status.finished:
                self._end(name, status, trained=False)
                return None
            self._home.sweep(name, task.group[name])
            return stack.pop_all()

    def _begin(self, away: _Away) -> None:
        """Give a node that is there and fit its runs, each with the checkpoint that it goes on from."""
        runs = {name: away.task.group[name] for name in away.locks}
        job = Job(
            runs={name: as_settings(run) for name, run in runs.items()},
            checkpoints=tuple(
                file for name, run in runs.items() for file in self._home.checkpoints(name, run)
            ),
            checkpoint_seconds=self._how.checkpoint_seconds,
            timeout_seconds=self._how.timeout_seconds,
            keep=self._how.keep_checkpoints,
            gpu=away.gpu,
            code=self._code,
        )
        away.actor.begin.remote(job)
        away.begun = True
        away.awaited = away.actor.news.remote()

    # --- Hearing --------------------------------------------------------------------------------------

    def _hear(self, away: _Away) -> None:
        """Take what a node tells, or note that it has gone."""
        import ray

        try:
            told = ray.get(away.awaited)
        except ray.exceptions.RayError as error:
            self._lose(away, "was lost", " ".join(str(error).split()))
            return
        if not away.begun:
            self._welcome(away, told)
            return
        for message in told:
            self._take(away, message)
        if away.gone is None:
            away.awaited = away.actor.news.remote()
        elif away.locks:  # an end that its node did not tell: it failed as a whole
            self._lose(away, f"failed ({_last_line(away.gone)})", away.gone)
        else:
            self._leave(away)

    def _welcome(self, away: _Away, about: Mapping[str, Any]) -> None:
        """Begin on a node, unless its versions are others: one that joined since they were compared."""
        if told := mismatch(about["versions"]):
            self._avoid(away, about["node"], told)
        elif self._interrupts.count:
            self._leave(away)
        else:
            self._begin(away)

    def _avoid(self, away: _Away, node: str, told: str) -> None:
        """Send a group that has come to an unlike node elsewhere, and no other there.

        Raises:
            UserError: where there is no other node.
        """
        nodes = {each["NodeID"]: each["NodeManagerAddress"] for each in self._cluster.trainers()}
        self._unlike.add(node)
        if nodes.keys() <= self._unlike:
            raise UserError(unlike(nodes.get(node, node), told))
        for name in away.locks:
            self._note(name, f"not on the node {nodes.get(node, node)}, which has {told}")
        self._send_again(away)

    def _take(self, away: _Away, message: Message) -> None:
        kind = message["event"]
        if kind == "checkpoint":
            name = message["run_id"]
            away.task.losses = 0
            self._home.take_checkpoint(name, away.task.group[name], message["file"], message["data"])
        elif kind == "gone":
            away.gone = message["reason"]
        elif kind != "end":
            self._on_event(message)
        elif message["run_id"] in away.locks:
            self._take_end(away, message)

    def _take_end(self, away: _Away, message: Message) -> None:
        """Store how a run ended, then let go of it and say so."""
        name, files = message["run_id"], message.pop("files")
        status = Status(message["status"], message["step"])
        try:
            self._home.take_end(name, away.task.group[name], status, files)
        except UserError as error:
            message = {**message, "status": "crashed", "reason": str(error)}
        away.locks.pop(name).close()
        self._on_event(message)

    def _end_unsaid(self, away: _Away, name: str, reason: str) -> None:
        """End a run of which its node told no end."""
        status = Status("stopped" if self._interrupts.count else "killed")
        if status.name == "killed":
            self._home.save_killed(name, away.task.group[name], reason)
        away.locks.pop(name).close()
        self._end(name, status, trained=True)

    # --- Losing ---------------------------------------------------------------------------------------

    def _lose(self, away: _Away, what: str, reason: str) -> None:
        """Send what was on a lost or failed node to another, each run from its newest checkpoint."""
        names = [*away.locks]
        away.task.losses += 1
        final = away.task.losses >= LOSSES
        for name in names:
            if self._interrupts.count or final:
                self._end_unsaid(away, name, f"its node {what}, as did {LOSSES - 1} before it: {reason}")
            else:
                step = self._store.status(name).step
                self._note(name, f"its node {what}; goes on elsewhere from step {step:,}")
        self._send_again(away)

    def _send_again(self, away: _Away) -> None:
        """Let go of a node; runs that it has not ended go to another."""
        left = {name: away.task.group[name] for name in away.locks}
        self._leave(away)
        if left:
            self._tasks.appendleft(_Task(left, away.task.losses))

    def _leave(self, away: _Away) -> None:
        """Let go of a node and of the runs that it has not ended."""
        import ray

        with suppress(Exception):  # it may be gone, or the whole cluster
            ray.kill(away.actor)
        for lock in away.locks.values():
            lock.close()
        self._away.remove(away)

    def _heed_interrupts(self) -> None:
        if not self._interrupts.count:
            return
        self._tasks.clear()
        for away in [*self._away]:
            if self._interrupts.count > 1 or not away.begun:
                for name in [*away.locks]:
                    self._end_unsaid(away, name, "")
                self._leave(away)
            elif not away.asked_to_stop:
                away.asked_to_stop = True
                away.actor.stop.remote()

    # --- Telling --------------------------------------------------------------------------------------

    def _tell_waiting(self) -> None:
        """Say once of a group that no node has taken it up: it lacks room, or is long in starting."""
        for away in self._away:
            if away.begun or away.told_waiting or time.monotonic() < away.since + TOLD_SECONDS:
                continue
            away.told_waiting = True
            what = "a GPU" if away.gpu else "a CPU"
            for name in away.locks:
                text = f"waits until a node of {self._cluster.where} has {what} free and is ready"
                self._on_event({"event": "passing", "run_id": name, "text": text})

    def _note(self, name: str, text: str) -> None:
        self._on_event({"event": "note", "run_id": name, "text": text})

    def _end(self, name: str, status: Status, trained: bool, **about: str) -> None:
        told = {"status": status.name, "step": status.step, "trained": trained, **about}
        self._on_event({"event": "end", "run_id": name, **told})


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or [""])[-1]
