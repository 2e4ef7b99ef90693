"""What of a claim was otherwise when its runs were trained, and how each verdict is labelled by it."""

from __future__ import annotations

import subprocess
import tomllib
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.claims import history
from pneuma.analysis.claims.claim_list import RULES, RULES_BEFORE, Claim, load_claims, shipped_claims
from pneuma.analysis.claims.history import THE_CLAIM, find_changes, refuse_changed
from pneuma.analysis.claims.verdicts import AMENDED, FAILS, PREREGISTERED, UNDECIDED
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.shipped import claims_history_file
from pneuma.study.spec import load_study
from tools.claims_history import ROOT, has_history, written

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
    assert find_changes(claims, claim, "text", [then, "0" * 40, "None", "--help"]) == (keys, RULES)
    assert find_changes(claims, claim, "text", ["0" * 40]) == (None, RULES)


@pytest.mark.parametrize(
    ("rules", "changed"), [(RULES, ()), (RULES_BEFORE, ()), (RULES_BEFORE - 1, ("rules",))]
)
def test_rules_by_which_nothing_can_be_judged_any_more_are_a_change(
    tmp_path: Path, rules: int, changed: tuple[str, ...]
) -> None:
    claims = load_claims(write_files(tmp_path))
    registered = RULES if rules == RULES else RULES_BEFORE
    found = find_changes(claims, claims.claims["better"], "text", [commit(tmp_path, rules)])
    assert found == (changed, registered)


@pytest.mark.parametrize(
    ("rules", "registered", "label", "changed"),
    [(RULES, FAILS, PREREGISTERED, []), (RULES_BEFORE, UNDECIDED, AMENDED, ["rules"])],
)
def test_the_rules_before_are_a_change_where_they_come_to_another_verdict(
    tmp_path: Path, rules: int, registered: str, label: str, changed: list[str]
) -> None:
    """All eight runs are equal, so that at most 37 % of all runs are others; before, that showed nothing."""
    path = write_files(tmp_path, CLAIMS.replace('b = "low"', "value = 0.6"))
    results = tmp_path / "results"
    save_runs(Store(results), tmp_path, {"high": [0.0] * 8}, commit=commit(tmp_path, rules))
    words = ["study", "verify", "--claims", path, "--results", results]
    (verdict,) = described(*words, "--json")["claims"]
    assert (verdict["verdict"], verdict["registered_verdict"]) == (FAILS, registered)
    assert (verdict["label"], verdict["changed"]) == (label, changed)
    assert verdict["contrasts"][0]["simultaneous_high"] == pytest.approx(1 - 0.025 ** (1 / 8) - 0.6)


@pytest.mark.parametrize(
    ("changes", "label", "changed"),
    [
        ([], "preregistered", []),
        ([("seeds = 8", "seeds = 7")], "amended", ["seeds"]),
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


THIRD, FOURTH = ("1dd170b7", "studies/claims.toml"), ("abbda55b", "docs/history/claims-4.toml")
INTERIM = "1bd68d2c", "studies/claims.toml"


@pytest.mark.skipif(not has_history(), reason="an installed package or a clone of depth 1 has no history")
def test_earlier_margins_are_those_of_the_commits_before_and_during_the_runs() -> None:
    """Runs of seeds below 1000 were fixed by the third list, unless it did not have the claim yet."""
    compared = 0
    for claim in shipped_claims()[0].claims.values():
        before = [THIRD, FOURTH, INTERIM] if claim.first_seed < 1000 else [FOURTH, INTERIM]
        for world, outcome in product(claim.worlds, claim.outcome):
            first = [stated_then(*then, claim, world, outcome) for then in before]
            interim = stated_then(*INTERIM, claim, world, outcome)
            if interim is not None:
                assert claim.registered_margin_of(world, outcome) == next(filter(None, first)), claim.name
                assert claim.interim_margin_of(world, outcome) == interim, claim.name
                compared += 1
    assert compared > 80


@cache
def list_then(commit: str, file: str) -> dict[str, Any]:
    words = ["git", "-C", str(ROOT), "show", f"{commit}:{file}"]
    return tomllib.loads(subprocess.run(words, check=True, capture_output=True, text=True).stdout)


def stated_then(commit: str, file: str, claim: Claim, world: str, outcome: str) -> float | None:
    """Return the margin of a claim at a commit; None if it did not have this kind and outcome there."""
    contents = list_then(commit, file)
    own = contents["claims"].get(claim.name, {})
    keys = {"kind": "mean", **contents["defaults"], **contents["claims"].get(own.get("like"), {}), **own}
    if not own or outcome not in keys["outcome"] or keys["kind"] != claim.kind:
        return None
    name = "incidence" if claim.is_incidence else outcome
    for margin, names in ((keys.get("margin"), (outcome, world)), (contents["margins"], (name, world))):
        for name in names:
            margin = margin.get(name) if isinstance(margin, dict) else margin
        if margin is not None:
            return float(margin)
    return None
