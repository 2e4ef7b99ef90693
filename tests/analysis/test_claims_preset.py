"""The preset `claims`: the runs that a file of claims fixes."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.analysis.claims.preset import fixed_amounts, with_claims
from pneuma.errors import UserError
from pneuma.study.spec import Study, load_study

from .claim_files import CLAIMS, write_files

STEADIER = """
[claims.steadier]
direction = "greater"
study = "mine.toml"
a = "high"
b = ["low", "middle"]
outcome = "final-share-killed"
seeds = { high = 4, low = [1, 7], middle = 1 }
worlds = ["text", "godot"]

[claims.of-another]
like = "better"
study = "activation"
a = "tanh"
b = "relu"
"""
FEW = CLAIMS.replace("seeds = 8", "seeds = 2")


def _study(folder: Path, claims: str = FEW + STEADIER, world: str = "text") -> Study:
    write_files(folder, claims)
    return load_study(str(folder / "mine.toml"), world)


def test_a_condition_has_the_seeds_of_all_claims_on_it_in_its_world(tmp_path: Path) -> None:
    (amounts,) = fixed_amounts(_study(tmp_path)).values()
    seeds = {condition: amount.seeds for condition, amount in amounts.items()}
    assert seeds == {"low": (0, 1, 7), "high": (0, 1, 2, 3), "middle": (0,)}
    (amounts,) = fixed_amounts(_study(tmp_path, world="godot")).values()
    assert amounts["low"].seeds == (1, 7)
    assert fixed_amounts(_study(tmp_path, world="arena")) == {}


def test_where_claims_fix_several_budgets_one_is_chosen(tmp_path: Path) -> None:
    study = _study(tmp_path, FEW + STEADIER.replace("seeds =", "steps = 512\nseeds ="))
    with pytest.raises(UserError, match="runs of 1,024 or 512 steps: choose with steps"):
        with_claims(study)
    preset = with_claims(study, 512).presets["claims"]
    assert {amount.steps for amount in preset.conditions.values()} == {512}
    assert [*with_claims(study, 1024).presets["claims"].conditions] == ["high", "low"]
