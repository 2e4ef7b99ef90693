"""Which checkpoints of a run lie in its folder: the latest two while it trains, and those kept for forks."""

from __future__ import annotations

from pneuma.config import Run
from pneuma.engines.base import checkpoint_steps
from pneuma.study.checkpoints import FOLDER, CheckpointFile, checkpoint_files, outdated
from pneuma.study.store import Status, Store


class KeptCheckpoints:
    """The checkpoints of one run, for whoever holds its lock.

    Attributes:
        steps: at which checkpoints are kept when the run has ended.
    """

    def __init__(self, store: Store, name: str, run: Run, keep: int) -> None:
        self.steps = checkpoint_steps(run, keep)
        self._store = store
        self._folder = store.run_folder(name)
        self._files = checkpoint_files(self._folder)

    @property
    def latest(self) -> CheckpointFile | None:
        """The latest one, whole or not."""
        return self._files[0] if self._files else None

    def drop_latest(self) -> bool:
        """Remove the latest one; return whether there was one."""
        had_one = bool(self._files)
        self._remove(self._files[:1])
        return had_one

    def write(self, file_name: str, data: bytes) -> None:
        """Add one, and remove those that nobody needs any more.

        Raises:
            UserError: when it cannot be written.
        """
        self._store.write(self._folder / FOLDER / file_name, data)
        self._files = checkpoint_files(self._folder)
        self._remove(outdated(self._files, self.steps))

    def sweep(self) -> None:
        """Remove what a killed process left half written."""
        for path in (*self._folder.glob(".*.*"), *(self._folder / FOLDER).glob(".*.*")):
            path.unlink(missing_ok=True)

    def finish(self) -> None:
        """Remove those that are not kept when the run has ended."""
        self._remove([file for file in self._files if file.step not in self.steps])
        folder = self._folder / FOLDER
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()

    def _remove(self, files: list[CheckpointFile]) -> None:
        for file in files:
            file.path.unlink(missing_ok=True)
        self._files = [file for file in self._files if file not in files]


def lacks_checkpoints(store: Store, name: str, run: Run, status: Status, keep: int) -> bool:
    """Tell whether a checkpoint to keep is not there, though the run has come further."""
    there = {file.step for file in checkpoint_files(store.run_folder(name))}
    reached = status.step if status.finished else max(there, default=0)
    return any(step < reached and step not in there for step in checkpoint_steps(run, keep))
