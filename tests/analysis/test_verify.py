"""`pneuma study verify`: the JSON document, from runs and from what was published, and what people read."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.power import seeds_for_means
from pneuma.store.store import Store

from ..cli.calls import described, printed, refused
from .claim_files import BETTER, CLAIMS, HIGH, LOW, save_runs, write_files

OTHER = BETTER.replace("better", "other").replace('"high"', '"middle"')


def test_all_views_have_every_claim_in_its_worlds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One claim has all its runs, and the other none of one condition."""
    monkeypatch.chdir(tmp_path)  # paths are shown from the current folder
    path = write_files(tmp_path, CLAIMS + OTHER)
    save_runs(Store(tmp_path / "results"), tmp_path, {"high": HIGH, "low": LOW})
    command = ["study", "verify", "--claims", path, "--results", tmp_path / "results"]
    document = described(*command, "--json")
    (listed,) = document["lists"]
    assert (listed["alpha"], listed["claims_hash"]) == (0.05, load_claims(path).digest)
    first, missing = document["claims"]
    verdicts = [(verdict["claim"], verdict["world"], verdict["verdict"]) for verdict in document["claims"]]
    assert verdicts == [("better", "text", "holds"), ("other", "text", "not tested")]
    assert first["effect"] == pytest.approx(0.5) and first["low"] < 0.5 < first["high"]
    assert (first["alpha"], first["margin"], first["reason"]) == (0.025, 0.04, "")
    assert (first["seeds_a"], first["seeds_b"], len(first["run_ids"])) == (8, 8, 16)
    assert (missing["effect"], missing["low"]) == (None, None)
    trains = (
        "train with: pneuma study run mine.toml --world text --condition middle "
        f"--condition low --seeds 0..7 --steps 1024 --results {tmp_path / 'results'}"
    )
    lacking = "runs missing: middle has 0 of the 8 fixed ones with 1,024 steps"
    assert missing["reason"] == f"{lacking}; {trains}"
    (alone,) = described(*command, "better", "--json")["claims"]  # whose correction is for the whole list
    assert alone == first
    assert "high against low, 8 and 8 runs\n" in printed(*command, "better")
    lines = printed(*command).splitlines()
    (shown,) = [line.split() for line in lines if "holds   " in line]
    assert " ".join(shown) == "text holds kills 74 against 24 % (47 to 53; ±4.0)"
    assert "partly trained" in "\n".join(lines) and "Read 16 runs from" in lines[-1]


def test_seeds_are_planned_by_the_level_of_a_list(tmp_path: Path) -> None:
    """By two contrasts: 97.5 %; for an SD of the difference of two, more seeds than by 95 %."""
    path = write_files(tmp_path, CLAIMS + OTHER)
    words = ["study", "plan", tmp_path / "mine.toml", "--world", "text", "--detect", "1", "--sd", "1"]
    alone, jointly = printed(*words), printed(*words, "--claims", path)
    assert "the 95 % interval" in alone and "the 97.5 % interval" in jointly
    seeds = [int(text.split("seeds\n")[1].split()[1]) for text in (alone, jointly)]
    assert seeds == [seeds_for_means(1, 1, 1), seeds_for_means(1, 1, 1, level=0.975)]
    assert "--claims requires --detect" in refused(*words[:3], "--claims", path)
