"""A tiny activation study that is really trained, once for all tests of commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..training_here import training_here
from .calls import TINY, printed


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with two conditions of two seeds, to read with `SETTINGS`; no test changes it."""
    results = tmp_path_factory.mktemp("trained") / "results"
    with training_here():
        printed("study", "run", "activation", *TINY, "--seeds", "2", "--quiet", "--results", results)
    return results


@pytest.fixture
def unshipped(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Leave out Pneuma's own published tables."""
    monkeypatch.setattr("pneuma.store.store.shipped_tables", lambda: tmp_path / "unshipped")
