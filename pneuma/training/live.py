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


def open_log(folder: str | None, first_step: int) -> LiveLog:
    """Return the log of a run from where it starts or resumes; without a folder it writes nothing.

    Training goes on without it where there is no such folder, no tensorboard, or a full disk.
    """
    writer = None
    if folder:
        with suppress(OSError, ImportError):
            from torch.utils.tensorboard import SummaryWriter

            # replaces what was logged before a kill
            writer = SummaryWriter(folder, purge_step=first_step + 1)
    return LiveLog(writer, first_step)


class LiveLog:
    """A run's log.

    Args:
        writer: of TensorBoard; None to write nothing.
        first_step: the step from which the run starts or resumes.
    """

    def __init__(self, writer: Any, first_step: int) -> None:
        self._writer, self._first_step = writer, first_step
        self._written: dict[str, int] = {}

    def update(self, progress: Progress) -> None:
        """Write what an update added to the file, before a checkpoint that could be resumed from."""
        if not self._writer:
            return
        records = progress.records
        with suppress(OSError):
            for row in self._new("episodes", records.episodes):
                self._write(row["step"], {TAGS[name][1]: row[name] for name in LOGGED_BY_EPISODE})
            recent_episodes = records.episodes[-TRAILING_EPISODES:]
            if recent_episodes:
                self._write(progress.step, _trailing_means(recent_episodes))
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
        written = self._written.get(table, 0)
        self._written[table] = len(rows)
        return [row for row in rows[written:] if row["step"] > self._first_step]

    def _write(self, step: int, values: Mapping[str, float | None]) -> None:
        for tag, value in values.items():
            if value is not None and math.isfinite(value):
                self._writer.add_scalar(tag, value, step)


def _trailing_means(episodes: list[Row]) -> dict[str, float]:
    means = {}
    for name in LOGGED_BY_EPISODE:
        values = [row[name] for row in episodes]
        means[TAGS[name][0]] = sum(values) / len(values)
    return means


def _tagged(row: Row, group: str, tags: Mapping[str, str]) -> dict[str, Any]:
    """Return the values of a row by their tags; those without a tag of their own are called by the group."""
    tagged = {}
    for name, value in row.items():
        if name == "step":
            continue
        tag = tags.get(name, f"{group}/{name}")
        tagged[tag] = -value if tag == NEGATED else value
    return tagged
