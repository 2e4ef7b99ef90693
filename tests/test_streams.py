"""Random streams: known hashes, and no two the same."""

from __future__ import annotations

import itertools

import pytest

from pneuma.config import stream_seed


@pytest.mark.parametrize(
    ("stream", "purpose", "slot", "expected"),
    [
        # printf '0/world/0' | sha256sum begins c0d6a0f53063ef94, least significant byte first:
        ("0", "world", 0, 0x94EF6330F5A0D6C0),
        # printf '7/evaluation/3' | sha256sum begins 975d2156f2a3acc8
        ("7", "evaluation", 3, 0xC8ACA3F256215D97),
    ],
)
def test_a_streams_seed_is_a_known_hash(stream: str, purpose: str, slot: int, expected: int) -> None:
    assert stream_seed(stream, purpose, slot) == expected


def test_no_two_streams_share_a_seed() -> None:
    purposes = ("world", "weights", "actions", "minibatches", "evaluation", "evaluation-actions")
    keys = list(itertools.product(map(str, range(50)), purposes, range(20)))
    seeds = {stream_seed(*key) for key in keys}
    assert len(seeds) == len(keys) == 50 * 6 * 20
    assert all(0 <= seed < 2**64 for seed in seeds)
