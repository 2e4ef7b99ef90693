"""`pneuma doctor`: nothing is broken where the tests run."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.doctor import BROKEN, examine


@pytest.mark.slow
def test_nothing_is_broken_where_the_tests_run(tmp_path: Path) -> None:
    assert [finding for finding in examine(tmp_path) if finding.state == BROKEN] == []
