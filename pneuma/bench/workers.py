"""Two worker processes against one: what a study gains by a second core.

Each process trains small runs of the compiled engine on one thread, without evaluation. All are started and
have compiled before the clock runs; rounds with one and with two alternate.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from contextlib import ExitStack
from typing import Any

from pneuma.config import BASES, make_run
from pneuma.study.executors.local import one_thread_environment

CASE = "two workers over one"
ROUNDS = 5
STEPS = 25_600


def bench_workers() -> dict[str, Any]:
    """Return the steps a second of one worker and of two, and the median over rounds of their ratio."""
    with ExitStack() as stack:
        workers = [stack.enter_context(_Worker()) for _ in range(2)]
        rates: dict[int, list[float]] = {1: [], 2: []}
        for _ in range(ROUNDS):
            for count in rates:
                rates[count].append(_rate(workers[:count]))
    cases = [
        {"case": CASE, "engine": "batched", "workers": count, "steps_per_second": statistics.median(own)}
        for count, own in rates.items()
    ]
    return {"cases": cases, "ratio": statistics.median(b / a for a, b in zip(*rates.values(), strict=True))}


class _Worker:
    """A process that trains one run for every line it is sent, and answers when it is done."""

    def __enter__(self) -> _Worker:
        command = [sys.executable, "-m", "pneuma.bench.workers"]
        self._process = subprocess.Popen(
            command, env=one_thread_environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def begin(self) -> None:
        """Let it train."""
        assert self._process.stdin is not None
        self._process.stdin.write(b"\n")
        self._process.stdin.flush()

    def wait(self) -> None:
        """Wait until it is done.

        Raises:
            RuntimeError: when it has gone.
        """
        assert self._process.stdout is not None
        if not self._process.stdout.readline():
            raise RuntimeError("a worker of the benchmark ended before it was done")


def _rate(workers: list[_Worker]) -> float:
    begun = time.perf_counter()
    for worker in workers:
        worker.begin()
    for worker in workers:
        worker.wait()
    return len(workers) * STEPS / (time.perf_counter() - begun)


def _train(steps: int) -> None:
    from pneuma.engines import batched

    run = make_run({**BASES["table-6-2"], "engine": "batched", "steps": steps})
    batched.train_one(run, lambda progress: True, evaluated=False)
    print(flush=True)


if __name__ == "__main__":
    _train(512)  # compiles
    for _ in sys.stdin:
        _train(STEPS)
