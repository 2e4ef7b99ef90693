"""The published verdicts by another hand, which imports nothing of Pneuma and sees what is changed."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType

import pytest

from .. import recompute_intervals, recompute_verdicts
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


@pytest.mark.parametrize("hand", [recompute_verdicts, recompute_intervals])
def test_the_other_hand_imports_nothing_of_pneuma(hand: ModuleType) -> None:
    nodes = [*ast.walk(ast.parse(Path(str(hand.__file__)).read_text(encoding="utf-8")))]
    names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    names += ["." * node.level + (node.module or "") for node in nodes if isinstance(node, ast.ImportFrom)]
    own = {name for name in names if name.startswith((".", "pneuma", "tests"))}
    assert own <= {".recompute_intervals"} and "numpy" in names
