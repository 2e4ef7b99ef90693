"""Where what Ray's nodes leave comes home: the driver's side of the store (`ray.py` sends and hears)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress

from pneuma.config import Run
from pneuma.errors import UserError
from pneuma.study.checkpoints import checkpoint_files, read_checkpoint
from pneuma.study.kept import KeptCheckpoints
from pneuma.study.store import Status, Store, run_document

Note = Callable[[str, str], None]
"""Told the id of a run and what a person should know of it."""


class Home:
    """The runs of a store that are trained elsewhere, for the process that holds their locks."""

    def __init__(self, store: Store, keep: int, note: Note) -> None:
        self._store = store
        self._keep = keep
        self._note = note

    def checkpoints(self, name: str, run: Run) -> list[tuple[str, str, bytes]]:
        """Return the latest whole checkpoint of a run, and that of its parent where it is a fork."""
        kept = self._kept(name, run)
        while (file := kept.latest) and read_checkpoint(file) is None:
            self._note(name, f"the checkpoint at step {file.step:,} is damaged: going on from the one before")
            kept.drop_latest()
        files = [(name, file)] if file else []
        if run.parent:
            parents = checkpoint_files(self._store.run_folder(run.parent))
            files += [(run.parent, each) for each in parents if each.step == run.fork_step]
        found = []
        for owner, each in files:
            with suppress(OSError):  # a parent's may go meanwhile, which the node then tells
                found.append((owner, each.path.name, each.path.read_bytes()))
        return found

    def take_checkpoint(self, name: str, run: Run, file: str, data: bytes) -> None:
        """Keep one; it takes the place of later ones, which its node has given up."""
        try:
            kept = self._kept(name, run)
            kept.drop_later_than(file)
            kept.write(file, data)
        except UserError as error:
            self._note(name, f"no checkpoint of it here: {error}")

    def take_end(self, name: str, run: Run, status: Status, files: Mapping[str, bytes]) -> None:
        """Store how a run ended.

        Raises:
            UserError: when that fails, or it ended without the files that make it a result.
        """
        if status.finished and not files:
            raise UserError(f"{name}: its node could not read what it had stored")
        if files:
            self._store.save_run(name, status, {**files, "run.json": run_document(run, name)})
        if status.finished:
            self._kept(name, run).finish()

    def save_killed(self, name: str, run: Run, reason: str) -> None:
        """Store that a run was killed; where that fails, its end is told all the same."""
        files = {"run.json": run_document(run, name), "error.txt": reason.encode()}
        with suppress(UserError):
            self._store.save_run(name, Status("killed"), files)

    def sweep(self, name: str, run: Run) -> None:
        """Remove what a killed process left half written."""
        self._kept(name, run).sweep()

    def _kept(self, name: str, run: Run) -> KeptCheckpoints:
        return KeptCheckpoints(self._store, name, run, self._keep)
