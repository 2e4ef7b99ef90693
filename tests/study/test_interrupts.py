"""Interrupts that come from elsewhere, such as a driver's word to its node, come at any time."""

from __future__ import annotations

import os

import pytest

from pneuma.study.executors.interrupts import Interrupts


def test_one_that_comes_too_late_is_written_into_no_other_file() -> None:
    with Interrupts() as interrupts:
        ends = interrupts.wakeup, interrupts._other_end
    reader, writer = os.pipe()  # the system gives out the numbers that were let go of
    try:
        assert {reader, writer} == {*ends}
        os.set_blocking(reader, False)
        interrupts.interrupt()
        with pytest.raises(BlockingIOError):
            os.read(reader, 1)
    finally:
        os.close(reader)
        os.close(writer)
