"""The storm: studies killed at random moments and damaged in every file end with the same bits.

    python -m tests.study.storm        the whole of it, as `make storm` runs it

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
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pneuma.study.executors.local import one_thread_environment

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
COMPARED = (
    "run.json", "episodes.parquet", "metrics.parquet", "evaluations.parquet", "policy.safetensors",
)  # fmt: skip
ORPHAN_SECONDS = 2.0


@dataclass
class Tally:
    """What a storm did and found.

    Attributes:
        kills: processes killed, by whom it hit.
        starts: how often the command was given.
        longest_orphan: seconds that a worker lived on after its parent.
        differences: files that are not as in the undisturbed study.
        complaints: outputs that no person should see, such as a traceback.
    """

    kills: dict[str, int] = field(default_factory=dict)
    starts: int = 0
    longest_orphan: float = 0.0
    differences: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        """Return the figures in one line."""
        kills = ", ".join(f"{count} {whom}" for whom, count in sorted(self.kills.items()))
        return (
            f"{sum(self.kills.values())} disturbances ({kills}), {self.starts} starts, "
            f"{len(self.differences)} differences, {len(self.complaints)} complaints, "
            f"longest orphan {self.longest_orphan:.2f} s"
        )


def write_study(folder: Path, engine: str, steps: int) -> Path:
    """Write the study that is to be disturbed, two conditions of two seeds."""
    path = folder / "storm.toml"
    path.write_text(STUDY.format(engine=engine, steps=steps))
    return path


def command(study: Path, results: Path, *options: str) -> list[str]:
    """Return the command that people type."""
    program = [sys.executable, "-m", "pneuma", "study", "run", str(study), "--results", str(results)]
    return [*program, "--checkpoint-seconds", "0.3", *options]


def run_whole(study: Path, results: Path, tally: Tally, *options: str) -> str:
    """Run the study to its end; return what was printed, and note what should not have been."""
    done = subprocess.run(
        command(study, results, *options), capture_output=True, text=True, env=one_thread_environment()
    )
    tally.starts += 1
    told = done.stdout + done.stderr
    if "Traceback" in told or done.returncode:
        tally.complaints.append(f"exit {done.returncode}: {told}")
    return told


def compare(reference: Path, results: Path, tally: Tally) -> None:
    """Note every file of every run that is not as in the undisturbed study."""
    for folder in sorted((reference / "runs").iterdir()):
        for name in COMPARED:
            own = results / "runs" / folder.name / name
            if not own.is_file() or own.read_bytes() != (folder / name).read_bytes():
                tally.differences.append(f"{folder.name}/{name}")


# --- Kills -----------------------------------------------------------------------------------------


def kill_storm(engine: str, kills: int, steps: int, seed: int = 0) -> Tally:
    """Kill workers, the parent, or all, at random moments, and give the same command again each time."""
    tally, dice = Tally(), random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = write_study(folder, engine, steps)
        run_whole(study, folder / "reference", tally)
        while sum(tally.kills.values()) < kills:
            shutil.rmtree(folder / "disturbed", ignore_errors=True)
            _disturb_one_study(study, folder / "disturbed", kills, dice, tally)
            run_whole(study, folder / "disturbed", tally)
            compare(folder / "reference", folder / "disturbed", tally)
    return tally


def _disturb_one_study(study: Path, results: Path, kills: int, dice: random.Random, tally: Tally) -> None:
    """Start and kill until the kills are used up, or the study has ended in spite of them."""
    while sum(tally.kills.values()) < kills:
        tally.starts += 1
        parent = subprocess.Popen(
            command(study, results, "--quiet"),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=one_thread_environment(),
        )
        while parent.poll() is None and sum(tally.kills.values()) < kills:
            time.sleep(dice.uniform(0.2, 6.0))
            if parent.poll() is None and _strike(parent, dice, tally):
                break
        parent.wait()
        if parent.returncode == 0:
            return


def _strike(parent: subprocess.Popen[bytes], dice: random.Random, tally: Tally) -> bool:
    """Kill somebody; return whether it was the parent."""
    workers = list(children(parent.pid))
    whom = dice.choice(["worker", "worker", "parent", "all"]) if workers else "parent"
    tally.kills[whom] = tally.kills.get(whom, 0) + 1
    if whom == "worker":
        _kill(dice.choice(workers))
        return False
    _kill(parent.pid)
    parent.wait()
    if whom == "all":
        for worker in workers:
            _kill(worker)
    tally.longest_orphan = max(tally.longest_orphan, wait_for_end(workers))
    return True


def _kill(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def children(pid: int) -> Iterator[int]:
    """Yield the processes that a process has started."""
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            if path.read_text().rpartition(")")[2].split()[1] == str(pid):
                yield int(path.parent.name)


def wait_for_end(pids: Sequence[int]) -> float:
    """Return how many seconds it takes until all of these have gone; 60 at most."""
    begun = time.monotonic()
    while any(_lives(pid) for pid in pids) and time.monotonic() - begun < 60:
        time.sleep(0.02)
    return time.monotonic() - begun


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


# --- Damage ----------------------------------------------------------------------------------------

DAMAGES = ("cut short", "bit flipped", "emptied", "removed")


def damage_sweep(engine: str, steps: int, seed: int = 0, every: int = 1) -> Tally:
    """Damage every kind of file of a finished and of a half-trained study, in every way, and run it again.

    Args:
        engine: that trains.
        steps: budget of each run.
        seed: of the random bits.
        every: how many cases to go on by; 1 for all.
    """
    tally, dice = Tally(), random.Random(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        study = write_study(folder, engine, steps)
        run_whole(study, folder / "reference", tally)
        sources = (folder / "reference", _half_trained(study, folder, tally))
        cases = [(source, *case) for source in sources for case in _cases(source)]
        for source, file, how in cases[::every]:
            disturbed = folder / "disturbed"
            shutil.rmtree(disturbed, ignore_errors=True)
            shutil.copytree(source, disturbed)
            damage(disturbed / file, how, dice)
            tally.kills[how] = tally.kills.get(how, 0) + 1
            told = run_whole(study, disturbed, tally)
            if "damaged" not in told and how != "removed" and file.parts[0] == "runs":
                tally.complaints.append(f"{file} {how}: went unsaid")
            compare(folder / "reference", disturbed, tally)
    return tally


def _half_trained(study: Path, folder: Path, tally: Tally) -> Path:
    """Return a results folder of the study, killed when every run that began had left checkpoints."""
    results = folder / "half"
    parent = subprocess.Popen(
        command(study, results, "--quiet"), stderr=subprocess.DEVNULL, env=one_thread_environment()
    )
    while parent.poll() is None and len(list(results.glob("runs/*/checkpoints/*.safetensors"))) < 3:
        time.sleep(0.05)
    workers = list(children(parent.pid))
    _kill(parent.pid)
    parent.wait()
    wait_for_end(workers)
    return results


def _cases(results: Path) -> list[tuple[Path, str]]:
    """Return every file of the first run, its folder, and the study's record, with every damage."""
    run = next(path for path in sorted((results / "runs").iterdir()) if any(path.glob("*")))
    files = [path for path in sorted(run.rglob("*")) if path.is_file() and not path.name.startswith(".")]
    files += sorted((results / "studies").glob("*.json"))
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


def main() -> int:
    """Run the whole storm and print its figures; return 1 if anything was found."""
    storms = {
        "kills, batched": kill_storm("batched", 25, 256_000),
        "kills, sb3": kill_storm("sb3", 25, 12_800),
        "damage, batched": damage_sweep("batched", 25_600),
    }
    for name, tally in storms.items():
        print(f"{name}: {tally}")
        for found in (*tally.differences, *tally.complaints):
            print(f"  {found}")
    sound = not any(tally.differences or tally.complaints for tally in storms.values())
    longest = max(tally.longest_orphan for tally in storms.values())
    return 0 if sound and longest <= ORPHAN_SECONDS else 1


if __name__ == "__main__":
    raise SystemExit(main())
