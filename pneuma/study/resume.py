"""Going on after a kill: when to take checkpoints of a run, and where to start from."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from pneuma.config import Run
from pneuma.engines.base import Progress
from pneuma.engines.checkpoint import Checkpoint
from pneuma.errors import UserError
from pneuma.study.checkpoints import checkpoint_files, encode, file_name, read_checkpoint
from pneuma.study.kept import KeptCheckpoints
from pneuma.study.provenance import Attempt, differences
from pneuma.study.store import Store

WRITE_SHARE = 40
"""Checkpoints are at least so many times apart as the last one took to write."""

Send = Callable[..., None]


class Resume:
    """The checkpoints of one run while it trains.

    Attributes:
        history: what earlier attempts left: a list `attempts`, and `resumes` where this one went on.
    """

    def __init__(self, store: Store, name: str, run: Run, seconds: float, keep: int, send: Send) -> None:
        self._store = store
        self._name = name
        self._run = run
        self._send = send
        self._seconds = seconds
        self._next = time.monotonic() + seconds
        self._kept = KeptCheckpoints(store, name, run, keep)
        self.history: dict[str, Any] = {"attempts": [], "resumes": []}

    def latest(self) -> Checkpoint | None:
        """Return the latest whole checkpoint, saying which were damaged; None to start anew."""
        while file := self._kept.latest:
            read = read_checkpoint(file)
            if read is not None:
                checkpoint, self.history = read
                self._note_resume(checkpoint.step)
                return checkpoint
            self._say(f"the checkpoint at step {file.step:,} is damaged: going on from the one before")
            self._discard()
        return self._parents() if self._run.parent else None

    def _parents(self) -> Checkpoint:
        """Return the checkpoint that a fork begins with.

        Raises:
            UserError: when the parent keeps it no more.
        """
        parent, step = self._run.parent, self._run.fork_step
        for file in checkpoint_files(self._store.run_folder(parent)):
            if file.step == step and (read := read_checkpoint(file)):
                return read[0]
        raise UserError(f"run {parent} has no sound checkpoint at step {step:,} any more")

    def give_up(self, why: Exception) -> bool:
        """Give up the latest checkpoint, from which the engine cannot go on; return whether there was one."""
        if file := self._kept.latest:
            self._say(f"the checkpoint at step {file.step:,} is given up: {why}")
        return self._discard()

    def _discard(self) -> bool:
        """Remove the latest checkpoint; return whether there was one."""
        self.history = {"attempts": [], "resumes": []}
        return self._kept.drop_latest()

    def sweep(self) -> None:
        """Remove what a killed process left half written; only the holder of the run's lock may."""
        self._kept.sweep()

    def update(self, progress: Progress, attempt: Attempt, at_once: bool) -> None:
        """Take a checkpoint after an update if it is time, or to be kept, or asked for `at_once`.

        One that cannot be written is said, and tried again later: training goes on without it.
        """
        now = time.monotonic()
        if now < self._next and not at_once and progress.step not in self._kept.steps:
            return
        history = {**self.history, "attempts": [*self.history["attempts"], attempt.so_far(progress.step)]}
        try:
            data = encode(progress.checkpoint(), history, run_id=self._name)
            self._kept.write(file_name(progress.step, data), data)
        except UserError as error:
            self._say(f"no checkpoint at step {progress.step:,}: {error}")
        took = time.monotonic() - now
        self._next = now + took + max(self._seconds, WRITE_SHARE * took)

    def finish(self) -> None:
        """Remove the checkpoints that are not to be kept."""
        self._kept.finish()

    def _note_resume(self, step: int) -> None:
        """Keep in the history where this attempt goes on, and what has changed since."""
        changed = differences(self.history["attempts"][-1]["machine"]) if self.history["attempts"] else []
        self.history["resumes"].append({"step": step, "at": Attempt.now(), "differences": changed})
        self._say(f"goes on from step {step:,}")
        if changed:
            self._say(f"goes on with another {', '.join(changed)}: it may end with other bits")

    def _say(self, text: str) -> None:
        self._send("note", self._name, text=text)
