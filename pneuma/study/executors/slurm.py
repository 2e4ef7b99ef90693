"""The Slurm executor: groups of runs are jobs of the university's queue, on a results folder that all share.

plan → groups → arrays of jobs (`slurm_desk.py`) → each trains its group on a node (`slurm_job.py`), and what
they tell is collected (`slurm_collector.py`); `slurm_queue.py` speaks with sbatch and squeue

The command only submits and collects. It can be left at any moment, and jobs go on; the same command finds
them by their names, submits none twice, and hands on what they tell.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from pneuma.config import Run
from pneuma.errors import UserError
from pneuma.study.executors import slurm_queue
from pneuma.study.executors.base import Detached, OnEvent, Place, Supervision
from pneuma.study.executors.slurm_collector import Collector
from pneuma.study.executors.slurm_desk import Desk, Group, alone
from pneuma.study.executors.submissions import open_submissions
from pneuma.study.store import Store

MOST_AT_ONCE = 256


def most_workers(place: Place) -> int:
    """Return how many jobs run at once where nobody says it: one a core of the partition."""
    slurm_queue.check_programs()
    slurm_queue.parameters("pneuma-check", dict(place.slurm), 1, False)  # what is wrong without asking
    return min(MOST_AT_ONCE, slurm_queue.total_cores(dict(place.slurm)))


def check(runs: Mapping[str, Run], supervision: Supervision) -> str:
    """Ask sbatch whether it would take the jobs of these runs."""
    slurm_queue.check_programs()
    for gpu in sorted({name in supervision.on_gpu for name in runs}):
        with TemporaryDirectory() as folder:
            slurm_queue.check_submission(Path(folder), dict(supervision.place.slurm), gpu)
    return ""


def run_groups(groups: Iterable[Group], store: Store, supervision: Supervision, on_event: OnEvent) -> None:
    """Train every group of runs in a job of its own, as the contract says (`base.Executor`).

    Raises:
        Detached: when the command is to be left, or after Ctrl-C; jobs go on.
        UserError: when jobs are refused.
    """
    wanted = list(groups)
    runs = {name: run for group in wanted for name, run in group.items()}
    if not runs:
        return _put_away(store, supervision)
    desk = Desk(store, supervision)
    collector = Collector(store, desk, runs, on_event)
    try:
        with alone(store):
            under_way = desk.under_way()
            fresh = [{name: run for name, run in own.items() if name not in under_way} for own in wanted]
            desk.submit([group for group in fresh if group], 1)
        if not supervision.place.detach:
            return collector.work()
        asked = True
    except KeyboardInterrupt:
        asked = False
    raise Detached(desk.farewell(runs), asked)


def _put_away(store: Store, supervision: Supervision) -> None:
    """Be done with submissions whose runs all came to the store while nobody waited for them."""
    with suppress(UserError):  # a queue that does not answer now is asked next time
        if open_submissions(store):
            with alone(store):
                Desk(store, supervision).under_way()
