"""What tests of the analysis share: an empty results folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.study.store import Store


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path / "results")
