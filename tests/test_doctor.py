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


def test_missing_and_old_packages_and_an_unknown_python_are_broken_and_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert (_find("packages", tmp_path).state, _find("python", tmp_path).state) == (GOOD, GOOD)
    needed = ["no-such>=1,<2", "numpy>=99", "pytest>=1", "x>=1; extra == 'y'"]
    monkeypatch.setattr(doctor, "requires", lambda _: needed)
    monkeypatch.setattr(doctor, "PYTHONS", ((3, 8), (3, 9)))
    found = _find("packages", tmp_path)
    assert found.state == BROKEN and found.told.startswith("no-such: not installed, needed is no-such")
    assert "numpy" in found.told and "pytest" not in found.told and "x:" not in found.told
    assert _find("python", tmp_path).state == BROKEN


@pytest.mark.slow
def test_the_trial_works_where_the_tests_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    assert [finding for finding in examine(tmp_path) if finding.state == BROKEN] == []
