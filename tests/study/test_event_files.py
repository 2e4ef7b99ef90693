"""Event files: every scalar that is sound, and a word on each that is not."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pneuma.errors import UserError
from pneuma.study.event_files import Scalar, read_event_file

POINTS = [("rollout/ep_rew_mean", 256 * k, float(k)) for k in range(1, 6)]
SCALARS = [Scalar(*point) for point in POINTS]

WriteEvents = Callable[[Path, Any], Path]


@pytest.fixture
def data(tmp_path: Path, write_events: WriteEvents) -> bytes:
    return write_events(tmp_path / "events", POINTS).read_bytes()


def _records(data: bytes) -> list[int]:
    """Return where each record begins: a length of 8 bytes, 4 of checksum, the event, 4 of checksum."""
    places, place = [], 0
    while place < len(data):
        places.append(place)
        place += 8 + 4 + int(struct.unpack_from("<Q", data, place)[0]) + 4
    return places


def _flip(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


def test_every_scalar_is_read_in_order_with_the_time_it_took(data: bytes) -> None:
    found = read_event_file(data)
    assert (found.scalars, found.damage) == (SCALARS, [])
    assert (found.first_second, found.last_second) == (1e9, 1e9 + 4)


def test_an_empty_file_holds_nothing() -> None:
    found = read_event_file(b"")
    assert (found.scalars, found.damage, found.first_second) == ([], [], None)


def test_a_file_cut_anywhere_keeps_what_came_before(data: bytes) -> None:
    begins = [*_records(data), len(data)]
    for size in range(len(data)):
        found = read_event_file(data[:size])
        whole = sum(end <= size for end in begins[1:])  # the first record is the file's version
        assert found.scalars == SCALARS[: max(whole - 1, 0)]
        left = size - begins[whole]
        told = [f"it ends within an event: {left} bytes at the end are cut"] if left else []
        assert found.damage == told


def test_a_damaged_event_is_left_out_alone(data: bytes) -> None:
    second = _records(data)[2]
    found = read_event_file(_flip(data, second + 12 + 3))
    assert found.scalars == [SCALARS[0], *SCALARS[2:]]
    assert found.damage == [f"an event at byte {second} is damaged and left out"]


def test_after_a_damaged_length_nothing_can_be_read(data: bytes) -> None:
    third = _records(data)[3]
    found = read_event_file(_flip(data, third))
    assert found.scalars == SCALARS[:2]
    assert found.damage == [f"damaged at byte {third}: {len(data) - third} bytes from there on are cut"]


def test_a_flipped_bit_anywhere_is_told_and_gives_no_wrong_value(data: bytes) -> None:
    for place in range(len(data)):
        found = read_event_file(_flip(data, place))
        assert len(found.damage) == 1
        assert set(found.scalars) < set(SCALARS) or found.scalars == SCALARS  # the version's own record


def test_a_file_of_another_kind_is_told() -> None:
    found = read_event_file(b"step,return\n256,1.5\n")
    assert (found.scalars, found.damage) == ([], ["damaged at byte 0: 20 bytes from there on are cut"])


def test_what_is_no_number_is_passed_over(tmp_path: Path) -> None:
    """Texts, histograms and the like; a number may also lie in a tensor, as newer writers put it."""
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.summary.writer.record_writer import RecordWriter
    from tensorboard.util.tensor_util import make_tensor_proto

    event = Event(step=3)
    event.summary.value.add(tag="a").histo.num = 3
    for tag, plugin, held in (
        ("b", "text", "words"),
        ("c", "scalars", 1.5),
        ("d", "scalars", [1.5, 2]),
        ("e", "scalars", "x"),
    ):
        value = event.summary.value.add(tag=tag, tensor=make_tensor_proto(held))
        value.metadata.plugin_data.plugin_name = plugin
    with (tmp_path / "events").open("wb") as file:
        RecordWriter(file).write(event.SerializeToString())
    assert read_event_file((tmp_path / "events").read_bytes()).scalars == [Scalar("c", 3, 1.5)]


def test_an_array_is_passed_over_however_large_it_says_that_it_is(tmp_path: Path) -> None:
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.summary.writer.record_writer import RecordWriter

    event = Event(step=3)
    value = event.summary.value.add(tag="a")
    value.metadata.plugin_data.plugin_name = "scalars"
    value.tensor.dtype = 1
    value.tensor.float_val.append(1.5)
    value.tensor.tensor_shape.dim.add(size=10**14)
    with (tmp_path / "events").open("wb") as file:
        RecordWriter(file).write(event.SerializeToString())
    assert read_event_file((tmp_path / "events").read_bytes()).scalars == []


def test_without_the_package_the_extra_is_named(data: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorboard.compat.proto", None)
    with pytest.raises(UserError, match=r"pip install '.\[tensorboard\]'"):
        read_event_file(data)
