"""The preset `claims`: exactly the runs that a file of claims fixes, each condition with its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.study.claimed import claims_preset
from pneuma.study.spec import Preset, Study, load_study

STUDY = """\
title = "Mine"
base = "table-6-2"

[conditions.low]
epochs = 5
[conditions.middle]
epochs = 6
[conditions.high]
epochs = 7
[conditions.unclaimed]
epochs = 8

[presets.quick]
seeds = 3
steps = 512
[presets.paper]
seeds = 2
steps = 1024
"""

CLAIMS = """\
[defaults]
seeds = 2
steps = 1024

[claims.better]
study = "mine.toml"
a = "high"
b = ["low", "middle"]

[claims.steadier]
study = "mine.toml"
a = "high"
b = "low"
seeds = { high = 4, low = [1, 7] }
worlds = ["text"]

[claims.of-another]
study = "activation"
a = "tanh"
seeds = 9
"""


def _study(folder: Path, claims: str = CLAIMS, world: str = "text") -> Study:
    (folder / "mine.toml").write_text(STUDY, encoding="utf-8")
    (folder / "claims.toml").write_text(claims, encoding="utf-8")
    return load_study(str(folder / "mine.toml"), world)


def test_a_condition_has_the_seeds_of_all_claims_on_it(tmp_path: Path) -> None:
    assert claims_preset(_study(tmp_path)) == {
        "low": Preset((0, 1, 7), 1024),
        "middle": Preset((0, 1), 1024),
        "high": Preset((0, 1, 2, 3), 1024),
    }


def test_a_world_has_what_claims_about_it_fix(tmp_path: Path) -> None:
    there = claims_preset(_study(tmp_path, world="godot"))
    assert there == dict.fromkeys(("low", "middle", "high"), Preset((0, 1), 1024))


def test_where_claims_fix_several_budgets_one_is_chosen(tmp_path: Path) -> None:
    study = _study(tmp_path, CLAIMS.replace("seeds = { high", "steps = 512\nseeds = { high"))
    with pytest.raises(UserError, match="runs of 1,024 or 512 steps: say which with --steps"):
        claims_preset(study)
    assert {preset.steps for preset in claims_preset(study, 512).values()} == {512}
    assert "high" in claims_preset(study, 512)
