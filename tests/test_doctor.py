"""`pneuma doctor`: it finds what is wrong, says what to do, and changes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma import doctor
from pneuma.doctor import BROKEN, GOOD, Finding, examine


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes seconds."""
    monkeypatch.setattr(doctor, "TRIAL", "print('well')")


def _find(check: str, results: Path) -> Finding:
    (finding,) = [finding for finding in examine(results) if finding.check == check]
    return finding


def test_an_unknown_python_is_broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert _find("python", tmp_path).state == GOOD
    monkeypatch.setattr(doctor, "PYTHONS", ((3, 8), (3, 9)))
    assert _find("python", tmp_path).state == BROKEN


@pytest.mark.slow
def test_the_trial_works_where_the_tests_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    assert [finding for finding in examine(tmp_path) if finding.state == BROKEN] == []
