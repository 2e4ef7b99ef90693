"""What of a claim was otherwise when its runs were trained, and how each verdict is labelled by it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.analysis.claims import history
from pneuma.analysis.claims.claim_list import RULES, load_claims
from pneuma.analysis.claims.history import THE_CLAIM, changed_since, refuse_changed
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.shipped import claims_history_file
from pneuma.study.spec import load_study
from tools.claims_history import has_history, written

from ..checkout import commit_all
from ..cli.calls import described, printed
from .claim_files import CLAIMS, HIGH, LOW, save_runs, write_files


@pytest.fixture(autouse=True)
def own_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the test's folder for the checkout of Pneuma, whose judge has a version of its rules."""
    monkeypatch.setattr(history, "SOURCE", tmp_path.resolve())


def commit(folder: Path, rules: int = RULES) -> str:
    """Commit all files of a folder, and a judge with some rules; return the commit."""
    (folder / "pneuma").mkdir(parents=True, exist_ok=True)
    (folder / "pneuma" / "judge.py").write_text(f"RULES = {rules}\n")
    return commit_all(folder)


@pytest.mark.parametrize(
    ("old", "new", "keys"),
    [
        ("[claims.better]", '[claims.better]\nnote = "other words"', ()),
        ('a = "high"', 'a = ["high"]', ()),
        ("seeds = 8", "seeds = { high = 8, low = 8 }", ()),
        ("margin = 0.04", "margin = 0.4\nregistered_margin = 0.04", ()),  # the registered one is kept
        ("margin = 0.04", "margin = 0.4", ("margin",)),
        ("[defaults]", "[margins]\nfinal-share-killed = 0.1\n[defaults]", ()),  # the claim has its own
        ('a = "high"', 'a = "middle"', ("a",)),
        ("seeds = 8", "seeds = 7", ("seeds",)),  # of the defaults
        ("[defaults]", "[list]\nseeds_from = 5\n[defaults]", ("seeds",)),
        ('"final-share-killed"', '["final-share-killed", "final-return"]', ("outcome",)),
        ('"greater"', '"less"', ("direction",)),
        ('"greater"', '"greater"\nneed = "all"', ("need",)),
        ("[claims.better]", "[claims.another]", (THE_CLAIM,)),
    ],
)
def test_all_that_decides_a_verdict_counts(tmp_path: Path, old: str, new: str, keys: tuple[str, ...]) -> None:
    write_files(tmp_path)
    then = commit(tmp_path)
    assert CLAIMS.count(old) == 1
    claims = load_claims(write_files(tmp_path, CLAIMS.replace(old, new)))
    (claim,) = claims.claims.values()
    assert changed_since(claims, claim, "text", [then, "0" * 40, "None", "--help"]) == keys
    assert changed_since(claims, claim, "text", ["0" * 40]) is None


def test_other_rules_of_the_judge_are_a_change(tmp_path: Path) -> None:
    claims = load_claims(write_files(tmp_path))
    then = commit(tmp_path, RULES - 1)
    assert changed_since(claims, claims.claims["better"], "text", [then]) == ("rules",)


@pytest.mark.parametrize(
    ("changes", "label", "changed"),
    [
        ([], "preregistered", []),
        ([("seeds = 8", "seeds = 7")], "preregistered", ["seeds"]),
        ([('"greater"', '"different"')], "descriptive", ["direction"]),
        ([("margin = 0.04", "margin = 0.04\nseen = true")], "descriptive", []),
        (
            [("[defaults]", '[list]\nknown_below = 1\nknown_from = "list 3"\n[defaults]')],
            "same runs as list 3", [],
        ),
    ],
)  # fmt: skip
def test_a_verdict_has_a_label(
    tmp_path: Path, changes: list[tuple[str, str]], label: str, changed: list[str]
) -> None:
    path, results = write_files(tmp_path), tmp_path / "results"
    save_runs(Store(results), tmp_path, {"high": HIGH, "low": LOW}, commit=commit(tmp_path))
    text = CLAIMS
    for old, new in changes:
        text = text.replace(old, new)
    write_files(tmp_path, text)
    words = ["study", "verify", "--claims", path, "--results", results]
    (verdict,) = described(*words, "--json")["claims"]
    assert (verdict["label"], verdict["changed"]) == (label, changed)
    line = f"{label}; changed since the first run: {', '.join(changed)}" if changed else label
    assert line in [text.strip() for text in printed(*words).splitlines()]


def test_a_claim_whose_runs_are_of_no_known_commit_is_unverified(tmp_path: Path) -> None:
    path, results = write_files(tmp_path), tmp_path / "results"
    words = ["study", "verify", "--claims", path, "--results", results]
    (verdict,) = described(*words, "--json")["claims"]
    assert (verdict["label"], verdict["changed"]) == ("preregistered", None)  # there is no run yet
    save_runs(Store(results), tmp_path, {"high": HIGH, "low": LOW}, commit=commit(tmp_path / "elsewhere"))
    (verdict,) = described(*words, "--json")["claims"]
    assert (verdict["label"], verdict["changed"]) == ("unverified", None)


def test_a_preset_of_claims_that_were_changed_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    write_files(tmp_path)
    save_runs(store, tmp_path, {"high": HIGH}, commit=commit(tmp_path))
    study = load_study(str(tmp_path / "mine.toml"), "text")
    refuse_changed(RunIndex(store), study)
    write_files(tmp_path, CLAIMS.replace("margin = 0.04", "margin = 0.4"))
    with pytest.raises(UserError, match=r"preset='claims': the claim better was changed .*\(margin\)"):
        refuse_changed(RunIndex(store), study)


@pytest.mark.skipif(not has_history(), reason="an installed package or a clone of depth 1 has no history")
def test_what_the_package_says_of_its_claims_is_what_the_history_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.undo()  # the checkout of Pneuma is this one
    assert claims_history_file().read_text() == written(), "python -m tools.claims_history"
