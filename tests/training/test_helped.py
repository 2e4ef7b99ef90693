"""Environments with processes of their own, trained by the command that people type."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pytest

from .commands import begin, wait_until
from .storm import wait_for_end

STUDY = """
title = "Helped"
[run]
env = "{env}"
env_module = "helped.py"
env_kwargs = {kwargs}
horizon = 64
minibatch = 32
epochs = 1
evaluation_episodes = 1
[conditions.one]
[presets.quick]
seeds = 1
steps = 128
"""


def write_study(folder: Path, env: str, kwargs: str = "{}") -> Path:
    shutil.copy(Path(__file__).with_name("helped.py"), folder)
    path = folder / "helped.toml"
    path.write_text(STUDY.format(env=env, kwargs=kwargs))
    return path


def helpers(folder: Path) -> list[int]:
    """Return the process ids that the environments have noted."""
    return [int(line) for line in (folder / "helpers").read_text().splitlines()]


@pytest.mark.parametrize("env", ["Forked-v0", "Subprocess-v0"])
def test_a_run_ends_although_its_environment_has_a_process(env: str, tmp_path: Path) -> None:
    """A fork has the worker's pipe of events, and a program that is terminated must not ignore it."""
    process = begin(tmp_path, write_study(tmp_path, env))
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert [row["status"] for row in json.loads(out)["runs"]] == ["done"]
    assert wait_for_end(helpers(tmp_path)) < 10


def test_a_worker_that_dies_is_noticed_although_a_fork_has_its_pipe_and_its_lock(tmp_path: Path) -> None:
    process = begin(tmp_path, write_study(tmp_path, "Forked-v0", '{ in_step_40 = "die" }'))
    out, err = process.communicate(timeout=120)
    (row,) = json.loads(out)["runs"]
    assert row["status"] == "killed", err
    assert err.count("the worker process was killed by SIGKILL") == 2  # it is tried twice
    assert "another process trains this run" not in err
    assert wait_for_end(helpers(tmp_path)) < 10


def test_ctrl_c_twice_ends_an_environments_process_too(tmp_path: Path) -> None:
    process = begin(tmp_path, write_study(tmp_path, "Forked-v0", '{ in_step_40 = "sleep" }'))
    wait_until(lambda: (tmp_path / "sleeps").exists(), seconds=120)
    process.send_signal(signal.SIGINT)
    assert process.stderr is not None
    assert "Stopping after this step" in next(line for line in process.stderr if "Stopping" in line)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=10)
    assert process.returncode == 130
    assert wait_for_end(helpers(tmp_path)) < 10


def test_an_environment_that_takes_the_process_for_its_own_can_be_stopped(tmp_path: Path) -> None:
    """Then it goes on, and the command ends although a thread of the environment does not."""
    study_path = write_study(tmp_path, "Possessive-v0")
    text = study_path.read_text()
    study_path.write_text(text.replace("steps = 128", "steps = 1_000_000"))
    process = begin(tmp_path, study_path.relative_to(tmp_path))
    wait_until(lambda: any(tmp_path.glob("results/runs/*/*")), seconds=120)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    study_path.write_text(text)
    out, err = begin(tmp_path, study_path.relative_to(tmp_path)).communicate(timeout=120)
    assert [row["status"] for row in json.loads(out)["runs"]] == ["done"], err
