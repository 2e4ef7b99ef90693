"""Functions that are compiled, and kept where there is a folder for them."""

from __future__ import annotations

from pathlib import Path

import pytest
from numba.core import caching

from pneuma.env.compiled import cached


def double(number: float) -> float:
    return 2 * number


def test_where_no_folder_can_be_written_it_compiles_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """As where another user installed it, and one's own home cannot be written."""
    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    compiled = cached(error_model="numpy")(double)
    assert compiled(3.0) == 6.0 and compiled.stats.cache_path is None


def test_where_one_can_it_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    compiled = cached(error_model="numpy")(double)
    assert compiled(3.0) == 6.0
    assert [path.suffix for path in sorted(tmp_path.rglob("*.nb?"))] == [".nbc", ".nbi"]
