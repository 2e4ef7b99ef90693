"""A TensorBoard log that is written while a run trains, with the tags of Stable-Baselines3 and CleanRL.

    records of an update → events in DIR/STUDY/CONDITION_SEED, beside what the run itself leaves

It reads the run's records and changes nothing. TensorBoard's writer has its own thread.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from pneuma.engines.loop import Progress
from pneuma.engines.records import Row
from pneuma.study.quantities import EVALUATION_TAGS, NEGATED, TAGS
from pneuma.study.series import TRAILING_EPISODES

LOGGED_BY_EPISODE = ("return", "length")
UPDATE_TAGS = {name: tag for name, (tag, _) in TAGS.items() if name not in LOGGED_BY_EPISODE}
"""Tags of some metrics; others are called train/COLUMN."""


class LiveLog:
    """Writes the log of one run, from the step where it starts or resumes."""

    def __init__(self, folder: str, first: int) -> None:
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog
        from tensorboard.summary.writer.event_file_writer import EventFileWriter

        self._event = Event
        self._writer = EventFileWriter(folder)
        self._first = first
        self._seen: dict[str, int] = {}
        started = SessionLog(status=SessionLog.START)  # replaces what was logged from here on before a kill
        self._writer.add_event(Event(wall_time=time.time(), step=first + 1, session_log=started))

    def update(self, progress: Progress) -> None:
        """Write what an update added to the file, before a checkpoint that could be resumed from."""
        records = progress.records
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
        self._writer.close()

    def _new(self, table: str, rows: list[Row]) -> list[Row]:
        """Return the rows of a table that this attempt added and that were not written yet."""
        seen, self._seen[table] = self._seen.get(table, 0), len(rows)
        return [row for row in rows[seen:] if row["step"] > self._first]

    def _write(self, step: int, values: Mapping[str, float | None]) -> None:
        event = self._event(wall_time=time.time(), step=step)
        for tag, value in values.items():
            if value is not None and math.isfinite(value):
                event.summary.value.add(tag=tag, simple_value=value)
        if event.summary.value:
            self._writer.add_event(event)


def _tagged(row: Row, group: str, tags: Mapping[str, str]) -> dict[str, Any]:
    values = {tags.get(name, f"{group}/{name}"): value for name, value in row.items() if name != "step"}
    return {tag: -value if tag == NEGATED else value for tag, value in values.items()}
