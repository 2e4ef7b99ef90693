"""A TensorBoard log that is written while a run trains, with the tags of Stable-Baselines3 and CleanRL.

    records of an update → events in DIR/STUDY/CONDITION_SEED, beside what the run itself leaves

It reads the run's records and changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pneuma.engines.loop import Progress
from pneuma.engines.records import Row
from pneuma.store.quantities import EVALUATION_TAGS, NEGATED, TAGS
from pneuma.store.series import TRAILING_EPISODES

LOGGED_BY_EPISODE = ("return", "length")
UPDATE_TAGS = {name: tag for name, (tag, _) in TAGS.items() if name not in LOGGED_BY_EPISODE}


def open_log(folder: str | None, first: int) -> LiveLog:
    """Return the log of a run from where it starts or resumes; without a folder it writes nothing.

    Training goes on without it where there is no such folder, no tensorboard, or a full disk.
    """
    writer = None
    if folder:
        with suppress(OSError, ImportError):
            from torch.utils.tensorboard import SummaryWriter

            writer = SummaryWriter(folder, purge_step=first + 1)  # replaces what was logged before a kill
    return LiveLog(writer, first)


class LiveLog:
    def __init__(self, writer: Any, first: int) -> None:
        self._writer, self._first = writer, first
        self._seen: dict[str, int] = {}

    def update(self, progress: Progress) -> None:
        """Write what an update added to the file, before a checkpoint that could be resumed from."""
        if not self._writer:
            return
        records = progress.records
        with suppress(OSError):
            for row in self._new("episodes", records.episodes):
                self._write(row["step"], {TAGS[name][1]: row[name] for name in LOGGED_BY_EPISODE})
            if recent := records.episodes[-TRAILING_EPISODES:]:
                means = {name: sum(row[name] for row in recent) / len(recent) for name in LOGGED_BY_EPISODE}
                self._write(progress.step, {TAGS[name][0]: mean for name, mean in means.items()})
            for row in self._new("metrics", records.metrics):
                self._write(row["step"], _tagged(row, "train", UPDATE_TAGS))
            for row in self._new("evaluations", records.evaluations):
                self._write(row["step"], _tagged(row, "eval", EVALUATION_TAGS))
            self._writer.flush()

    def close(self) -> None:
        if self._writer:
            with suppress(OSError):
                self._writer.close()

    def _new(self, table: str, rows: list[Row]) -> list[Row]:
        """Return the rows of a table that this attempt added and that were not written yet."""
        seen, self._seen[table] = self._seen.get(table, 0), len(rows)
        return [row for row in rows[seen:] if row["step"] > self._first]

    def _write(self, step: int, values: Mapping[str, float | None]) -> None:
        for tag, value in values.items():
            if value is not None and math.isfinite(value):
                self._writer.add_scalar(tag, value, step)


def _tagged(row: Row, group: str, tags: Mapping[str, str]) -> dict[str, Any]:
    values = {tags.get(name, f"{group}/{name}"): value for name, value in row.items() if name != "step"}
    return {tag: -value if tag == NEGATED else value for tag, value in values.items()}
