"""Messages of Godot RL Agents' protocol: JSON behind its length in four bytes, little-endian, over TCP.

The other end may be anybody's program. What it sends is read by these functions, with errors of one line.
"""

from __future__ import annotations

import json
import reprlib
import socket
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from pneuma.files import parse_json

MOST_BYTES = 64 * 2**20
"""Most bytes of a message."""
LARGEST = float(np.finfo(np.float32).max)
UNREADABLE = (LookupError, TypeError, ValueError, AttributeError)
"""What reading a message raises if it is not as the protocol says."""


def send(connection: socket.socket, message: Mapping[str, Any]) -> None:
    """Send one message.

    Raises:
        OSError: when the other end has gone or does not read.
        ValueError: for a number that JSON has not, such as NaN, and for too long a message.
    """
    data = json.dumps(message, allow_nan=False).encode()
    if len(data) > MOST_BYTES:
        raise ValueError(f"a message of {len(data):,} bytes; the most is {MOST_BYTES:,}")
    connection.sendall(len(data).to_bytes(4, "little") + data)


def receive(connection: socket.socket, seconds: float) -> dict[str, Any]:
    """Return the next message, which must be there, as a whole, within some seconds.

    Raises:
        EOFError: when the other end has closed.
        TimeoutError: when the time is over.
        ValueError: for an invalid message.
    """
    until = time.monotonic() + seconds
    size = int.from_bytes(_exactly(connection, 4, until), "little")
    if size > MOST_BYTES:
        raise ValueError(f"a message of {size:,} bytes; the most is {MOST_BYTES:,}")
    return parse_json(bytes(_exactly(connection, size, until)))


def _exactly(connection: socket.socket, size: int, until: float) -> bytearray:
    parts = bytearray()
    while len(parts) < size:
        if (left := until - time.monotonic()) <= 0:
            raise TimeoutError
        connection.settimeout(left)
        part = connection.recv(min(size - len(parts), 1 << 16))
        if not part:
            raise EOFError
        parts += part
    return parts


# --- What is in a message --------------------------------------------------------------------------


def number(sent: object, low: float = -LARGEST, high: float = LARGEST) -> float:
    """Return a number from `low` to `high`; ValueError for anything else, also true, "1" and NaN."""
    if type(sent) not in (int, float) or not low <= sent <= high:  # type: ignore[operator]
        raise ValueError(f"{reprlib.repr(sent)} is no number from {low:g} to {high:g}")
    return float(sent)  # type: ignore[arg-type]


def whole(sent: object, low: int, high: int) -> int:
    """Return a whole number, which some languages' JSON writes as 3.0; errors are those of `number`."""
    if (value := number(sent, low, high)) % 1:
        raise ValueError(f"{value:g} is no whole number")
    return int(value)


def flag(sent: object) -> bool:
    """Return true or false, which older games send as 1 or 0; errors are those of `number`."""
    return sent if isinstance(sent, bool) else bool(whole(sent, 0, 1))


def numbers(sent: object, size: int) -> np.ndarray:
    """Return a list of `size` numbers as (size,) float32; errors are those of `number`."""
    values = sent if isinstance(sent, list) else [sent]
    if len(values) != size:
        raise ValueError(f"{len(values):,} numbers where {size:,} belong")
    return np.array([number(value) for value in values], np.float32)
