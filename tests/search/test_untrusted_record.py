"""A search's record in a results folder may be anybody's: it names no code, no file and no program."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.search.record import begin_record, log_path, read_record
from pneuma.store.store import Store
from pneuma.study.identity import run_id

from ..cli.calls import refused
from .conftest import MakeTask, task_of


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


@pytest.mark.usefixtures("mark")
@pytest.mark.parametrize("said", [{"env_module": "marking.deep"}, {"env": "Acrobot-v1"}, {"seed": 3}])
def test_untrusted_a_record_changes_nothing_of_what_the_search_s_file_says(
    make_task: MakeTask, store: Store, said: dict[str, Any]
) -> None:
    task = make_task(more='[run]\nenv = "CartPole-v1"\n')
    path = log_path(store, task.search.label)
    store.check_writable()
    path.parent.mkdir()
    begin_record(path, task, store)
    fixed = '"fixed":{"env":"CartPole-v1"}'
    assert path.read_text().count(fixed) == 1 and task_of(read_record(store, "formula")) == task
    path.write_text(
        path.read_text().replace(fixed, json.dumps({"fixed": {"env": "CartPole-v1", **said}})[1:-1])
    )
    told = f"the search had other fixed.{next(iter(said))} than its file"
    with pytest.raises(UserError, match=told):
        read_record(store, "formula")
    assert told in refused("search", "promote", "formula", "--results", store.root)
