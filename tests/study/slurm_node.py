"""A Slurm of one node, from the daemons that are installed here, in a folder of its own.

    with slurm_node(folder) as environment: ...

No systemd, no control groups, no accounting: munged, slurmctld and slurmd are started by hand on loopback,
and ended when the block is left. Debian has them as slurmctld, slurmd, slurm-client and munge.
"""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch")
START_SECONDS = 30.0

_CONFIGURATION = """
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
AuthInfo=socket={folder}/munge/socket,cred_expire=5
SlurmctldPort={ports[0]}
SlurmdPort={ports[1]}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerParameters=sched_interval=2,batch_sched_delay=0
MpiDefault=none
ReturnToService=2
KillWait=10
NodeName={host} NodeAddr=127.0.0.1 CPUs={cores} RealMemory=1000 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=60 State=UP
"""


def missing() -> list[str]:
    """Return which programs are not installed."""
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    return [program for program in PROGRAMS if shutil.which(program, path=path) is None]


@contextmanager
def slurm_node(folder: Path) -> Iterator[dict[str, str]]:
    """Start a cluster of this machine alone; yield the environment in which its commands find it."""
    for name in ("state", "spool", "munge"):
        (folder / name).mkdir(parents=True, mode=0o700)
    file = folder / "slurm.conf"
    told = {"host": socket.gethostname().split(".")[0], "user": getpass.getuser(), "folder": folder}
    file.write_text(_CONFIGURATION.format(**told, ports=_free_ports(2), cores=os.cpu_count()))
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    environment = {**os.environ, "PATH": path, "SLURM_CONF": str(file)}
    try:
        _start_munge(folder / "munge", environment)
        for daemon in ("slurmctld", "slurmd"):
            subprocess.run([daemon, "-f", str(file)], env=environment, check=True)
        _wait_for_node(environment)
        yield environment
    finally:
        subprocess.run(["scancel", f"--user={told['user']}"], env=environment, check=False, timeout=30)
        for pid_file in (folder / "slurmd.pid", folder / "slurmctld.pid", folder / "munge" / "pid"):
            _end(pid_file)


def _start_munge(folder: Path, environment: Mapping[str, str]) -> None:
    (folder / "key").write_bytes(os.urandom(1024))
    (folder / "key").chmod(0o600)
    files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    options = [f"--{option}={folder / name}" for option, name in files.items()]
    subprocess.run(["munged", "--force", *options], env=environment, check=True, stderr=subprocess.DEVNULL)


def _wait_for_node(environment: Mapping[str, str]) -> None:
    until = time.monotonic() + START_SECONDS
    while time.monotonic() < until:
        asked = subprocess.run(
            ["sinfo", "-h", "-o", "%T"], env=environment, capture_output=True, text=True, check=False
        )
        if asked.stdout.strip() == "idle":
            return
        time.sleep(0.2)
    raise RuntimeError(
        f"Slurm's node did not come up within {START_SECONDS:.0f} s: {asked.stdout}{asked.stderr}"
    )


def _free_ports(count: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def _end(pid_file: Path) -> None:
    with suppress(OSError, ValueError):
        pid = int(pid_file.read_text())
        os.kill(pid, signal.SIGTERM)
        for _ in range(100):
            os.kill(pid, 0)
            time.sleep(0.1)
        os.kill(pid, signal.SIGKILL)
