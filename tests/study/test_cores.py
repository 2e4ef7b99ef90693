"""How many cores a process may use, in a container and out of one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from pneuma.study import cores


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ("max 100000\n", 8), ("150000 100000\n", 2), ("50000 100000\n", 1), ("900000 100000\n", 8),
        ("what?", 8), ("1 0", 8), (None, 8),
    ],
)  # fmt: skip
def test_a_container_may_have_fewer_cores_than_its_machine(
    told: str | None, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if told is not None:
        (tmp_path / "cpu.max").write_text(told)
    monkeypatch.setattr(cores, "QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert cores.available_cores() == expected
