"""A checksum inside a file, over all its other bytes: published tables carry one in their metadata.

Whoever writes puts `NO_SUM` into the metadata and gives the file to `with_sum`; `is_whole` compares.
"""

from __future__ import annotations

import hashlib
import re

NO_SUM = "sha256:" + "0" * 64
"""Stands where the checksum goes."""

_SUM = re.compile(rb"sha256:([0-9a-f]{64})")


def with_sum(data: bytes) -> bytes:
    """Put the checksum over a file into the place that is kept for it there."""
    if data.count(NO_SUM.encode()) != 1 or len(_SUM.findall(data)) != 1:
        raise ValueError("the place of the checksum is not the only one of its look")
    return data.replace(NO_SUM.encode(), f"sha256:{_digest(data)}".encode())


def is_whole(data: bytes) -> bool:
    """Tell whether a file is what `with_sum` returned, to the bit."""
    sums = _SUM.findall(data)
    return len(sums) == 1 and _digest(_SUM.sub(NO_SUM.encode(), data)) == sums[0].decode()


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
