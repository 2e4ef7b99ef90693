"""`study plot`: what it refuses, and the index that leads from a figure to its command and runs."""

from __future__ import annotations

import hashlib
import json
import shlex
from pathlib import Path
from typing import Any

import pytest

from ..figures.hand_made import HandMade
from .calls import call

IDS = {"tanh": ["aaaaaaaaaaaaaaa0", "aaaaaaaaaaaaaaa1"], "relu": ["bbbbbbbbbbbbbbb0"]}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with a study called 'mine' of three runs."""
    study = HandMade(tmp_path)
    for condition, ids in IDS.items():
        for seed, run_id in enumerate(ids):
            study.add(condition, seed, run_id=run_id)
    selection = dict.fromkeys(("preset", "seeds", "steps", "engine"))
    study.record |= {"selection": {**selection, "conditions": [], "settings": {}}, "path": None}
    study.store.save_selection("mine", {**study.record, "baseline": "tanh"})
    return study.store.root


def _index(folder: Path) -> dict[str, dict[str, Any]]:
    document = json.loads((folder / "index.json").read_text(encoding="utf-8"))
    assert document["schema"] == 1
    return {entry["file"]: entry for entry in document["figures"]}


@pytest.mark.parametrize(
    ("options", "name"),
    [
        (("--quantity", "actions", "--band", "minmax"), None),
        (("--figure", "summary"), "fig-mine-summary.svg"),
        (("compare", "tanh", "relu", "--plot"), "fig-mine-compare-tanh-relu.svg"),
        (
            ("--window", "trailing-100", "--condition", "tanh", "--seeds", "1"),
            "fig-mine-tanh-seeds-0-trailing-100.svg",
        ),
    ],
)
def test_the_index_tells_runs_and_a_command_that_draws_the_same_bytes(
    results: Path, tmp_path: Path, options: tuple[str, ...], name: str | None
) -> None:
    verb, words = ("compare", options[1:]) if options[0] == "compare" else ("plot", options)
    assert call("study", verb, "mine", *words, "--format", "svg", "--results", results)[0] == 0
    ((file, entry),) = _index(results / "figures").items()
    assert name in (None, file)
    drawn = (results / "figures" / file).read_bytes()
    assert entry["sha256"] == hashlib.sha256(drawn).hexdigest()
    assert entry["from"] == "study mine" and entry["runs"]["tanh"][0] == IDS["tanh"][0]
    assert entry["environments"] == ["pneuma/Pneuma-v0"]
    command, *again = shlex.split(entry["command"])
    assert command == "pneuma"
    assert call(*again, "--results", results, "--out", tmp_path / "again")[0] == 0
    assert {path.name for path in (tmp_path / "again").iterdir()} == {file, "index.json"}
    assert (tmp_path / "again" / file).read_bytes() == drawn


def test_a_file_that_is_no_index_is_never_replaced(results: Path, tmp_path: Path) -> None:
    out = tmp_path / "site"
    out.mkdir()
    for there in ("[]", "not JSON", '{"figures": [{"file": 3}]}'):
        (out / "index.json").write_text(there, encoding="utf-8")
        code, _, said = call("study", "plot", "mine", "--out", out, "--results", results)
        assert code == 2 and "is no index of figures" in said
        assert [path.name for path in out.iterdir()] == ["index.json"]
        assert (out / "index.json").read_text(encoding="utf-8") == there
