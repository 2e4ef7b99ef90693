"""All that `make figures` draws of published studies, without their runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pneuma.analysis.publishing import encode_study
from pneuma.figures import paper

from .hand_made import HandMade


@pytest.fixture(autouse=True)
def little_to_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the environment's own figures, which tests of theirs draw; one process has the rest."""
    monkeypatch.setattr(paper, "available_cores", lambda: 1)
    monkeypatch.setattr(paper, "_draw_environment", lambda folder: [])
    monkeypatch.setattr(paper, "_write_settings", lambda folder: [])


@pytest.fixture
def published(study: HandMade, tmp_path: Path) -> Path:
    """A results folder with two published studies alone."""
    data = study.data
    fresh = tmp_path / "fresh"
    (fresh / "published").mkdir(parents=True)
    for name in ("mine", "mine-godot"):
        data.study = name
        (fresh / "published" / study.store.published_path(name).name).write_bytes(encode_study(data))
    return fresh


def test_every_study_is_drawn_and_traced_to_its_runs(published: Path, tmp_path: Path) -> None:
    beside = {"mine": "mine-godot", "mine-godot": "nothing published"}
    written = paper.draw_all(tmp_path / "paper", published, beside)
    index = json.loads((tmp_path / "paper" / "index.json").read_bytes())["figures"]
    assert {entry["file"] for entry in index} == {
        str(path.relative_to(tmp_path / "paper"))
        for path in written
        if path.name not in ("index.json", "README.md") and path.stem != "verdicts"
    }
    drawn = {Path(entry["file"]).stem: entry for entry in index}
    for stem in ("fig-mine", "fig-mine-return-minmax-trailing-100", "fig-mine-godot-summary", "mine-godot"):
        assert drawn[stem]["command"] == "make figures"
    assert drawn["fig-mine"]["n"] == {"tanh": 2, "relu": 2}
    assert [entry["beside"] for entry in drawn.values() if "beside" in entry] == ["mine-godot"]
    assert "| Judged in |" in (tmp_path / "paper" / "verdicts.md").read_text()
    listed = (tmp_path / "paper/README.md").read_text()
    assert "- [fig-mine.png](fig-mine.png): curves: share killed" in listed


def test_what_is_drawn_no_more_is_removed_and_nothing_else(tmp_path: Path) -> None:
    mine, other = tmp_path / "mine.txt", tmp_path.parent / "other.png"
    drawn = tmp_path / "paper" / "fig-old.png"
    drawn.parent.mkdir()
    for path in (mine, other, drawn):
        path.write_bytes(b"")
    entries = [{"file": "fig-old.png"}, {"file": "../mine.txt"}, {"file": str(other)}]
    (tmp_path / "paper" / "index.json").write_text(json.dumps({"figures": entries}))
    paper.draw_all(tmp_path / "paper", tmp_path / "results")
    assert (drawn.exists(), mine.exists(), other.exists()) == (False, True, True)
