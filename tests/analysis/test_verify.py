"""`pneuma study verify`: the JSON document, from runs and from what was published."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.cli import main
from pneuma.store.store import Store

from .claim_files import CLAIMS, HIGH, LOW, save_runs, write_files

Captured = pytest.CaptureFixture[str]

OTHER = CLAIMS[CLAIMS.index("[claims.better]") :].replace("better", "other").replace('"high"', '"middle"')


@pytest.fixture
def command(tmp_path: Path) -> list[str]:
    """A command over a folder with the runs of one claim and none of another's."""
    claims = write_files(tmp_path, CLAIMS + OTHER)
    save_runs(Store(tmp_path / "results"), tmp_path, {"high": HIGH, "low": LOW})
    return ["study", "verify", "--claims", str(claims), "--results", str(tmp_path / "results")]


def _document(captured: Captured, *arguments: str) -> Any:
    assert main([*arguments, "--json"]) == 0
    return json.loads(captured.readouterr().out)


def test_the_document_has_every_claim_in_its_worlds(
    command: list[str], tmp_path: Path, capsys: Captured
) -> None:
    document = _document(capsys, *command)
    (described,) = document["lists"]
    assert (described["alpha"], described["family_sizes"]) == (0.05, {"mine.toml text": 2})
    assert described["claims_hash"] == load_claims(tmp_path / "claims.toml").digest
    told = [(one["claim"], one["world"], one["verdict"]) for one in document["claims"]]
    assert told == [
        ("better", "text", "supported"),
        ("other", "text", "untestable"),
    ]
    first, missing = document["claims"]
    assert first["effect"] == pytest.approx(0.5)
    assert first["low"] < 0.5 < first["high"]
    assert (first["seeds_a"], first["seeds_b"], first["reason"]) == (8, 8, "")
    assert len(first["run_ids"]) == 16
    assert (missing["effect"], missing["low"]) == (None, None)
    (alone,) = _document(capsys, *command, "better")["claims"]  # whose correction is for the whole list
    assert alone == first
    assert missing["reason"] == (
        "no runs: middle, 8 seeds of 1,024 steps; "
        f"train with: pneuma study run {tmp_path / 'mine.toml'} --preset claims --world text "
        f"--results {tmp_path / 'results'}"
    )
