"""The local executor: one fresh process for each group of runs, a few at a time.

A process of its own can be killed alone and shares no state with its neighbours. It is pinned to
one thread, so that workers do not fight over cores and results do not depend on their number.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from pneuma.config import Run
from pneuma.study.executors.base import OnEvent, Supervision
from pneuma.study.executors.supervisor import Death, Interrupts, Supervisor
from pneuma.study.provenance import available_cores, machine
from pneuma.study.store import Store

SOURCE = str(Path(__file__).parents[3])
"""On the path of children even where Pneuma is not installed."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def one_thread_environment() -> dict[str, str]:
    """Return environment variables for a child that computes on one thread and imports this code."""
    path = os.pathsep.join(filter(None, [SOURCE, os.environ.get("PYTHONPATH", "")]))
    own = {
        "NPROC": "1",  # the size of XLA's pool of threads; its flags alone no longer hold that
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1 "
        "--xla_gpu_deterministic_ops=true",
        "JAX_DEFAULT_MATMUL_PRECISION": "highest",  # float32 on a GPU too, whose default is less
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # workers share a GPU
        "JAX_COMPILATION_CACHE_DIR": str(_cache() / "jax"),  # compiled once for all workers
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "PYTHONPATH": path,
    }
    return {**os.environ, **dict.fromkeys(_ONE_THREAD, "1"), **own}


def prepare_node(gpu: bool = False) -> None:
    """Make this process, on a node of a cluster, fit to start workers.

    Compiled programs are kept apart by processor: nodes differ, and often share a home. GPUs are hidden
    where none was asked for, which neither Ray nor every Slurm does.
    """
    processor = hashlib.sha256(machine()["cpu"].encode()).hexdigest()[:8]
    os.environ["XDG_CACHE_HOME"] = str(_cache() / "nodes" / processor)
    if not gpu:
        os.environ["CUDA_VISIBLE_DEVICES"] = ""


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pneuma"


def most_workers(how: Supervision) -> int:
    """Return how many runs may train at once where nobody says it: one a core."""
    return available_cores()


def run_groups(
    groups: Iterable[Mapping[str, Run]], store: Store, how: Supervision, on_event: OnEvent
) -> None:
    """Train every group of runs in a process of its own, as the contract says (`base.Executor`).

    Raises:
        KeyboardInterrupt: after Ctrl-C, when every worker has gone.
    """
    with Interrupts() as interrupts:
        Supervisor(groups, store, how, on_event, interrupts, LocalProcess).work()
        if interrupts.count:
            raise KeyboardInterrupt


class LocalProcess:
    """A worker's process on this machine, in a session of its own: Ctrl-C reaches its parent alone."""

    def __init__(self, job: Mapping[str, Any]) -> None:
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed when the process is buried)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "pneuma.study.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=one_thread_environment(),
            start_new_session=True,
            bufsize=0,
        )
        self._tell(json.dumps({**job, "parent": os.getpid()}))

    @property
    def events(self) -> IO[bytes]:
        """Its lines."""
        assert self._process.stdout is not None
        return self._process.stdout

    def ask_to_stop(self) -> None:
        """Let it come to a checkpoint and end."""
        self._tell("stop")

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def bury(self) -> Death:
        """Wait until it has gone, let go of its files and return how it ended."""
        code = self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        self._errors.seek(0)
        with self._errors:
            return Death(code < 0, f"the worker process {_reason(code)}", self._errors.read())

    def _tell(self, line: str) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it is gone already: reading from it will tell
            self._process.stdin.write(line.encode() + b"\n")


def _reason(code: int) -> str:
    if code >= 0:
        return f"ended with code {code}"
    name = signal.Signals(-code).name
    hint = " (by hand, or by the system when memory ran out)" if name == "SIGKILL" else ""
    return f"was killed by {name}{hint}"
