"""A claim of other arms, seeds or outcomes than at the commit that trained its runs is told by `verify`."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.claims.history import ABSENT, changed_since
from pneuma.study.store import Store

from ..cli.calls import printed
from .claim_files import CLAIMS, HIGH, LOW, save_runs, write_files


def commit(folder: Path) -> str:
    """Commit all files of a folder; return the commit."""
    for words in (["init"], ["add", "."], ["commit", "-m", "list"]):
        own = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(folder), *own, *words], check=True, capture_output=True)
    words = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    return subprocess.check_output(words, text=True).strip()


@pytest.mark.parametrize(
    ("old", "new", "keys"),
    [
        ("margin = 0.04", 'margin = 0.4\nnote = "other words"', []),
        ('a = "high"', 'a = ["high"]', []),
        ("seeds = 8", "seeds = { high = 8, low = 8 }", []),
        ('a = "high"', 'a = "middle"', ["a"]),
        ("seeds = 8", "seeds = 7", ["seeds"]),  # of the defaults
        ("[defaults]", "[list]\nseeds_from = 5\n[defaults]", ["seeds_from"]),
        ('"final-share-killed"', '["final-share-killed", "final-return"]', ["outcome"]),
        ("[claims.better]", "[claims.another]", [ABSENT]),
    ],
)
def test_what_decides_which_numbers_are_compared_counts(
    tmp_path: Path, old: str, new: str, keys: list[str]
) -> None:
    write_files(tmp_path)
    then = commit(tmp_path)
    assert CLAIMS.count(old) == 1
    claims = load_claims(write_files(tmp_path, CLAIMS.replace(old, new)))
    (name,) = claims.claims
    assert changed_since(claims, name, [then, "0" * 40, "None", "--help"]) == keys


def test_verify_tells_it(tmp_path: Path) -> None:
    path, results = write_files(tmp_path, CLAIMS.replace("seeds = 8", "seeds = 9")), tmp_path / "results"
    save_runs(Store(results), tmp_path, {"high": HIGH, "low": LOW}, commit=commit(tmp_path))
    told = "Not as it was at the commit that trained its runs: better (text): seeds."
    words = ["study", "verify", "--claims", path, "--results", results]
    assert told not in printed(*words)
    write_files(tmp_path)
    assert told in printed(*words)
    write_files(tmp_path, CLAIMS.replace("margin = 0.04", "margin = 0.04\nseen = true"))
    assert told not in printed(*words)  # that they were known before is said already
