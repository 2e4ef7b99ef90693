"""What factors of a crossed study do, by hand, and the short names of its conditions."""

from __future__ import annotations

from pathlib import Path

import pytest
from scipy import stats

from pneuma.analysis.factors import compare_factors
from pneuma.api import compare, open_data
from pneuma.config import as_fields
from pneuma.errors import UserError
from pneuma.figures.grid import Page
from pneuma.figures.heat_map import heat_map_page
from pneuma.store.store import Store
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from ..cli.calls import call, printed
from ..hand_made import save_run

TOML = """
title = "Crossed"
baseline = "1e-3, 0.9, 4"
[run]
env = "CartPole-v1"
engine = "sb3"
[factors]
learning_rate = [1e-3, 1e-4]
gamma = [0.9, 0.99]
epochs = [4, 8]
[labels]
"gamma=0.9" = "short-sighted"
[presets.quick]
seeds = 5
steps = 4_096
[presets.part]
seeds = 2
steps = 4_096
only = ["1e-3, 0.9, 4", "1e-4, 0.9, 4"]
[presets.part.conditions."1e-4, 0.9, 4"]
seeds = 3
"""
MEANS = {("1e-3", "0.9"): 1.0, ("1e-3", "0.99"): 2.0, ("1e-4", "0.9"): 4.0, ("1e-4", "0.99"): 9.0}


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Five runs in each condition, at -2 to 2 around its mean; with 8 epochs they return 10 more."""
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "crossed.toml"
    path.write_text(TOML)
    store = Store(tmp_path / "results")
    for cell in make_plan(load_study(str(path)), Query()).cells:
        rate, gamma, epochs = cell.condition.replace("=", ", ").split(", ")[1::2]
        value = MEANS[rate, gamma] + cell.seed - 2 + 10 * (epochs == "8")
        step = cell.run.steps
        evaluated = {"step": step, "return": value, "random_return": 0.0, "random_spread": 1.0}
        identity = config_id(cell.run)
        save_run(store, run_id(cell.run), [], [], [evaluated], step, "done", as_fields(cell.run), identity)
    return path


def test_main_effects_and_the_interaction_have_their_welch_intervals(study: Path) -> None:
    """The variance of a condition's runs is 2.5, so that of its mean is 0.5, and all have as many runs."""
    answer = compare(study, "learning_rate", "gamma")
    means = answer.table.set_index(["level_a", "level_b"])["value"].to_dict()
    assert means == {levels: mean + 5 for levels, mean in MEANS.items()}  # over both numbers of epochs
    effects = answer.tables["effects"].set_index("effect")
    expected = {  # each, and its variance: of eight means times 1/4, and twice as large for the last
        "learning rate: 1e-4 − 1e-3": ((4 + 9) / 2 - (1 + 2) / 2, 8 * 0.5 / 16),
        "gamma: 0.99 − short-sighted": ((2 + 9) / 2 - (1 + 4) / 2, 8 * 0.5 / 16),
        "interaction: 1e-4 − 1e-3 at 0.99 minus at short-sighted": ((9 - 2) - (4 - 1), 4 * 8 * 0.5 / 16),
    }
    assert list(effects.index) == list(expected)
    for effect, (value, variance) in expected.items():
        half_width = stats.t.ppf(0.975, 8 * 4) * variance**0.5
        assert effects.loc[effect, "value"] == pytest.approx(value)
        assert effects.loc[effect, "low"] == pytest.approx(value - half_width)
        assert effects.loc[effect, "high"] == pytest.approx(value + half_width)
    assert "Averaged over epochs." in answer.notes
    text = printed("study", "compare", study, "learning_rate", "gamma")
    assert "short-sighted" in text and "gamma 0.99" in text
    few = compare_factors(open_data(study, seeds=4), "gamma", "epochs").tables["effects"]
    assert few["low"].isna().all()  # of four runs


def test_the_heat_map_has_the_means(study: Path) -> None:
    page: Page = heat_map_page(compare_factors(open_data(study), "gamma", "learning_rate"))
    (panel,) = page.grid[0]
    assert panel and panel.rows == ["short-sighted", "gamma 0.99"]
    assert panel.columns == ["learning rate 1e-3", "learning rate 1e-4"]
    printed("study", "plot", study, "--figure", "factors", "--out", "map.svg")
    drawn = Path("map.svg").read_text()
    for words in (
        "short-sighted",
        "learning rate 1e-4",
        "14.0",
        "means by two factors",
        "Averaged over epochs",
    ):
        assert words in drawn
    alone = ("--condition", "1e-3, 0.9, 4", "--condition", "1e-4, 0.9, 4")
    called = call("study", "plot", study, "--figure", "factors", *alone, "--out", "map.svg")
    assert called.code == 2 and "--figure factors requires two factors" in called.err


def test_a_condition_may_be_named_by_its_levels(study: Path) -> None:
    short, full = "1e-4, 0.99, 8", "learning_rate=1e-4, gamma=0.99, epochs=8"
    assert load_study(str(study)).baseline == "learning_rate=1e-3, gamma=0.9, epochs=4"
    row = compare(study, short, "1e-3, 0.9, 4").table.iloc[0]
    assert (row["a"], row["difference"]) == (full, 18)
    document = call("study", "summary", study, "--condition", short, "--json").document
    assert {row["condition"] for row in document["summary"]} == {full}
    part = make_plan(load_study(str(study)), Query(preset="part")).cells
    assert [(cell.condition[14:18], cell.seed) for cell in part] == [
        ("1e-3", 0), ("1e-4", 0), ("1e-3", 1), ("1e-4", 1), ("1e-4", 2),
    ]  # fmt: skip
    swept = Query(settings={"minibatch": "32,64"}, conditions=(f"{short}, 64",))
    assert {cell.condition for cell in make_plan(load_study(str(study)), swept).cells} == {
        f"{full}, minibatch=64"
    }


def test_what_has_no_effects_is_refused(study: Path) -> None:
    compared = ("study", "compare", study)
    assert (
        "unknown factor of study crossed 'gama' (did you mean gamma?)"
        in call(*compared, "gama", "epochs").err
    )
    three = [
        word for name in ("1e-3, 0.9, 4", "1e-4, 0.9, 4", "1e-4, 0.99, 4") for word in ("--condition", name)
    ]
    message = call(*compared, "learning_rate", "gamma", *three).err
    assert (
        "no condition has learning_rate 1e-3 and gamma 0.99" in message and "some with --condition" in message
    )


def test_pairs_with_other_levels_of_a_third_factor_are_refused(study: Path) -> None:
    """An effect of the third factor would be taken for one of the others."""
    conditions = list(open_data(study).conditions)
    with pytest.raises(UserError, match="different levels of other factors"):
        compare_factors(open_data(study, conditions=conditions[1:]), "learning_rate", "gamma")
