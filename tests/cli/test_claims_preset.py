"""The preset `claims` is trained from committed code alone."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from pneuma.cli import study_run
from pneuma.store.provenance import uncommitted

from .calls import refused


def test_only_changes_of_code_and_studies_count(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        own = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(tmp_path), *own, *words], check=True, capture_output=True)

    (tmp_path / "pneuma").mkdir()
    (tmp_path / "pneuma" / "code.py").write_text("1")
    assert uncommitted(tmp_path) == []  # an installed copy has no tree
    git("init")
    git("add", ".")
    git("commit", "-m", "first")
    assert uncommitted(tmp_path) == []
    (tmp_path / "notes.md").write_text("mine")
    assert uncommitted(tmp_path) == []
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "new.toml").write_text("")
    (tmp_path / "pneuma" / "code.py").write_text("2")
    assert uncommitted(tmp_path) == ["pneuma/code.py", "studies/"]


def test_claims_are_not_trained_from_a_changed_tree(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(study_run, "uncommitted", lambda: ["pneuma/engines/ppo.py", "studies/early.toml"])
    told = refused("study", "run", "activation", "--preset", "claims", "--results", tmp_path / "results")
    assert "pneuma/engines/ppo.py is not as committed (2 files" in told
    assert not (tmp_path / "results").exists()
