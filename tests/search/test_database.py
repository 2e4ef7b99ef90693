"""A search's file for optuna-dashboard: only ended trials, in order, and nothing of what was there before."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from pathlib import Path

import optuna
import pytest

from pneuma.errors import UserError
from pneuma.search.database import Database, open_storage

from .conftest import MakeTask, Solve, flat


def test_it_holds_what_was_told_whatever_was_there(make_task: MakeTask, solve: Solve, tmp_path: Path) -> None:
    task = make_task(8)
    told = flat(solve(task))
    Database(task, tmp_path).save(list(reversed(told)))
    (tmp_path / "formula.db").write_bytes(b"no database" * 500)
    database = Database(task, tmp_path)
    for count in (4, 8):
        database.save(told[:count])
    trials = optuna.load_study(study_name=database.name, storage=open_storage(database.url)).trials
    assert [(t.number, t.params, t.values) for t in trials] == [
        (t.number, dict(t.params), list(t.values)) for t in told
    ]
    assert {t.state for t in trials} == {optuna.trial.TrialState.COMPLETE}
    assert [t.user_attrs["runs"] for t in trials] == [list(t.run_ids) for t in told]


def test_what_is_no_file_is_left_alone(make_task: MakeTask, tmp_path: Path) -> None:
    (tmp_path / "formula.db").mkdir()
    with pytest.raises(UserError, match="formula.db: cannot be removed"):
        Database(make_task(8), tmp_path)


def hot_journal(database: Path, victim: Path) -> bytes:
    """Return a journal that SQLite rolls back, deleting the super-journal that it names.

    By https://www.sqlite.org/fileformat2.html#the_rollback_journal: a header of one sector with no pages to
    put back, and pager.c's record of a super-journal's name at the end.
    """
    magic, name = bytes.fromhex("d9d505f920a163d7"), str(victim).encode()
    page = int.from_bytes(database.read_bytes()[16:18], "big")
    header = magic + struct.pack(">5I", 0, 0, database.stat().st_size // page, 512, page)
    locked_page = struct.pack(">I", 2**30 // page + 1)
    return header.ljust(512, b"\0") + locked_page + name + struct.pack(">2I", len(name), sum(name)) + magic


def test_a_journal_beside_its_file_is_not_obeyed(make_task: MakeTask, tmp_path: Path) -> None:
    task, victim = make_task(8), tmp_path / "thesis.txt"
    Database(task, tmp_path)
    own = tmp_path / "formula.db"
    other = Path(shutil.copy(own, tmp_path / "other.db"))
    for path in (own, other):
        victim.write_text("years of work")
        journal = Path(f"{path}-journal")
        journal.write_bytes(hot_journal(path, victim))
        if path == own:
            Database(task, tmp_path)
        else:
            with sqlite3.connect(path) as connection:
                connection.execute("SELECT * FROM studies").fetchall()
        assert not journal.exists()
        assert victim.exists() == (path == own)  # the other shows that SQLite would obey
