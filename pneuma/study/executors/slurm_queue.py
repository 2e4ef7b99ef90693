"""Slurm's queue: what a job asks for, sbatch by way of submitit, and squeue.

Every call but that of sbatch is over within `ANSWER_SECONDS`, whatever the controller does, and what goes
wrong is one line.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, install_extra, nearest_name
from pneuma.study.executors.slurm_job import Training
from pneuma.study.executors.submissions import Submission

ELSEWHERE = "use it on a machine of the cluster, such as its login node; --executor local trains here"

ANSWER_SECONDS = 8.0
USUAL_MINUTES = 60
"""A job's time where nobody says it; when it is over, the job goes back to the queue with a checkpoint."""
MOST_REQUEUES = 10_000
"""submitit asks for a limit; a job that gets nowhere in its time ends by itself (`slurm_job`)."""
PROGRAMS = ("sbatch", "squeue", "srun", "scontrol")
ENDED = (
    "BOOT_FAIL", "CANCELLED", "COMPLETED", "DEADLINE", "FAILED", "NODE_FAIL", "OUT_OF_MEMORY", "PREEMPTED",
    "REVOKED", "TIMEOUT",
)  # fmt: skip
"""States of jobs that will not run again (squeue(1), JOB STATE CODES)."""
NEVER = re.compile(
    r"\((Partition(TimeLimit|NodeLimit|Config)|BadConstraints|(Account|QOS)NotAllowed|"
    r"Invalid(Account|QOS)|\w+PerJob(Limit)?)\)"
)
"""Reasons for which a job waits that waiting does not mend."""
UNKNOWN_OPTION = re.compile(r"unrecognized option '--([\w-]+)")
OWN = ("array_parallelism", "job_name", "map_count", "nodes", "ntasks_per_node", "signal_delay_s", "use_srun")
"""What a job is made of here, and nobody else sets."""
GENERIC = ("gres", "tres_per_job", "tres_per_node", "tres_per_task")
"""Options that ask for anything that a node has, by its name."""

Options = Mapping[str, str]


@dataclass(frozen=True)
class Job:
    """A job as the queue has it: its id, state, and the node that it runs on or why it does not."""

    id: str
    state: str
    where: str = ""

    @property
    def over(self) -> bool:
        """Whether it will not run again."""
        return self.state in ENDED

    @property
    def hopeless(self) -> bool:
        """Whether it waits for what will not come, such as a longer time than the partition gives."""
        return self.state == "PENDING" and bool(NEVER.fullmatch(self.where))


def jobs_of(submissions: Sequence[Submission]) -> dict[tuple[str, int], Job]:
    """Return the jobs that the queue knows of submissions, by the submission's name and the group.

    Raises:
        UserError: when the queue cannot be asked.
    """
    if not submissions:
        return {}
    names = ",".join(submission.name for submission in submissions)
    form = "%j|%F|%K|%i|%T|%R"
    printed = _answer(
        ["squeue", "--noheader", "--array", "--states=all", f"--name={names}", f"--format={form}"]
    )
    jobs = {}
    for line in printed.splitlines():
        name, _, place, job, state, where = line.strip().split("|", 5)
        where = "" if where == "(None)" else where  # nobody has looked yet why it waits
        jobs[name, int(place) if place.isdecimal() else 0] = Job(job, state, where)
    return jobs


def jobs_by_run(submissions: Sequence[Submission]) -> dict[str, Job]:
    """Return the jobs that are queued or running by the ids of the runs that they train.

    Raises:
        UserError: when the queue cannot be asked.
    """
    return live_runs(submissions, jobs_of(submissions))


def live_runs(submissions: Sequence[Submission], jobs: Mapping[tuple[str, int], Job]) -> dict[str, Job]:
    """Return those of jobs that are queued or running by the ids of the runs that they train."""
    return {
        name: job
        for submission in submissions
        for i, group in enumerate(submission.groups)
        if (job := jobs.get((submission.name, i))) and not job.over
        for name in group
    }


def refuse_hopeless(submission: Submission) -> None:
    """Take a submission back whose jobs the queue will never run.

    Raises:
        UserError: when it is so, with the queue's reason.
    """
    try:
        jobs = jobs_of([submission])
    except UserError:  # they are in the queue, whether or not it can be asked just now
        return
    for job in jobs.values():
        if job.hopeless:
            take_back(submission)
            raise UserError(
                f"--executor slurm: the queue would never run these jobs {job.where}: they are taken back; "
                "give another time, partition or size by --slurm"
            )


def take_back(submission: Submission) -> None:
    """Take the jobs of a submission out of the queue again.

    Raises:
        UserError: when the queue does not answer.
    """
    _answer(["scancel", f"--name={submission.name}"])
    submission.close(keep=False)


def total_cores(options: Options) -> int:
    """Return how many cores the partition has, or all that are not named.

    Raises:
        UserError: when the cluster cannot be asked, or has no such partition.
    """
    named = [f"--partition={options['partition']}"] if "partition" in options else []
    printed = _answer(["sinfo", "--noheader", "--format=%C", *named]).split()
    if not printed:
        raise UserError(f"--slurm partition={options['partition']}: there is none; `sinfo` lists them")
    return max(1, sum(int(counts.split("/")[3]) for counts in printed))


def check_submission(folder: Path, options: Options, gpu: bool) -> None:
    """Ask sbatch whether it would take such a job; submit nothing.

    Raises:
        UserError: with the reason, when it would not.
    """
    script = _executor(folder, parameters("pneuma-check", options, 1, gpu))._make_submission_file_text("", "")
    try:
        _answer(["sbatch", "--test-only"], script)
    except UserError as error:
        if match := UNKNOWN_OPTION.search(str(error)):
            raise _unknown_option(match[1].replace("-", "_"), options) from None
        raise


def _unknown_option(key: str, options: Options) -> UserError:
    """Build the error for an option that sbatch does not have, with the nearest that submitit names."""
    known = sorted(import_module("submitit").SlurmExecutor._valid_parameters() - {*OWN})
    return UserError(
        f"--slurm {key}={options.get(key, '')}: sbatch has no such option{nearest_name(key, known)}; "
        "`sbatch --help` lists them"
    )


def submit(
    submission: Submission, works: Sequence[Mapping[str, Any]], options: Options, at_once: int, gpu: bool
) -> None:
    """Submit an array of jobs, one for each group's work.

    Raises:
        UserError: when sbatch refuses it.
    """
    executor = _executor(submission.jobs_folder, parameters(submission.name, options, at_once, gpu))
    try:
        executor.submit_array([Training(work) for work in works])
    except Exception as error:  # submitit's own kinds differ between its versions; all tell sbatch's words
        submission.close(keep=False)
        raise UserError(f"--executor slurm: {_reason(str(error))}") from None


def parameters(name: str, options: Options, at_once: int, gpu: bool) -> dict[str, Any]:
    """Return what submitit is told: its own parameters, and any other of sbatch's by name.

    Raises:
        UserError: for an option that is not for people to set, or a time that is none.
    """
    defaults = import_module("submitit").SlurmExecutor._valid_parameters()
    own: dict[str, Any] = {}
    others: dict[str, Any] = {"requeue": True}
    for key, text in options.items():
        key = key.replace("-", "_")
        if key in OWN:
            raise UserError(
                f"--slurm {key}={text}: is set by Pneuma (--workers says how many jobs run at once)"
            )
        (own if key in defaults else others)[key] = {"true": True}.get(text, text)
    own["time"] = read_minutes(options["time"]) if "time" in options else USUAL_MINUTES
    own["setup"] = [*_environment(), *([own["setup"]] if "setup" in own else [])]
    if gpu and not ask_for_gpu(options):
        own["gpus_per_node"] = 1
    return {**own, "job_name": name, "array_parallelism": at_once, "additional_parameters": others}


def ask_for_gpu(options: Options) -> bool:
    """Tell whether people's own options ask for a GPU."""
    named = {key.replace("-", "_"): text for key, text in options.items()}
    return any(key.startswith("gpus") or (key in GENERIC and "gpu" in text) for key, text in named.items())


def read_minutes(text: str) -> int:
    """Read a time as sbatch does: minutes, M:S, H:M:S, D-H, D-H:M or D-H:M:S; rounded up to minutes.

    Raises:
        UserError: for anything else.
    """
    match = re.fullmatch(r"(?:(\d+)-)?(\d+)(?::(\d+))?(?::(\d+))?", text)
    if not match:
        raise UserError(f"--slurm time={text}: must be minutes, or as in 2:30:00 or 1-12 (a day and a half)")
    days, *parts = (None if part is None else int(part) for part in match.groups())
    given = [part for part in parts if part is not None]
    if days is not None or len(given) == 3:
        hours, minutes, seconds = [*given, 0, 0][:3]
    else:
        hours, minutes, seconds = 0, *[*given, 0][:2]
    total = (days or 0) * 1440 + hours * 60 + minutes + (seconds > 0)
    if not total:
        raise UserError(f"--slurm time={text}: must be a minute at least")
    return total


def _environment() -> list[str]:
    """Return the lines with which a job's script begins: this code, one thread, the cores it asked for."""
    source = shlex.quote(str(Path(__file__).parents[3]))
    return [
        f'export PYTHONPATH={source}"${{PYTHONPATH:+:$PYTHONPATH}}"',
        "export OPENBLAS_NUM_THREADS=1",  # threads of submitit's process would take signals that are ours
        "export SRUN_CPUS_PER_TASK=${SLURM_CPUS_PER_TASK:-1}",  # since 22.05 srun asks anew
    ]


def _executor(folder: Path, told: Mapping[str, Any]) -> Any:
    executor = import_module("submitit").SlurmExecutor(folder, max_num_timeout=MOST_REQUEUES)
    executor.update_parameters(**told)
    return executor


def check_programs() -> None:
    """Refuse a machine from which nothing can be submitted.

    Raises:
        UserError: naming what is missing, and the mend.
    """
    missing = [program for program in PROGRAMS if shutil.which(program) is None]
    if missing:
        raise UserError(
            f"--executor slurm: there is no {' and no '.join(missing)} on the path; "
            "give the command where jobs are submitted, such as the cluster's login node"
        )
    try:
        import_module("submitit")
    except ImportError:
        raise UserError(f"--executor slurm needs submitit: {install_extra('slurm')}") from None


def _answer(command: Sequence[str], text: str = "") -> str:
    """Return what one of Slurm's programs prints.

    Raises:
        UserError: with its last line, when it fails or does not answer in time.
    """
    name = command[0]
    environment = {**os.environ, "LC_ALL": "C"}
    try:
        done = subprocess.run(
            command, input=text, capture_output=True, text=True, timeout=ANSWER_SECONDS, env=environment
        )
    except FileNotFoundError:
        raise UserError(f"--executor slurm: there is no {name} on the path; {ELSEWHERE}") from None
    except subprocess.TimeoutExpired:
        raise UserError(
            f"{name}: Slurm's controller does not answer in {ANSWER_SECONDS:.0f} s; see `scontrol ping`"
        ) from None
    if done.returncode:
        mend = f"; {ELSEWHERE}" if name == "sinfo" else ""  # what is asked first; sbatch says its own
        raise UserError(f"--executor slurm: {_reason(done.stderr) or f'{name} failed'}{mend}")
    return done.stdout


def _reason(text: str) -> str:
    """Return the line of what sbatch and its kin print that says what is wrong: their own, or the last."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    own = [line for line in lines if line.startswith(PROGRAMS)]
    line = (own or lines or [""])[0 if own else -1]
    return line.removeprefix("sbatch: ").removeprefix("error: ")
