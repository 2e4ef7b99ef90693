"""The preset `claims`: the runs that a file of claims fixes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from pneuma.analysis.claims.fixed_runs import with_claims
from pneuma.errors import UserError
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import Amount, Study, load_study

from .claim_files import write_files

CLAIMS = """\
[defaults]
seeds = 2
steps = 1024
outcome = "final-share-killed"
kind = "mean"

[claims.better]
quote = "a quote"
section = "6"
direction = "greater"
study = "mine.toml"
a = "high"
b = ["low", "middle"]

[claims.steadier]
quote = "a quote"
section = "6"
direction = "greater"
study = "mine.toml"
a = "high"
b = "low"
seeds = { high = 4, low = [1, 7] }
worlds = ["text"]

[claims.of-another]
quote = "a quote"
section = "6"
direction = "greater"
study = "activation"
a = "tanh"
b = "relu"
seeds = 9
"""


def _study(folder: Path, claims: str = CLAIMS, world: str = "text") -> Study:
    write_files(folder, claims)
    return load_study(str(folder / "mine.toml"), world)


def _preset(study: Study, steps: int | None = None) -> Mapping[str, Amount]:
    return with_claims(study, steps).presets["claims"].conditions


def _amount(*seeds: int) -> Amount:
    return Amount.model_construct(seeds=seeds, steps=1024)


def test_a_condition_has_the_seeds_of_all_claims_on_it(tmp_path: Path) -> None:
    assert _preset(_study(tmp_path)) == {
        "low": _amount(0, 1, 7),
        "high": _amount(0, 1, 2, 3),
        "middle": _amount(0, 1),
    }


def test_a_world_has_what_claims_about_it_fix(tmp_path: Path) -> None:
    there = _preset(_study(tmp_path, world="godot"))
    assert there == dict.fromkeys(("low", "middle", "high"), _amount(0, 1))


def test_where_claims_fix_several_budgets_one_is_chosen(tmp_path: Path) -> None:
    study = _study(tmp_path, CLAIMS.replace("seeds = { high", "steps = 512\nseeds = { high"))
    with pytest.raises(UserError, match="runs of 1,024 or 512 steps: say which with --steps"):
        _preset(study)
    assert {preset.steps for preset in _preset(study, 512).values()} == {512}
    assert "high" in _preset(study, 512)


def test_a_plan_has_the_conditions_of_claims_alone(tmp_path: Path) -> None:
    claims = CLAIMS[: CLAIMS.index("[claims.of-another]")].replace('b = ["low", "middle"]', 'b = "low"')
    plan = make_plan(with_claims(_study(tmp_path, claims)), Query(preset="claims"))
    assert [(cell.condition, cell.seed) for cell in plan.cells] == [
        ("low", 0), ("high", 0), ("low", 1), ("high", 1), ("low", 7), ("high", 2), ("high", 3),
    ]  # fmt: skip
