"""The storm: studies killed at random moments and damaged in every file end with the same bits.

    python -m tests.training.storm [KILLS]     the whole of it, as `make storm` runs it

`test_storm.py` runs a short form. Everything here goes through the command that people use, in
processes of its own, and compares with a study that nobody disturbed.
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
from collections.abc import Iterator, Sequence
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
    """A study, an undisturbed copy of its results, and what was done and found.

    Attributes:
        kills: disturbances, by whom or how.
        longest_orphan: seconds that a worker lived on after its parent.
        found: files that are not as in the undisturbed study, and outputs that no person should see.
    """

    folder: Path
    engine: str
    steps: int
    dice: random.Random
    kills: Counter[str] = field(default_factory=Counter)
    longest_orphan: float = 0.0
    found: list[str] = field(default_factory=list)

    def command(self, results: str) -> list[str]:
        run = [sys.executable, "-m", "pneuma", "study", "run", str(self.folder / "storm.toml")]
        return [*run, "--results", str(self.folder / results), "--checkpoint-seconds", "0.3"]

    def begin(self, results: str) -> subprocess.Popen[bytes]:
        command = [*self.command(results), "--quiet"]
        return subprocess.Popen(command, stderr=subprocess.DEVNULL, env=worker_environment())

    def run_whole(self, results: str) -> str:
        """Run the study to its end, and compare; return what was printed."""
        (self.folder / "storm.toml").write_text(STUDY.format(engine=self.engine, steps=self.steps))
        command = self.command(results)
        done = subprocess.run(command, capture_output=True, text=True, env=worker_environment())
        told = done.stdout + done.stderr
        if "Traceback" in told or done.returncode:
            self.found.append(f"exit {done.returncode}: {told}")
        store = Store(self.folder / results)
        for name in store.runs():
            stored_row(store, name)  # one that is lost is made again when it is read
        found = outcome(store.root)
        reference = outcome(self.folder / "reference")
        self.found += [f"{name} differs" for name, data in reference.items() if found.get(name) != data]
        return told

    def strike(self, parent: subprocess.Popen[bytes]) -> bool:
        """Kill a worker, the parent or all; return whether it was the parent."""
        workers = list(children(parent.pid))
        whom = self.dice.choice(["worker", "worker", "parent", "all"]) if workers else "parent"
        self.kills[whom] += 1
        if whom == "worker":
            kill(self.dice.choice(workers))
            return False
        kill(parent.pid)
        parent.wait()
        for worker in workers if whom == "all" else ():
            kill(worker)
        self.longest_orphan = max(self.longest_orphan, wait_for_end(workers))
        return True


def kill_storm(engine: str, kills: int, steps: int, seed: int = 0) -> Storm:
    """Kill workers, the parent, or all, at random moments, and give the same command again each time."""
    with tempfile.TemporaryDirectory() as name:
        storm = Storm(Path(name), engine, steps, random.Random(seed))
        storm.run_whole("reference")
        while storm.kills.total() < kills:
            shutil.rmtree(storm.folder / "disturbed", ignore_errors=True)
            ended = False
            while storm.kills.total() < kills and not ended:
                parent = storm.begin("disturbed")
                while parent.poll() is None and storm.kills.total() < kills:
                    time.sleep(storm.dice.uniform(0.2, 6.0))
                    if parent.poll() is None and storm.strike(parent):
                        break
                ended = parent.wait() == 0
            storm.run_whole("disturbed")
    return storm


def damage_sweep(engine: str, steps: int, seed: int = 0, every: int = 1) -> Storm:
    """Damage every kind of file of a finished and of a half-trained study, in every way, and run it again.

    Args:
        engine: that trains.
        steps: budget of each run.
        seed: of the random bits.
        every: how many cases to go on by; 1 for all.
    """
    with tempfile.TemporaryDirectory() as name:
        storm = Storm(Path(name), engine, steps, random.Random(seed))
        storm.run_whole("reference")
        parent = storm.begin("half")
        while parent.poll() is None and len(list(storm.folder.glob("half/**/*.safetensors"))) < 3:
            time.sleep(0.05)
        workers = list(children(parent.pid))
        kill(parent.pid)
        parent.wait()
        wait_for_end(workers)
        cases = [
            (source, *case) for source in ("reference", "half") for case in _cases(storm.folder / source)
        ]
        for source, file, how in cases[::every]:
            disturbed = storm.folder / "disturbed"
            shutil.rmtree(disturbed, ignore_errors=True)
            shutil.copytree(storm.folder / source, disturbed)
            damage(disturbed / file, how, storm.dice)
            storm.kills[how] += 1
            told = storm.run_whole("disturbed")
            unsaid = "damaged" not in told and how != "removed"
            if unsaid and file.name != ROW_FILE:  # which is made again from the other files
                storm.found.append(f"{file} {how}: went unsaid")
    return storm


def _cases(results: Path) -> list[tuple[Path, str]]:
    """Return every file of the run that has most, and its folder, with every damage."""
    folders = [
        [path for path in run.rglob("[!.]*") if path.is_file()] for run in (results / "runs").iterdir()
    ]
    largest: list[Path] = max(folders, key=len)
    files = sorted(largest)
    run = next(path.parent for path in files if path.name == "status.json")
    cases = [(path.relative_to(results), how) for path in files for how in DAMAGES]
    return [*cases, (run.relative_to(results), "removed"), (Path("runs"), "removed")]


def damage(path: Path, how: str, dice: random.Random) -> None:
    """Damage a file, or remove a folder."""
    if how == "removed":
        shutil.rmtree(path) if path.is_dir() else path.unlink()
        return
    data = bytearray(path.read_bytes())
    if how == "bit flipped":
        data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
    path.write_bytes(b"" if how == "emptied" else data[: len(data) // 2] if how == "cut short" else data)


def kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def children(pid: int) -> Iterator[int]:
    """Yield the processes that a process has started."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            if path.read_text().rpartition(")")[2].split()[1] == str(pid):
                yield int(path.parent.name)


def wait_for_end(pids: Sequence[int]) -> float:
    """Return how many seconds it takes until all of these have gone."""
    begun = time.monotonic()
    wait_until(lambda: not any(map(_lives, pids)))
    return time.monotonic() - begun


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def main() -> int:
    """Run the whole storm and print what was done; return 1 if anything was found."""
    kills = int(sys.argv[1]) if len(sys.argv) > 1 else 25
    storms = {
        "kills, batched": kill_storm("batched", kills, 256_000),
        "kills, sb3": kill_storm("sb3", kills, 12_800),
        "damage, batched": damage_sweep("batched", 25_600, every=max(1, 25 // kills)),
    }
    for name, storm in storms.items():
        orphan = f"longest orphan {storm.longest_orphan:.2f} s"
        print(f"{name}: {dict(storm.kills)}, {len(storm.found)} found, {orphan}", *storm.found, sep="\n  ")
    sound = not any(storm.found for storm in storms.values())
    return 0 if sound and all(own.longest_orphan <= ORPHAN_SECONDS for own in storms.values()) else 1


if __name__ == "__main__":
    raise SystemExit(main())
