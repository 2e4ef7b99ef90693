"""Fixtures of several folders: a results folder, and training in this process."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from pneuma.store.store import Store
from pneuma.training.executors.local import worker_environment

from .training_here import training_here

# As workers do: on one thread each, since several share the cores.
os.environ.update(worker_environment())
if "PYTHONPYCACHEPREFIX" in os.environ:  # as workers, commands that tests start keep byte code
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


@pytest.fixture(scope="session", autouse=True)
def _folders_of_learners(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Stable-Baselines3's own learners leave empty folders: here, in the tests' folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SB3_LOGDIR", str(tmp_path_factory.mktemp("learners")))
        yield


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """An empty results folder."""
    return Store(tmp_path / "results")


@pytest.fixture
def trains_here() -> Iterator[None]:
    """Let commands train in this process; see `training_here.py`."""
    with training_here():
        yield
