"""The log of a search: what Optuna finds in it, who may write it, and what is not read."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.search.log import LogLock, read_record
from pneuma.store.store import PUBLISHED, Store
from pneuma.study.shipped import shipped_tables

from .conftest import MEDIAN, MakeTask, comparable, open_log


def test_optuna_opens_the_log(make_task: MakeTask, store: Store) -> None:
    betas = "[space.betas]\nchoices = [[0.9, 0.99], [0.9, 0.9]]\n"
    limits = '[space.gradient_limit]\nchoices = [0.5, "none"]\n'
    record = make_task(8, limits + betas + MEDIAN).record(store)
    study = open_log(record.path)
    assert [comparable(trial) for trial in study.trials] == [comparable(trial) for trial in record.ended]
    assert study.best_trial.number == record.best
    assert {trial.params["gradient_limit"] for trial in study.trials} == {0.5, None}
    assert {trial.params["betas"] for trial in study.trials} == {"[0.9, 0.99]", "[0.9, 0.9]"}
    assert study.trials[0].user_attrs["seeds"] == [1000, 1001]
    assert record.path.stat().st_mode & 0o111 == 0


def test_what_has_ended_is_trained_no_more_and_a_longer_search_goes_on(
    make_task: MakeTask, store: Store
) -> None:
    first = make_task(8).solve(store)
    again, longer, shorter = make_task(8), make_task(12), make_task(4)
    assert again.solve(store) == first and not again.asked
    assert longer.solve(store)[:8] == first and len(longer.asked) == 1
    assert shorter.solve(store) == first[:4] and not shorter.asked
    record = read_record(store, "formula", "text")
    assert (len(record.ended), record.budget.trials) == (12, 12)


def test_no_trial_is_left_running_of_an_unfinished_generation(make_task: MakeTask, store: Store) -> None:
    """Ten trials in generations of four; a longer search then has the trials of one that was not stopped."""
    first = make_task(10).solve(store)
    study = open_log(make_task(10).record(store).path)
    assert [trial.state.name for trial in study.trials] == ["COMPLETE"] * 10
    longer = make_task(16).solve(store)
    assert longer[:10] == first
    assert longer == make_task(16).solve(Store(store.root / "at-once"))


def test_another_budget_has_a_log_of_its_own_and_the_latest_is_read(
    make_task: MakeTask, store: Store
) -> None:
    first = make_task(4).record(store)
    other = make_task(4, steps=4096)
    assert other.record(store).path != first.path
    assert read_record(store, "formula", "text").budget.steps == 4096
    assert make_task(5).record(store).path == first.path
    assert read_record(store, "formula", "text").budget.steps == 2048


def test_a_search_whose_file_has_changed_is_not_read(make_task: MakeTask, store: Store) -> None:
    """What runs have is in the search's file: no module that a log alone names is imported."""
    path = make_task(4, "[run]\ngamma = 0.9").record(store).path
    whole = path.read_text()
    Path("marking.py").write_text("open('mark', 'w')\n")
    path.write_text(whole.replace('"fixed":{', '"fixed":{"env_module":"marking",', 1))
    with pytest.raises(UserError, match="its file now has other fixed than when the search began"):
        read_record(store, "formula", "text")
    assert not Path("mark").exists()
    path.write_text(whole)
    make_task(4)
    with pytest.raises(UserError, match="its file now has other fixed than when the search began"):
        read_record(store, "formula", "text")
    with pytest.raises(UserError, match="search formula-arena was not run in"):
        read_record(store, "formula")


def test_a_published_log_is_read_where_no_search_was_run(make_task: MakeTask, store: Store) -> None:
    """An empty log, as Optuna leaves it where it finds none, is none."""
    record = make_task(4).record(store)
    published = store.root / PUBLISHED / "search-formula-text.log"
    published.parent.mkdir()
    shutil.copy(record.path, published)
    assert not read_record(store, "formula", "text").published
    record.path.write_bytes(b"")
    found = read_record(store, "formula", "text")
    assert (found.published, found.path) == (True, published)
    assert [comparable(trial) for trial in found.ended] == [comparable(trial) for trial in record.ended]


HOLD = """
import time
from pathlib import Path
from pneuma.search.log import LogLock
lock = LogLock(Path("results/x.log"))
lock.acquire()
print("held", flush=True)
time.sleep(1000)
"""


def test_a_lock_ends_with_its_process_and_is_not_taken_from_one_that_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a relative folder, too. Whoever waits for long prints for whom."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(LogLock, "WAIT_SECONDS", 0.1)
    Path("results").mkdir()
    Path("results/x.log").touch()
    lock = LogLock(Path("results/x.log"))
    waiting = threading.Thread(target=lock.acquire, daemon=True)
    with subprocess.Popen([sys.executable, "-c", HOLD], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout and holder.stdout.readline() == "held\n"
        holder.send_signal(signal.SIGSTOP)
        waiting.start()
        waiting.join(0.5)
        is_waiting, message = waiting.is_alive(), capsys.readouterr().err
        holder.kill()
        assert is_waiting and message.count(f"Waiting for process {holder.pid} on ") == 1
        waiting.join(10)
        assert not waiting.is_alive()
    lock.release()


def test_a_torn_line_is_cut_off_before_anything_is_written(tmp_path: Path) -> None:
    log = tmp_path / "x.log"
    for text, kept in (("", ""), ("{}\n", "{}\n"), ('{}\n{"op', "{}\n"), ('{"op', "")):
        log.write_text(text)
        lock = LogLock(log)
        lock.acquire()
        assert log.read_text() == kept
        lock.release()


REFUSED: dict[str, tuple[str, str, str]] = {
    # name: (a pattern in the log, its replacement, the message)
    "an unknown operation": (r"\Z", '{"op_code": 99}\n', "cannot be read"),
    "no log": (r"(?s).+", "dear diary\n\n", "cannot be read"),
    "another study": ('"study_name":"formula"', '"study_name":"mine"', "cannot be read"),
    "other attributes": ('"pneuma":{', '"pneuma":"mine","x":{', "cannot be read"),
    "choices that were text": (
        re.escape("[0.5, null]"), r'[\"0.5\", \"none\"]', "trial 0 is not the search's",
    ),
    "ids that are no text": (r'"run_ids":\[', '"run_ids":[[],', "trial 0 is not the search's"),
    "an infinite value": (r'"values":\[[^]]*', '"values":[Infinity', "trial 0 is not the search's"),
}  # fmt: skip


def test_a_log_that_is_not_the_search_s_is_refused_and_kept(make_task: MakeTask, store: Store) -> None:
    task = make_task(4, '[space.gradient_limit]\nchoices = [0.5, "none"]\n')
    path = task.record(store).path
    whole = path.read_text()
    for what, (pattern, replacement, message) in REFUSED.items():
        changed = re.sub(pattern, replacement, whole)
        path.write_text(changed)
        with pytest.raises(UserError, match=message):
            read_record(store, "formula", "text")
        with pytest.raises(UserError, match=message):
            task.record(store)
        assert path.read_text() == changed != whole, what


def test_untrusted_a_log_or_its_lock_that_is_a_link_or_a_pipe_is_not_written(
    make_task: MakeTask, store: Store, tmp_path: Path
) -> None:
    task, elsewhere = make_task(4), tmp_path / "elsewhere"
    elsewhere.write_text("mine\n")
    folder = store.root / "searches"
    folder.mkdir(parents=True)
    log = task.record(Store(tmp_path / "other")).path.name
    for name in (log, f".{log}.lock"):
        (folder / name).symlink_to(elsewhere)
        with pytest.raises(UserError, match=name):
            task.record(store)
        (folder / name).unlink()
        os.mkfifo(folder / name)
        with pytest.raises(UserError, match=f"{name}: cannot be read .is not a regular file"):
            task.record(store)
        (folder / name).unlink()
    assert elsewhere.read_text() == "mine\n"


@pytest.mark.parametrize("path", sorted(shipped_tables().glob("search-*.log")), ids=lambda path: path.stem)
def test_each_published_log_fits_its_searchs_file(path: Path, store: Store) -> None:
    name, _, world = path.stem.removeprefix("search-").rpartition("-")
    if not name:  # of a search that is in one world
        name, world = world, ""
    record = read_record(store, name, world or None)
    assert record.published and record.best is not None
