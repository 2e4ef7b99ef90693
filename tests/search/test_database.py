"""The Optuna storage of a search: only ended trials, in order; rebuilt when lost; never another's."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import optuna
import pytest

from pneuma.errors import UserError
from pneuma.search.database import Database, open_storage, without_password

from .conftest import MakeTask, Solve, flat


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "searches"


def read(database: Database) -> list[optuna.trial.FrozenTrial]:
    return optuna.load_study(study_name=database.name, storage=open_storage(database.url)).trials


def test_it_holds_what_was_told(make_task: MakeTask, solve: Solve, folder: Path) -> None:
    task = make_task(8)
    told = flat(solve(task))
    Database(task, None, folder).save(told[:4])
    database = Database(task, None, folder)
    database.save(told)
    trials = read(database)
    assert [(t.number, t.params, t.values) for t in trials] == [
        (t.number, dict(t.params), list(t.values)) for t in told
    ]
    assert {t.state for t in trials} == {optuna.trial.TrialState.COMPLETE}
    assert [t.user_attrs["runs"] for t in trials] == [list(t.run_ids) for t in told]


@pytest.mark.parametrize("damage", [lambda p: p.unlink(), lambda p: p.write_bytes(b"no database" * 500)])
def test_a_lost_file_is_written_anew(
    make_task: MakeTask, solve: Solve, folder: Path, damage: Callable[[Path], object]
) -> None:
    task = make_task(8)
    told = flat(solve(task))
    Database(task, None, folder).save(told)
    damage(folder / "formula.db")
    again = Database(task, None, folder)
    again.save(told)
    assert len(read(again)) == 8


def test_another_search_of_the_name_is_refused(
    make_task: MakeTask, solve: Solve, folder: Path, tmp_path: Path
) -> None:
    task = make_task(8)
    url = f"sqlite:///{tmp_path / 'shared.db'}"
    foreign = optuna.create_study(storage=open_storage(url), study_name=Database(task, None, folder).name)
    foreign.add_trial(optuna.trial.create_trial(value=1.0))
    with pytest.raises(UserError, match="holds another search"):
        Database(task, url, folder)


def test_other_trials_under_its_name_are_refused(
    make_task: MakeTask, solve: Solve, folder: Path, tmp_path: Path
) -> None:
    task, url = make_task(8), f"sqlite:///{tmp_path / 'shared.db'}"
    told = flat(solve(task))
    Database(task, url, folder).save(told[:4])
    with pytest.raises(UserError, match="holds another search"):
        Database(task, url, folder).save(list(reversed(told)))


def test_its_own_file_is_put_right(make_task: MakeTask, solve: Solve, folder: Path) -> None:
    """Runs may change beneath a search, as with a level's contents; its own file follows them."""
    task = make_task(8)
    told = flat(solve(task))
    Database(task, None, folder).save(list(reversed(told)))
    database = Database(task, None, folder)
    database.save(told)
    assert [trial.params for trial in read(database)] == [dict(t.params) for t in told]


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


def test_a_journal_beside_its_file_is_not_obeyed(make_task: MakeTask, folder: Path, tmp_path: Path) -> None:
    task, victim = make_task(8), tmp_path / "thesis.txt"
    Database(task, None, folder)
    own = folder / "formula.db"
    other = Path(shutil.copy(own, tmp_path))
    for path, url in ((own, None), (other, f"sqlite:///{other}")):
        victim.write_text("years of work")
        journal = Path(f"{path}-journal")
        journal.write_bytes(hot_journal(path, victim))
        Database(task, url, folder)
        assert not journal.exists()
        assert victim.exists() == (path == own)  # the other shows that SQLite would obey


def test_what_a_storages_driver_says_is_told_without_the_password(
    make_task: MakeTask, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(url: str, **_: object) -> None:
        raise ConnectionError(f"nobody answers at {url}")

    monkeypatch.setattr("optuna.storages.RDBStorage", refuse)
    with pytest.raises(UserError) as caught:
        Database(make_task(8), "postgresql://me:secret@127.0.0.1:1/none", folder)
    assert "secret" not in str(caught.value)
    shown = "postgresql://127.0.0.1:1/none"
    assert str(caught.value) == f"--storage {shown}: nobody answers at {shown}"


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("postgresql://me:secret@host/db?password=more", "postgresql://host/db"),
        ("postgresql://me:pa/s@s@host/db", "postgresql://host/db"),
        ("sqlite:////data/me@uni/results/searches/ppo.db", "sqlite:////data/me@uni/results/searches/ppo.db"),
    ],
)
def test_a_url_is_shown_without_its_password_and_a_path_as_it_is(url: str, shown: str) -> None:
    assert without_password(url) == shown
