"""Interrupts are counted, wherever they come from and whoever takes them."""

from __future__ import annotations

import os
import select
import signal
import threading

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


def test_a_closed_terminal_is_one_interrupt_however_often_it_is_told() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored
    try:
        with Interrupts() as interrupts:
            for _ in range(3):
                signal.raise_signal(signal.SIGHUP)
            assert interrupts.count == 1
            signal.raise_signal(signal.SIGINT)
            assert interrupts.count == 2
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_closed_terminal_ends_nothing_where_it_is_to_be_ignored() -> None:
    """As under `nohup`."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Interrupts() as interrupts:
            signal.raise_signal(signal.SIGHUP)
            assert interrupts.count == 0
    finally:
        signal.signal(signal.SIGHUP, before)


def test_one_that_another_thread_takes_wakes_the_wait() -> None:
    # Like a thread of a mathematical library, it does not block what the main thread does.
    other = threading.Timer(0.2, os.kill, [os.getpid(), signal.SIGTERM])
    with Interrupts() as interrupts:
        other.start()
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
        try:
            assert select.select([interrupts.wakeup], [], [], 5)[0]
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
            other.join()
        interrupts.wake()
        assert interrupts.count == 1
