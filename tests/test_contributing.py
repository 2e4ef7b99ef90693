"""CONTRIBUTING.md names files that exist, and pages name everything that can be chosen."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pneuma.algorithms import ALGORITHMS, OPTIMIZERS
from pneuma.analysis.outcomes import OUTCOMES
from pneuma.config import ACTIVATIONS
from pneuma.search.samplers import PRUNERS, SAMPLERS

ROOT = Path(__file__).parents[1]


def test_files_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    names = {*re.findall(r"`((?:\w+/)*\w+\.(?:py|toml|md))`", text)} - {"figures/NAME.py"}
    assert len(names) > 30
    for name in names:
        assert [*ROOT.glob(name), *ROOT.glob(f"pneuma/**/{name}"), *ROOT.glob(f"tests/**/{name}")], name


@pytest.mark.parametrize(
    ("page", "names"),
    [
        ("studies.md", [*OPTIMIZERS, *ACTIVATIONS]),
        ("search.md", [*SAMPLERS, *PRUNERS]),
        ("outcomes.md", [name for name in OUTCOMES if not name.startswith("final-action-")]),
        ("environments.md", ALGORITHMS),
    ],
)
def test_pages_name_what_can_be_chosen(page: str, names: list[str]) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    missing = [name for name in names if not re.search(rf'[` "]{name}[`",]', text)]
    assert not missing, f"docs/{page} does not name {', '.join(missing)}"
