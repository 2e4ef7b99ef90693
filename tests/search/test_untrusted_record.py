"""A search's record in a results folder may be anybody's: it names no code, no file and no program."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.search.journal import Journal, begin_log, log_path, read_record
from pneuma.search.task import Task
from pneuma.study.identity import run_id
from pneuma.study.store import Store

from ..cli.calls import refused
from .conftest import MakeTask


@pytest.fixture
def mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Put a package into the current folder that leaves a mark when it is imported; return the mark."""
    mark = tmp_path / "mark"
    (tmp_path / "marking" / "bare").mkdir(parents=True)
    (tmp_path / "marking" / "__init__.py").write_text(f"open({str(mark)!r}, 'w')\n")
    for name in ("deep", "bare/deeper"):
        (tmp_path / "marking" / f"{name}.py").write_text("1\n")
    monkeypatch.chdir(tmp_path)
    yield mark
    assert not mark.exists() and not any(name.startswith("marking") for name in sys.modules)


@pytest.mark.parametrize("module", ["marking.deep", "marking.bare.deeper"])
@pytest.mark.parametrize("named", [{"env_module": "{}"}, {"wrappers": "{}:Own"}, {"reward": "{}:own"}])
def test_untrusted_a_run_is_identified_by_a_modules_file_which_is_not_imported(
    mark: Path, module: str, named: dict[str, str]
) -> None:
    own = {} if "reward" in named else {"env": "CartPole-v1"}
    run = make_run({**own, **{key: value.format(module) for key, value in named.items()}})
    before = run_id(run)
    (mark.parent / (module.replace(".", "/") + ".py")).write_text("2\n")
    assert run_id(run) != before


def save_record(store: Store, task: Task) -> None:
    """Write the log of a search without trials."""
    path = log_path(store, task.search.label)
    store.check_writable()
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    begin_log(task, Journal(path))


SAFE: dict[str, Any] = {"env": "CartPole-v1"}
REWARD = '{"sutton_barto_reward": true}'
GAME = '{"env_path": "game"}'


@pytest.mark.usefixtures("mark")
@pytest.mark.parametrize(
    ("of_file", "of_record", "use"),
    [
        (SAFE, {"env_module": "marking.deep"}, "run the module marking.deep"),
        (SAFE, {"wrappers": ("marking.deep:Own",)}, "run the wrapper"),
        ({}, {"reward": ("marking.deep:own",)}, "run the reward"),
        ({}, {"level": "mine"}, "read the level"),
        ({}, {"characters": "mine.toml"}, "read the characters"),
        ({"env": "Godot-v0"}, {"env_kwargs": GAME}, "start the game"),
        ({"env_kwargs": GAME, **SAFE}, {"env": "Godot-v0"}, "start the game"),
        ({"env": "Godot-v0", "env_kwargs": '{"env_path": "mine"}'}, {"env_kwargs": GAME}, "start the game"),
        (SAFE, {"env_kwargs": '{"render_mode": "human"}'}, "make CartPole-v1 with"),
        (SAFE, {"env": "Acrobot-v1"}, "set env"),
    ],
)
def test_untrusted_a_record_adds_no_code_file_or_program_to_those_of_the_search_s_file(
    make_task: MakeTask, store: Store, of_file: dict[str, Any], of_record: dict[str, Any], use: str
) -> None:
    task = make_task(more="[run]\n" + "".join(f"{key} = '{value}'\n" for key, value in of_file.items()))
    world = "text" if task.search.has_worlds else None
    save_record(store, task)
    assert read_record(store, task.search.name, world).task == task
    save_record(store, replace(task, over=of_record))
    with pytest.raises(UserError, match=f"search formula would {use}.*only its file may say so"):
        read_record(store, task.search.name, world)
    worlds = ("--world", world) if world else ()
    assert use.split()[0] in refused("search", "promote", "formula", *worlds, "--results", store.root)


def test_untrusted_the_name_of_a_search_is_no_record_s(make_task: MakeTask, store: Store, mark: Path) -> None:
    task = make_task()
    save_record(store, replace(task, search=replace(task.search, name="unknown")))
    with pytest.raises(UserError, match="unknown search 'unknown'"):
        read_record(store, "unknown", "text")
