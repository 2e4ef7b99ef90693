"""Every kind of file at every name of a results folder, for every command that reads one.

This test keeps the one door through which such files are opened (`files.open_stored`). A command that reads
results, or a name that a results folder can hold, belongs into its lists; nothing leaves them.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import pytest

from pneuma.store.store import Store, run_identity
from pneuma.study.plan import Cell, Query, make_plan
from pneuma.study.spec import load_study

from ..hand_made import save_listing
from .calls import call, finish_study, policy_of, printed

STUDY = """
title = "Own"
baseline = "one"
[run]
actor = [128]
critic = [256]
[conditions.one]
[conditions.two]
activation = "relu"
[presets.quick]
seeds = 12
steps = 10240
"""
SECONDS = 120
"""Far more than a command takes here, for tests on a busy machine."""
MORE_MEMORY = 2**30
PRECIOUS = "precious"
"""Text of a file outside of the results folder."""

KINDS: dict[str, Callable[[Path, Path], object]] = {
    # each makes a path what it should not be; the second path is the file outside
    "pipe": lambda path, outside: os.mkfifo(path),
    "device": lambda path, outside: path.symlink_to("/dev/zero"),
    "link": lambda path, outside: path.symlink_to(outside),
    "ring": lambda path, outside: path.symlink_to(path.name),
    "folder": lambda path, outside: (path / "inner").mkdir(parents=True),
    "empty": lambda path, outside: path.touch(),
    "huge": lambda path, outside: _make_sparse(path),
}
RUN_FILES = (
    "status.json", "run.json", "provenance.json", "episodes.parquet", "metrics.parquet",
    "evaluations.parquet", "row.arrow", "policy.safetensors",
)  # fmt: skip
UNFINISHED_FILES = (
    ".lock", "checkpoints", "checkpoints/0000000000100-0123456789abcdef.safetensors", "error.txt",
)  # fmt: skip
"""Files of runs that have not finished; those of finished ones are not opened."""
OTHER_FILES = (
    "published/own.parquet", "published/search-tune-a2c-arena.log", "studies/mine.json",
    "studies/copied.toml", "last/own.json", "searches/tune-adam-arena.log",
)  # fmt: skip
FOLDERS = ("runs", "published", "studies", "last", "searches", "figures")

COMMANDS = (
    "study plan own.toml", "study status", "study status own.toml", "study status copied",
    "study summary own.toml", "study summary mine", "study compare own.toml one two",
    "study collapse own.toml", "study export own.toml --table curves --out curves.csv",
    "study show own.toml", "study show mine", "study list", "study publish own.toml", "run list",
    "study plot own.toml --format svg --out figures", "report own.toml --out report.html",
    "search status tune-a2c", "search status tune-adam", "search plot tune-adam --format svg --out figures",
)  # fmt: skip
RUN_COMMANDS = ("run show {}", "run export {} --out policy.zip")
RENDER = "env render pneuma/PneumaArena-v0 --player {} --seconds 1 --out x.gif"
USED_FOR_PLAYING = ("status.json", "run.json", "policy.safetensors")
FOLDER_COMMANDS = (
    "study status", "study summary own.toml", "study summary mine", "run list", "search status tune-adam",
)  # fmt: skip


def _make_sparse(path: Path) -> None:
    """Make a file of a terabyte that takes no room."""
    with open(path, "wb") as file:
        file.truncate(2**40)


def odd_cells() -> list[Cell]:
    """Return a cell for each of `RUN_FILES`, then one for each of `UNFINISHED_FILES`."""
    plan = make_plan(load_study("own.toml"), Query(study="own.toml"))
    return [cell for cell in plan.cells if cell.condition == "one"]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a study's file and `results`, in which everything is as it should be."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "own.toml").write_text(STUDY)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        store = Store("results")
        run_ids = finish_study(store, "own.toml")
        policy = policy_of(64).to_bytes()
        cells = odd_cells()
        for cell in cells[: len(RUN_FILES)]:
            files = {name: store.read_file(cell.run_id, name) for name in store.checksums(cell.run_id)}
            store.save_run(cell.run_id, store.status(cell.run_id), {**files, "policy.safetensors": policy})
        for cell in cells[len(RUN_FILES) :]:
            store.remove(store.run_folder(cell.run_id))
            store.plan_run(cell.run_id, run_identity(cell.run))
        store.save_failure(cell.run_id, cell.run, "crashed", "why")
        store.write(store.studies / "copied.toml", STUDY.encode())
        save_listing(store, {("one", 0): run_ids[0], ("two", 0): run_ids[-1]})
    return folder


@pytest.fixture
def here(sound: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unshipped: None) -> Path:
    """A copy of that folder, as the current one."""
    folder = tmp_path / "here"
    shutil.copytree(sound, folder)
    monkeypatch.chdir(folder)
    return folder


@contextmanager
def limited() -> Iterator[None]:
    """Let what waits or takes memory without end fail."""

    def stop(signal_number: int, frame: FrameType | None) -> None:
        raise AssertionError(f"more than {SECONDS} seconds")

    memory = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    earlier_handler = signal.signal(signal.SIGALRM, stop)
    resource.setrlimit(resource.RLIMIT_AS, (memory + MORE_MEMORY, hard))
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, earlier_handler)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def arguments(words: str) -> list[str]:
    """Return a command's words, with the results folder."""
    if words in ("study list",):
        return words.split()
    return [*words.split(), "--results", "results"]


def put(kind: str, path: Path, outside: Path) -> None:
    """Put something of a kind in the place of a file or folder."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    KINDS[kind](path, outside)


def check(words: str) -> None:
    """Run a command: it ends in time, with a result or one line, and shows nothing of what lies outside."""
    with limited():
        code, output, errors = call(*arguments(words))
    assert code in (0, 2), words
    assert PRECIOUS not in output + errors, words
    refusals = [line for line in errors.splitlines() if line.startswith("pneuma: ")]
    assert len(refusals) == (code == 2), (words, errors)


def test_each_of_the_commands_works_where_nothing_is_odd(here: Path) -> None:
    run_id = odd_cells()[0].run_id
    for words in COMMANDS + RUN_COMMANDS:
        printed(*arguments(words.format(run_id)))


@pytest.mark.parametrize("kind", KINDS)
def test_untrusted_odd_files_are_refused_in_time_and_in_one_line(
    here: Path, tmp_path: Path, kind: str
) -> None:
    """Each file of a run is odd in a run of its own, so that none hides another."""
    outside, store = tmp_path / "outside", Store("results")
    outside.write_text(PRECIOUS)
    odd_runs = [cell.run_id for cell in odd_cells()]
    odd_files = [Path("results", name) for name in OTHER_FILES]
    for run_id, name in zip(odd_runs, RUN_FILES + UNFINISHED_FILES, strict=True):
        odd_files.append(store.run_folder(run_id) / name)
    commands = list(COMMANDS)
    for command in RUN_COMMANDS:
        commands += [command.format(run_id) for run_id in odd_runs]
    commands += [RENDER.format(odd_runs[RUN_FILES.index(name)]) for name in USED_FOR_PLAYING]
    for words in commands:
        for path in odd_files:  # a command may have put a sound file there
            put(kind, path, outside)
        check(words)
    assert outside.read_text() == PRECIOUS


@pytest.mark.parametrize("kind", KINDS)
def test_untrusted_odd_folders_are_refused_in_time_and_in_one_line(
    here: Path, tmp_path: Path, kind: str
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "own.json").write_text(PRECIOUS)
    for name in FOLDERS:
        folder, kept = Path("results", name), Path("kept")
        if folder.is_dir():
            folder.rename(kept)
        put(kind, folder, outside)
        for words in FOLDER_COMMANDS:
            check(words)
        put("empty", folder, outside)
        folder.unlink()
        if kept.is_dir():
            kept.rename(folder)
