"""TensorBoard's event files: the scalars in them, with damage told.

A file is a row of records: length (8 bytes), its checksum (4), an `Event`, its checksum (4). The
messages are read by the `tensorboard` package, an extra; the row is walked here, because its own
reader stops without a word at the first damaged record, and its EventAccumulator keeps a sample.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from pneuma.errors import UserError, install_extra

_LENGTH, _CHECKSUM = struct.Struct("<Q"), struct.Struct("<I")
_HEAD = _LENGTH.size + _CHECKSUM.size


@dataclass(frozen=True)
class Scalar:
    """One logged value; `step` is the logger's."""

    tag: str
    step: int
    value: float


@dataclass
class EventFile:
    """What an event file holds.

    Attributes:
        scalars: in the order in which they were written.
        damage: what of the file could not be read, in words; empty for a sound file.
        first_second, last_second: seconds since 1970 of the first and last event; None without any.
    """

    scalars: list[Scalar] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    first_second: float | None = None
    last_second: float | None = None


def read_event_file(data: bytes) -> EventFile:
    """Read every scalar of an event file.

    A damaged event is left out; where the length of one is damaged, or the file ends within one, the
    rest is. Both are told in `damage`.

    Raises:
        UserError: without the `tensorboard` package.
    """
    event_type, decode_error, scalar_of = _tensorboard()
    found = EventFile()
    for message in _records(data, found.damage):
        try:
            event = event_type.FromString(message)
        except decode_error:
            found.damage.append(f"an event of {len(message)} bytes that is none")
            continue
        if found.first_second is None:
            found.first_second = event.wall_time
        found.last_second = event.wall_time
        for value in event.summary.value:
            number = scalar_of(value)
            if number is not None:
                found.scalars.append(Scalar(value.tag, event.step, number))
    return found


def _records(data: bytes, damage: list[str]) -> Iterator[bytes]:
    """Yield the messages whose checksums hold."""
    from tensorboard.compat.tensorflow_stub.pywrap_tensorflow import masked_crc32c

    place, size = 0, len(data)
    while place < size:
        head = data[place : place + _HEAD]
        if len(head) < _HEAD:
            damage.append(f"it ends within an event: {size - place:,} bytes at the end are cut")
            return
        if _CHECKSUM.unpack(head[_LENGTH.size :])[0] != masked_crc32c(head[: _LENGTH.size]):
            damage.append(f"damaged at byte {place:,}: {size - place:,} bytes from there on are cut")
            return
        begin = place + _HEAD
        end = begin + _LENGTH.unpack(head[: _LENGTH.size])[0]
        if end + _CHECKSUM.size > size:
            damage.append(f"it ends within an event: {size - place:,} bytes at the end are cut")
            return
        message, check = data[begin:end], data[end : end + _CHECKSUM.size]
        if _CHECKSUM.unpack(check)[0] == masked_crc32c(message):
            yield message
        else:
            damage.append(f"an event at byte {place:,} is damaged and left out")
        place = end + _CHECKSUM.size


def _tensorboard() -> tuple[Any, type[Exception], Any]:
    """Return TensorBoard's event message, its error, and what reads the number of a summary's value."""
    try:
        from google.protobuf.message import DecodeError
        from tensorboard.compat.proto import event_pb2
        from tensorboard.util import tensor_util
    except ImportError:
        raise UserError(
            f"reading TensorBoard logs needs the tensorboard package: {install_extra('tensorboard')}"
        ) from None

    def scalar_of(value: Any) -> float | None:
        kind = value.WhichOneof("value")
        if kind == "simple_value":
            return float(value.simple_value)
        if kind == "tensor" and value.metadata.plugin_data.plugin_name == "scalars":
            if value.tensor.tensor_shape.dim:  # not made, however large it says that it is
                return None
            try:
                return float(tensor_util.make_ndarray(value.tensor))
            except (TypeError, ValueError):  # no number
                return None
        return None

    return event_pb2.Event, DecodeError, scalar_of
