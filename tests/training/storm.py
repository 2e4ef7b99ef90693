"""The storm: studies killed at random moments and damaged in every file end with the same bits.

    python -m tests.training.storm [KILLS]     the whole of it, as `make storm` runs it

`test_storm.py` runs a short form. Everything here goes through the command that people use, in processes of
its own, and is compared with a study that nobody disturbed.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pneuma.store.row_builder import stored_row
from pneuma.store.store import ROW_FILE, Store
from pneuma.training.executors.local import worker_environment

from .commands import outcome, wait_until

STUDY = """\
title = "Storm"
base = "table-6-2"
[run]
engine = "{engine}"
evaluation_episodes = 2
episode_steps = 200
[conditions.adam]
[conditions.momentum]
optimizer = "sgd"
momentum = 0.9
[presets.quick]
seeds = 2
steps = {steps}
"""
DAMAGES = ("cut short", "bit flipped", "emptied", "removed")
ORPHAN_SECONDS = 2.0


@dataclass
class Storm:
    """A study in a folder of its own, with undisturbed results in `reference`.

    Attributes:
        disturbances: how often each kind of kill or damage was done.
        longest_orphan: seconds that a worker lived on after its parent.
        faults: files that differ from those of the undisturbed study, and failed commands.
    """

    folder: Path
    dice: random.Random
    disturbances: Counter[str] = field(default_factory=Counter)
    longest_orphan: float = 0.0
    faults: list[str] = field(default_factory=list)

    def command(self, results: str) -> list[str]:
        command = [sys.executable, "-m", "pneuma", "study", "run", str(self.folder / "storm.toml")]
        return [*command, "--results", str(self.folder / results), "--checkpoint-seconds", "0.3"]

    def begin(self, results: str) -> subprocess.Popen[bytes]:
        command = [*self.command(results), "--quiet"]
        return subprocess.Popen(command, stderr=subprocess.DEVNULL, env=worker_environment())

    def complete(self, results: str) -> str:
        """Run the study to its end, and compare its files; return what the command printed."""
        command = self.command(results)
        ended = subprocess.run(command, capture_output=True, text=True, env=worker_environment())
        output = ended.stdout + ended.stderr
        if "Traceback" in output or ended.returncode:
            self.faults.append(f"exit {ended.returncode}: {output}")
        store = Store(self.folder / results)
        for run_id in store.runs():
            stored_row(store, run_id)  # a lost row is made when it is read
        files, expected_files = outcome(store.root), outcome(self.folder / "reference")
        for name, contents in expected_files.items():
            if files.get(name) != contents:
                self.faults.append(f"{name} differs")
        return output

    def strike(self, parent: subprocess.Popen[bytes]) -> None:
        """Kill a worker, the parent, or all."""
        workers = children(parent.pid)
        target = self.dice.choice(["worker", "worker", "parent", "all"]) if workers else "parent"
        self.disturbances[target] += 1
        if target == "worker":
            kill(self.dice.choice(workers))
            return
        kill(parent.pid)
        parent.wait()
        if target == "all":
            for worker in workers:
                kill(worker)
        self.longest_orphan = max(self.longest_orphan, wait_for_end(workers))


def start_storm(folder: Path, engine: str, steps: int, seed: int) -> Storm:
    """Train the undisturbed study."""
    storm = Storm(folder, random.Random(seed))
    (folder / "storm.toml").write_text(STUDY.format(engine=engine, steps=steps))
    storm.complete("reference")
    return storm


def kill_storm(engine: str, kills: int, steps: int, seed: int = 0) -> Storm:
    """Kill workers, the parent, or all, at random moments, and give the same command again each time."""
    with tempfile.TemporaryDirectory() as folder_name:
        storm = start_storm(Path(folder_name), engine, steps, seed)
        while storm.disturbances.total() < kills:
            parent = storm.begin("disturbed")
            while parent.poll() is None and storm.disturbances.total() < kills:
                time.sleep(storm.dice.uniform(0.2, 6.0))
                if parent.poll() is None:
                    storm.strike(parent)
            if parent.wait() == 0 or storm.disturbances.total() == kills:
                storm.complete("disturbed")
                shutil.rmtree(storm.folder / "disturbed")
    return storm


def damage_sweep(engine: str, steps: int, seed: int = 0, every: int = 1) -> Storm:
    """Damage every file of a run of a finished and of a half-trained study, and run the study again.

    Args:
        engine: the engine that trains.
        steps: budget of each run.
        seed: of the random bits.
        every: 1 for all cases, 2 for every second one.
    """
    with tempfile.TemporaryDirectory() as folder_name:
        storm = start_storm(Path(folder_name), engine, steps, seed)
        parent = storm.begin("half")
        while parent.poll() is None and len(list(storm.folder.glob("half/**/*.safetensors"))) < 3:
            time.sleep(0.05)
        workers = children(parent.pid)
        kill(parent.pid)
        parent.wait()
        wait_for_end(workers)
        cases = damage_cases(storm.folder / "reference") + damage_cases(storm.folder / "half")
        for path, kind in cases[::every]:
            results = storm.folder / path.relative_to(storm.folder).parts[0]
            shutil.copytree(results, storm.folder / "disturbed")
            damage(storm.folder / "disturbed" / path.relative_to(results), kind, storm.dice)
            storm.disturbances[kind] += 1
            output = storm.complete("disturbed")
            shutil.rmtree(storm.folder / "disturbed")
            # a row is made from the other files without a message
            if "damaged" not in output and kind != "removed" and path.name != ROW_FILE:
                storm.faults.append(f"{path} {kind}: no message")
    return storm


def damage_cases(results: Path) -> list[tuple[Path, str]]:
    """Return every file of the run that has most, with every damage, and the folders to remove."""
    files_by_run = []
    for run_folder in (results / "runs").iterdir():
        files_by_run.append(sorted(path for path in run_folder.rglob("[!.]*") if path.is_file()))
    files = max(files_by_run, key=len)
    cases = [(path, kind) for path in files for kind in DAMAGES]
    run_folder = results / "runs" / files[0].relative_to(results / "runs").parts[0]
    return [*cases, (run_folder, "removed"), (results / "runs", "removed")]


def damage(path: Path, kind: str, dice: random.Random) -> None:
    """Damage a file, or remove a folder."""
    if path.is_dir():
        shutil.rmtree(path)
    elif kind == "removed":
        path.unlink()
    else:
        contents = bytearray(path.read_bytes())
        if kind == "bit flipped":
            contents[dice.randrange(len(contents))] ^= 1 << dice.randrange(8)
        elif kind == "cut short":
            contents = contents[: len(contents) // 2]
        else:
            contents.clear()
        path.write_bytes(contents)


# --- Processes ---------------------------------------------------------------------------------------


def kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    child_pids = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            if path.read_text().rpartition(")")[2].split()[1] == str(pid):
                child_pids.append(int(path.parent.name))
    return child_pids


def wait_for_end(pids: Sequence[int]) -> float:
    """Return how many seconds it takes until none of these is left."""
    start = time.monotonic()
    wait_until(lambda: not any(is_alive(pid) for pid in pids))
    return time.monotonic() - start


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def main() -> int:
    """Run the whole storm and print what was done; return 1 if there was a fault."""
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else 25
    storms = {
        "kills, batched": kill_storm("batched", kills, 256_000),
        "kills, sb3": kill_storm("sb3", kills, 12_800),
        "damage, batched": damage_sweep("batched", 25_600, every=max(1, 25 // kills)),
    }
    exit_code = 0
    for name, storm in storms.items():
        orphan_text = f"longest orphan {storm.longest_orphan:.2f} s"
        print(f"{name}: {dict(storm.disturbances)}, {len(storm.faults)} faults, {orphan_text}")
        print(*storm.faults, sep="\n  ")
        if storm.faults or storm.longest_orphan > ORPHAN_SECONDS:
            exit_code = 1
    return exit_code


if __name__ == "__main__":
    raise SystemExit(main())
