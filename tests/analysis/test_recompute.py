"""The published verdicts by another hand, which imports nothing of Pneuma and sees what is changed."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from .. import recompute_intervals, recompute_runs, recompute_verdicts
from ..cli.calls import described


def swap_groups(contrast: dict[str, Any]) -> None:
    """Swap the groups of a contrast under each other's names."""
    a, b = contrast["a"], contrast["b"]
    contrast["runs"] = {a: contrast["runs"][b], b: contrast["runs"][a]}
    contrast["effect"] *= -1
    for kind in ("", "simultaneous_"):
        low, high = contrast[f"{kind}low"], contrast[f"{kind}high"]
        contrast[f"{kind}low"], contrast[f"{kind}high"] = -high, -low


def test_another_hand_comes_to_the_same_verdicts_and_sees_every_change(tmp_path: Path) -> None:
    document = described("study", "verify", "--json", "--results", tmp_path)
    runs = recompute_runs.Runs()
    wrong, agreed = recompute_verdicts.check(document, runs)
    assert wrong == []
    assert min(agreed[what] for what in ("verdicts", "groups", "effects", "intervals")) >= 30
    verdicts = {(verdict["claim"], verdict["world"]): verdict for verdict in document["claims"]}
    verdicts["tanh-better", "text"]["verdict"] = "undecided"
    verdicts["tanh-better", "arena"]["contrasts"][0]["effect"] += 1e-4
    verdicts["sigmoid-frenzy", "text"]["contrasts"][0]["simultaneous_low"] -= 1e-4
    assert len(recompute_verdicts.check(document, runs)[0]) == 3
    swap_groups(verdicts["clip-alike", "arena"]["contrasts"][1])  # its verdict is the same either way
    differences = recompute_verdicts.check(document, runs)[0][2:]
    assert (
        sum("clip-alike arena late-share-killed" in text and ": groups: " in text for text in differences)
        == 2
    )


@pytest.mark.parametrize("hand", [recompute_verdicts, recompute_runs, recompute_intervals])
def test_the_other_hand_imports_nothing_of_pneuma(hand: ModuleType) -> None:
    nodes = [*ast.walk(ast.parse(Path(str(hand.__file__)).read_text(encoding="utf-8")))]
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += ["." * node.level + (node.module or "") for node in nodes if isinstance(node, ast.ImportFrom)]
    own = {name for name in names if name.startswith((".", "pneuma", "tests"))}
    assert own <= {".recompute_intervals", ".recompute_runs"} and "numpy" in names
