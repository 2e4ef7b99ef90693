"""The local executor: a few worker processes, each of which gets one run after another.

    runs → `Supervisor` → processes of `pneuma.training.worker` → store
                        ← their events

If a worker is killed, only the run that it trains is affected, and the next run starts in a new process. A
worker uses one thread, so that workers do not compete for cores and results do not depend on their number.
Runs that crash are tried once more, runs that another process trains are waited for, and after Ctrl-C every
run stops at a checkpoint. The Ray executor uses the same `Supervisor` on each node.
"""

from __future__ import annotations

import hashlib
import math
import os
import resource
import selectors
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Any

from pneuma.config import Run
from pneuma.errors import StorageError, UserError, print_aside
from pneuma.files import parse_json
from pneuma.store.locks import LOCK_FILE, is_held
from pneuma.store.provenance import SOURCE, available_cores, machine
from pneuma.store.store import LARGEST_ERROR
from pneuma.training.executors.base import Event, ExecutorConfig, Job, OnEvent, end_event

TRIES = 2
_told_waits: set[Path] = set()
"""Locks for which this process has said that it waits: a search would say it at each of its pauses."""
MOST_PRINTED = 2**20
"""Bytes that a run may print before the disk is freed of them."""
LOOK_SECONDS = 0.5
"""Seconds between two checks of signals, and of runs that other processes hold. A signal does not interrupt
the wait for events if the kernel delivers it to a thread of a mathematical library."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PATIENCE = 5.0
"""Seconds that runs have to stop at a checkpoint after a SIGTERM."""
PASSED_VARIABLES = (
    "PATH", "HOME", "USER", "LOGNAME", "SHELL", "LANG", "TZ", "TMPDIR", "VIRTUAL_ENV", "CONDA_PREFIX",
    "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX",
    "DISPLAY", "WAYLAND_DISPLAY", "XAUTHORITY", "MUJOCO_GL", "PYOPENGL_PLATFORM",
    "CUDA_VISIBLE_DEVICES", "CUDA_DEVICE_ORDER", "NVIDIA_VISIBLE_DEVICES", "NUMBA_CACHE_DIR",
)  # fmt: skip
"""The shell's variables that workers get: they name folders and devices, and do not change numbers."""
PASSED_PREFIXES = ("LC_", "XDG_", "SDL_", "PNEUMA_")
ALSO_PASSED = "PNEUMA_PASS"
"""A variable with the names of others that the user's own code reads, separated by commas."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def most_workers(config: ExecutorConfig) -> int:
    return available_cores()


def train_runs(job: Job, on_event: OnEvent) -> None:
    """Train runs in processes of this machine; see `base`."""
    with Interrupts() as interrupts:
        Supervisor(job, on_event, interrupts).work()
        if interrupts.count:
            raise KeyboardInterrupt


# --- Signals --------------------------------------------------------------------------------------


class Interrupts:
    """Collects signals within a `with` block instead of letting them end it; only in the main thread.

    A SIGTERM, which a shutdown or a queue sends, counts as a second one `PATIENCE` seconds later. SIGHUP
    counts once, because the shell of a closed terminal sends it again.
    """

    def __init__(self, signals: Iterable[int] = SIGNALS) -> None:
        self._signals = signals
        self._seen: list[int] = []
        self._handlers_before: dict[int, Any] = {}
        self._patience_ends = math.inf

    @property
    def count(self) -> int:
        signals = len(self._seen)
        if time.monotonic() > self._patience_ends:
            signals += 1
        return min(signals, 2)

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for signal_number in self._signals:
                # a signal that is ignored stays ignored: `nohup` ignores SIGHUP
                if signal.getsignal(signal_number) != signal.SIG_IGN:
                    self._handlers_before[signal_number] = signal.signal(signal_number, self._note)
        return self

    def __exit__(self, *_: object) -> None:
        for signal_number, handler in self._handlers_before.items():
            signal.signal(signal_number, handler)

    def _note(self, signal_number: int, frame: FrameType | None) -> None:
        if signal_number != signal.SIGHUP or not self._seen:
            self._seen.append(signal_number)
        if signal_number == signal.SIGTERM:
            self._patience_ends = min(self._patience_ends, time.monotonic() + PATIENCE)


def print_stopping() -> None:
    print_aside("Stopping after this step. Press Ctrl-C again to stop at once.")


# --- Supervision ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Task:
    """A run to train, the number of the attempt, and whether another process trains it."""

    name: str
    run: Run
    tries: int = 1
    is_busy: bool = False


class Supervisor:
    """Keeps the `config.workers` workers of a job busy until all runs have ended.

    After the first of `interrupts` every run stops at a checkpoint; after the second all stop at once.
    """

    def __init__(self, job: Job, on_event: OnEvent, interrupts: Interrupts) -> None:
        self._tasks = [_Task(run_id, run) for run_id, run in job.runs.items()]
        self._job, self._store, self._on_event = job, job.store, on_event
        self._interrupts, self._sent_level = interrupts, 0
        self._storage_problem = ""
        self._selector = selectors.DefaultSelector()

    def work(self) -> None:
        """Train the runs.

        Raises:
            StorageError: if the disk is full, when all runs have stopped at a checkpoint.
        """
        try:
            while self._tasks or self._workers():
                self._hand_out_tasks()
                self._selector.select(LOOK_SECONDS)
                for worker in self._workers():
                    self._look_after(worker)
                self._send_stop()
        finally:
            for worker in self._workers():
                worker.kill()
                worker.end_and_read_stderr()
            self._selector.close()
        if self._storage_problem:
            raise StorageError(self._storage_problem)

    def _workers(self) -> list[_Worker]:
        return [selector_key.data for selector_key in self._selector.get_map().values()]

    def _stop_level(self) -> int:
        """Return 0 to continue, 1 to stop every run at a checkpoint, 2 to stop all at once."""
        if self._storage_problem:
            return max(self._interrupts.count, 1)
        return self._interrupts.count

    def _send_stop(self) -> None:
        level = self._stop_level()
        if level == self._sent_level:
            return
        if self._sent_level == 0 and not self._storage_problem:
            print_stopping()
        self._sent_level = level
        self._tasks.clear()
        for worker in self._workers():
            if level > 1:
                worker.kill()
            else:
                worker.send("stop")

    def _hand_out_tasks(self) -> None:
        """Give waiting runs to idle or new workers; end the workers that get none."""
        workers = self._workers()
        idle_workers = [worker for worker in workers if worker.task is None]
        free_places = self._job.config.workers - len(workers)
        for task in list(self._tasks):
            if task.is_busy and is_held(self._store.run_folder(task.name)):
                continue
            if not idle_workers:
                if free_places <= 0:
                    return
                free_places -= 1
                worker = _Worker()
                self._selector.register(worker.events, selectors.EVENT_READ, worker)
                idle_workers.append(worker)
            self._tasks.remove(task)
            job = replace(self._job, runs={task.name: task.run}, last_try=task.tries == TRIES)
            idle_workers.pop().begin(task, job)
        if not self._tasks:
            for worker in idle_workers:
                worker.dismiss()

    def _look_after(self, worker: _Worker) -> None:
        """Read a worker's events, and find whether it has ended.

        Its end is also that of its process: a process that its environment made by `fork` may have its pipe
        of events and keep it open.
        """
        has_ended = worker.poll() is not None
        event_lines, is_closed = worker.read_lines()
        for event_line in event_lines:
            self._read(worker, event_line)
        if has_ended or is_closed:
            self._selector.unregister(worker.events)
            self._reap(worker)
            return
        worker.free_disk()
        if time.monotonic() > worker.end_time:
            worker.kill()

    def _read(self, worker: _Worker, event_line: bytes) -> None:
        task = worker.task
        try:
            event = parse_json(event_line)
        except ValueError:
            return  # a library printed this while it was loaded
        assert task is not None
        event_name = event["event"]
        if event.get("storage"):
            self._storage_problem = str(event["reason"])
        if event.get("status") == "crashed":
            worker.crash = event
            worker.dismiss()
            return
        if event_name == "busy":
            lock_path = self._store.run_folder(task.name).resolve() / LOCK_FILE
            if lock_path not in _told_waits:
                _told_waits.add(lock_path)
                self._note(task, f"another process trains this run; waiting for it to let go of {lock_path}")
            if self._stop_level() == 0:
                self._tasks.append(replace(task, is_busy=True))
        else:
            self._on_event(event)
        if event_name in ("busy", "end"):
            worker.end_task()

    def _reap(self, worker: _Worker) -> None:
        """Clean up after a worker, and try the run that was lost with it once more, or store its end."""
        exit_code, error_output = worker.end_and_read_stderr()
        task, crash, is_stopping = worker.task, worker.crash, self._stop_level() > 0
        if task is None:
            return
        if crash and (is_stopping or task.tries == TRIES or crash.get("final")):
            self._on_event(crash)
        elif is_stopping:
            self._on_event(end_event(task.name, "stopped"))
        elif task.tries < TRIES:
            reason = f"crashed ({crash['reason']})" if crash else _reason(exit_code)
            self._tasks.append(replace(task, tries=task.tries + 1))
            self._note(task, f"{reason}; tried once more")
        else:
            self._end_lost(task, exit_code, error_output)

    def _end_lost(self, task: _Task, exit_code: int, error_output: bytes) -> None:
        """Store and report the end of a run whose worker died; store nothing if another process trains it."""
        status, reason_texts = "crashed", [_reason(exit_code), error_output.decode(errors="replace")]
        if exit_code < 0:
            status = "killed"
            reason_texts.reverse()  # the last line is shown to users
        try:
            with self._store.lock(task.name) as is_free:
                if is_free:
                    self._store.save_failure(task.name, task.run, status, "\n".join(reason_texts))
        except StorageError as error:
            self._storage_problem = str(error)
        except UserError as error:
            self._note(task, str(error))
        self._on_event(end_event(task.name, status))

    def _note(self, task: _Task, message: str) -> None:
        self._on_event({"event": "note", "run_id": task.name, "text": message})


def _reason(exit_code: int) -> str:
    if exit_code >= 0:
        return f"the worker process ended with code {exit_code}"
    reason = f"the worker process was killed by {signal.Signals(-exit_code).name}"
    memory_limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if exit_code == -signal.SIGKILL:
        reason += " (by hand, or by the system when memory ran out)"
    elif memory_limit != resource.RLIM_INFINITY:  # many libraries do not survive a request that is refused
        reason += f" (perhaps because memory ran out: its limit is {memory_limit / 2**30:.1f} GiB)"
    return reason


# --- Workers --------------------------------------------------------------------------------------


class _Worker(subprocess.Popen[bytes]):
    """A worker process. It has its own session, so that Ctrl-C reaches only its parent.

    Processes that a user's environment starts there belong to its group, and end with it.

    Attributes:
        task: the run that it trains; None while it is idle.
        crash: the event of its run's crash, after which it ends.
        orders: its standard input.
        events: its standard output.
        end_time: when a worker that should end by itself is killed.
    """

    def __init__(self) -> None:
        self.task: _Task | None = None
        self.crash: Event | None = None
        self.end_time = math.inf
        self._unread = b""
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (`end_and_read_stderr` closes it)
        self._errors_start, self._last_errors = 0, b""
        # The worker starts with this mask, until it handles SIGTERM itself.
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
        try:
            super().__init__(
                [sys.executable, "-P", "-m", "pneuma.training.worker", str(os.getpid())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env=worker_environment(),
                start_new_session=True,
                bufsize=0,
            )
        finally:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
        assert self.stdin is not None and self.stdout is not None
        self.orders, self.events = self.stdin, self.stdout
        os.set_blocking(self.events.fileno(), False)

    def begin(self, task: _Task, job: Job) -> None:
        self.task = task
        self.send(job.to_json())

    def end_task(self) -> None:
        self.task = None
        self._errors_start, self._last_errors = os.fstat(self._errors.fileno()).st_size, b""

    def free_disk(self) -> None:
        """Remove what its run has printed, if that is much, except its last part."""
        printed_bytes = os.fstat(self._errors.fileno()).st_size
        if printed_bytes - self._errors_start > MOST_PRINTED:
            self._last_errors = self._read_errors(printed_bytes)
            os.ftruncate(self._errors.fileno(), 0)
            os.ftruncate(self._errors.fileno(), printed_bytes)  # a hole, behind which the worker goes on
            self._errors_start = printed_bytes

    def _read_errors(self, printed_bytes: int) -> bytes:
        """Return the last part of what its run has printed, without moving the place where it writes."""
        first_byte = max(self._errors_start, printed_bytes - LARGEST_ERROR)
        new_errors = os.pread(self._errors.fileno(), printed_bytes - first_byte, first_byte)
        return (self._last_errors + new_errors)[-LARGEST_ERROR:]

    def send(self, order: str) -> None:
        unsent_bytes = order.encode() + b"\n"
        # a worker that has ended is found when it is read from
        with suppress(BrokenPipeError, ValueError):
            while unsent_bytes:  # a signal may come in between
                unsent_bytes = unsent_bytes[self.orders.write(unsent_bytes) :]

    def dismiss(self) -> None:
        """Let it end, for which it has `PATIENCE`: Python waits at its end for processes that do not end."""
        if not self.orders.closed:
            self.orders.close()
            self.end_time = time.monotonic() + PATIENCE

    def read_lines(self) -> tuple[list[bytes], bool]:
        """Return what it has printed, without waiting for more, and whether its pipe is closed."""
        is_closed = False
        while not is_closed:
            printed_bytes: Any = self.events.read(2**16)
            if printed_bytes is None:  # there is no more yet
                break
            is_closed = not printed_bytes
            self._unread += printed_bytes
        *lines, self._unread = self._unread.split(b"\n")
        return lines, is_closed

    def kill(self) -> None:
        """Kill it, and the processes that were started in it."""
        with suppress(ProcessLookupError, PermissionError):  # macOS: if none is left but zombies
            os.killpg(self.pid, signal.SIGKILL)

    def end_and_read_stderr(self) -> tuple[int, bytes]:
        """Wait for its end, kill what it leaves; return its exit code, and its errors since its last run."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(PATIENCE)
        self.kill()
        exit_code = self.wait()
        self.orders.close()
        self.events.close()
        with self._errors:
            return exit_code, self._read_errors(os.fstat(self._errors.fileno()).st_size)


def worker_environment() -> dict[str, str]:
    """Return environment variables for a process that imports this code and computes on one thread.

    Of the shell's variables it gets only those that do not change numbers, and those that the user names.
    """
    import_path = str(SOURCE)
    if os.environ.get("PYTHONPATH"):
        import_path += os.pathsep + os.environ["PYTHONPATH"]
    fixed_variables = {
        "PYTHONHASHSEED": "0",  # a user's own code may iterate over sets
        "PYTHONPATH": import_path,
    }
    passed_names = {*PASSED_VARIABLES, *os.environ.get(ALSO_PASSED, "").split(",")}
    passed_variables = {}
    for variable, variable_value in os.environ.items():
        if variable in passed_names or variable.startswith(PASSED_PREFIXES):
            passed_variables[variable] = variable_value
    if not _is_byte_code_kept():
        passed_variables.pop("PYTHONDONTWRITEBYTECODE", None)
        fixed_variables["PYTHONPYCACHEPREFIX"] = str(_cache() / "bytecode")
    return {**passed_variables, **dict.fromkeys(_ONE_THREAD, "1"), **fixed_variables}


def _is_byte_code_kept() -> bool:
    """Return whether installed modules have byte code; without it a worker takes twice as long to start.

    Containers often have none, and their folders of packages may be read-only.
    """
    numpy_spec = find_spec("numpy")
    return numpy_spec is None or numpy_spec.cached is None or Path(numpy_spec.cached).is_file()


def prepare_node() -> None:
    """Prepare this process, on a node of a cluster, to start workers on its CPUs.

    Compiled programs are cached by processor, because nodes differ and may share a home folder.
    """
    processor = hashlib.sha256(machine()["cpu"].encode()).hexdigest()[:8]
    os.environ["XDG_CACHE_HOME"] = str(_cache() / "nodes" / processor)
    os.environ["CUDA_VISIBLE_DEVICES"] = ""


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "pneuma"
