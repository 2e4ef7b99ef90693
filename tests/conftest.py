"""What tests of several folders share: TensorBoard logs written by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

Points = Sequence[tuple[str, int, float]]
WriteEvents = Callable[[Path, Points], Path]


@pytest.fixture(scope="session")
def write_events() -> WriteEvents:
    """A function that writes points (tag, step, value) as an event file, one a second, in their order."""
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.summary.writer.record_writer import RecordWriter

    def write(path: Path, points: Points) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            writer = RecordWriter(file)
            writer.write(Event(wall_time=1e9, file_version="brain.Event:2").SerializeToString())
            for second, (tag, step, value) in enumerate(points):
                event = Event(wall_time=1e9 + second, step=step)
                event.summary.value.add(tag=tag, simple_value=value)
                writer.write(event.SerializeToString())
            writer.flush()
        return path

    return write
