"""A TensorBoard log that is written while a run trains, with the tags of Stable-Baselines3 and CleanRL.

records of an update → events in DIR/STUDY/CONDITION_SEED
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from pneuma.engines.loop import Progress
from pneuma.engines.records import Row
from pneuma.store.quantities import EVALUATION_TAGS, LOGGED_BY_EPISODE, NEGATED, TAGS
from pneuma.store.series import TRAILING_EPISODES

MEAN_TAGS = {quantity: TAGS[quantity][0] for quantity in LOGGED_BY_EPISODE}
TAGS_BY_TABLE = {
    "episodes": {quantity: TAGS[quantity][1] for quantity in LOGGED_BY_EPISODE},
    "metrics": {quantity: tag for quantity, (tag, _) in TAGS.items() if quantity not in LOGGED_BY_EPISODE},
    "evaluations": EVALUATION_TAGS,
}
GROUPS = {"metrics": "train", "evaluations": "eval"}
"""The prefix of columns without a tag; such columns of episodes are not logged."""


def open_log(folder: str | None, first_step: int) -> LiveLog:
    """Return the log of a run that starts or resumes; without a folder it writes nothing.

    It writes nothing either if the folder cannot be written, or TensorBoard is not installed.
    """
    writer = None
    if folder:
        with suppress(OSError, ImportError):
            from torch.utils.tensorboard import SummaryWriter

            # points after this step, which were logged before a kill, are replaced
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
        """Write the records that an update added, before the update's checkpoint."""
        if not self._writer:
            return
        with suppress(OSError):
            for table_name, tags in TAGS_BY_TABLE.items():
                table_rows = getattr(progress.records, table_name)
                for row in table_rows[self._written.get(table_name, 0) :]:
                    if row["step"] > self._first_step:
                        self._write(table_name, row, tags)
                self._written[table_name] = len(table_rows)
            recent_episodes = progress.records.episodes[-TRAILING_EPISODES:]
            if recent_episodes:
                means = {"step": progress.step}
                for quantity in LOGGED_BY_EPISODE:
                    means[quantity] = sum(row[quantity] for row in recent_episodes) / len(recent_episodes)
                self._write("episodes", means, MEAN_TAGS)
            self._writer.flush()

    def close(self) -> None:
        if self._writer:
            with suppress(OSError):
                self._writer.close()

    def _write(self, table_name: str, row: Row, tags: Mapping[str, str]) -> None:
        """Write the finite values of a row by their tags."""
        for column_name, column_value in row.items():
            tag = tags.get(column_name)
            if tag is None and table_name in GROUPS and column_name != "step":
                tag = f"{GROUPS[table_name]}/{column_name}"
            if tag and column_value is not None and math.isfinite(column_value):
                self._writer.add_scalar(tag, -column_value if tag == NEGATED else column_value, row["step"])
