"""A plan: which runs a selection of a study means, in what order, and what a person is told of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import as_fields
from pneuma.errors import UserError
from pneuma.study.plan import Query, differing_fields, make_plan
from pneuma.study.spec import Study, load_study

STUDY = """\
title = "Optimizers"
base = "table-6-2"
[conditions.adam]
[conditions.sgd]
optimizer = "sgd"
[conditions.also-adam]
optimizer = "adam"
epsilon = 1e-5
[presets.quick]
seeds = 2
steps = 50_000
[presets.paper]
seeds = [9, 4]
steps = 1_024
"""


@pytest.fixture
def study(tmp_path: Path) -> Study:
    path = tmp_path / "optimizers.toml"
    path.write_text(STUDY)
    return load_study(str(path))


def test_cells_go_seed_by_seed_in_the_studys_order_and_equal_conditions_are_named(study: Study) -> None:
    plan = make_plan(study, Query())
    assert plan.conditions == ("adam", "sgd", "also-adam")
    cells = [(cell.seed, cell.condition) for cell in plan.cells]
    assert cells == [(seed, condition) for seed in (0, 1) for condition in plan.conditions]
    assert [note for note in plan.notes if "identical settings" in note and "adam, also-adam" in note]
    first, _, third = plan.cells[:3]
    assert first.run_id == third.run_id


def test_what_differs_between_conditions_is_told(study: Study) -> None:
    plan = make_plan(study, Query(conditions=("adam", "sgd")))
    differing = differing_fields({cell.condition: as_fields(cell.run) for cell in plan.cells})
    # Adam reads betas (0.9, 0.9) and epsilon 1e-5; SGD momentum 0 and dampening 0
    assert differing == {
        "optimizer": {"adam": "adam", "sgd": "sgd"},
        "betas": {"adam": [0.9, 0.9], "sgd": None},
        "epsilon": {"adam": 1e-5, "sgd": None},
        "momentum": {"adam": None, "sgd": 0.0},
        "dampening": {"adam": None, "sgd": 0.0},
    }


def test_an_optimizer_that_the_only_possible_engine_lacks_is_refused(tmp_path: Path) -> None:
    """Pendulum's actions are numbers, which the engine sb3 alone trains; UPGD is of batched alone."""
    path = tmp_path / "mine.toml"
    path.write_text(STUDY.replace('"sgd"\n', '"upgd"\n') + '[run]\nenv = "Pendulum-v1"\n')
    study = load_study(str(path))
    with pytest.raises(UserError, match="optimizer = upgd is not allowed: the engine sb3 lacks it"):
        make_plan(study, Query())


# --- Presets of single conditions ------------------------------------------------------------------


def test_a_preset_may_say_less_for_one_condition(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"{STUDY}[presets.quick.conditions.sgd]\nseeds = [1]\nsteps = 1_024\n")
    plan = make_plan(load_study(str(path)), Query(conditions=("adam", "sgd")))
    assert [(cell.condition, cell.seed, cell.run.steps) for cell in plan.cells] == [
        ("adam", 0, 50_176), ("adam", 1, 50_176), ("sgd", 1, 1024),
    ]  # fmt: skip
    plan = make_plan(load_study(str(path)), Query(seeds=(5,), steps=512, conditions=("adam", "sgd")))
    assert [(cell.condition, cell.seed, cell.run.steps) for cell in plan.cells] == [
        ("adam", 5, 512), ("sgd", 5, 512),
    ]  # fmt: skip
