"""The published verdicts by another hand, which imports nothing of Pneuma and sees what is changed."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from .. import recompute_verdicts
from ..cli.calls import described


def test_another_hand_comes_to_the_same_verdicts_and_sees_every_change(tmp_path: Path) -> None:
    folder = recompute_verdicts.published_folder(tmp_path)
    told = described("study", "verify", "--json", "--results", folder)
    rows = recompute_verdicts.read_rows(folder / "published", told)
    wrong, agreed = recompute_verdicts.check(told, rows)
    assert wrong == []
    assert min(agreed[what] for what in ("verdicts", "effects", "intervals")) >= 30
    first, second, third = [
        one for one in told["claims"] if one["verdict"] != "untestable" and one["effect"]
    ][:3]
    first["verdict"] = "mixed"
    second["contrasts"][0]["effect"] += 1e-4
    third["contrasts"][0]["simultaneous_low"] -= 1e-4
    assert len(recompute_verdicts.check(told, rows)[0]) == 3


def test_the_other_hand_imports_nothing_of_pneuma() -> None:
    tree = ast.parse(Path(recompute_verdicts.__file__).read_text(encoding="utf-8"))
    imported = {
        name.partition(".")[0]
        for node in ast.walk(tree)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else []
        )
    }
    assert "pneuma" not in imported and "numpy" in imported
    with pytest.raises(KeyError):
        recompute_verdicts.value_of({}, "an outcome that it does not know")
