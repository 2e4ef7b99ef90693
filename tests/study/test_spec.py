"""A study's file: what it contains, how it is crossed, messages on its mistakes, its worlds and its plans."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.study.plan import Query, differing_fields, make_plan
from pneuma.study.spec import Study, load_study

STUDY = """\
title = "Two activations"
section = "6.2"
figure = "two"
base = "table-6-2"
baseline = "relu"

[run]                       # what all conditions share
gradient_limit = 0.5

[conditions.tanh]
activation = "tanh"

[conditions.relu]
activation = "relu"

[presets.quick]
seeds = 3
steps = 50_000

[presets.paper]
seeds = [7, 3]
steps = 1_000_000
"""

CROSSED = """\
title = "T"
base = "table-6-2"
baseline = "relu"

[run]
epochs = 5

[factors]
learning_rate = [3e-4, 1e-3]
reward = ["thesis", "kills"]

[factors.betas]
stationary = { betas = [0.9, 0.999] }
fast = { betas = [0.9, 0.9], epsilon = 1e-6 }

[conditions.tanh]
activation = "tanh"

[conditions.relu]
activation = "relu"

[presets.quick]
seeds = 1
steps = 4096
"""


def _load(folder: Path, text: str, world: str = "text") -> Study:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return load_study(str(path), world)


# --- A file ---------------------------------------------------------------------------------


def test_a_study_has_what_its_file_contains(tmp_path: Path) -> None:
    study = _load(tmp_path, STUDY)
    assert (study.name, study.title, study.baseline) == ("mine", "Two activations", "relu")
    assert study.conditions == {"tanh": {"activation": "tanh"}, "relu": {"activation": "relu"}}
    presets = {name: (preset.seeds, preset.steps) for name, preset in study.presets.items()}
    assert study.figure == "two" and presets == {"quick": ((0, 1, 2), 50_000), "paper": ((7, 3), 1_000_000)}


def test_a_condition_overrides_shared_fields_and_these_the_base(tmp_path: Path) -> None:
    text = STUDY.replace("gradient_limit = 0.5", 'gradient_limit = "none"\nepochs = 4')
    study = _load(tmp_path, text.replace('"relu"\n\n[p', '"relu"\nepochs = 5\n\n[p'))
    assert study.fields("tanh")["horizon"] == 256  # of table 6.2
    assert study.fields("tanh")["gradient_limit"] is None
    assert [study.fields(name)["epochs"] for name in ("tanh", "relu")] == [4, 5]


# --- Crossed studies -----------------------------------------------------------------------------


def test_every_combination_is_a_condition_named_by_its_values(tmp_path: Path) -> None:
    study = _load(tmp_path, CROSSED)
    assert len(study.conditions) == 2 * 2 * 2 * 2
    name = "learning_rate=1e-3, reward=kills, fast, relu"
    assert study.conditions[name] == {
        "learning_rate": 1e-3, "reward": ("kills",), "betas": (0.9, 0.9), "epsilon": 1e-6,
        "activation": "relu",
    }  # fmt: skip
    assert study.levels[name] == {
        "learning_rate": "1e-3", "reward": "kills", "betas": "fast", "condition": "relu",
    }  # fmt: skip
    assert study.fields(name)["epochs"] == 5
    assert next(iter(study.conditions)) == "learning_rate=3e-4, reward=thesis, stationary, tanh"
    assert study.baseline == "learning_rate=3e-4, reward=thesis, stationary, relu"  # the first with it


# --- Mistakes ---------------------------------------------------------------------------------

MISTAKES: dict[str, tuple[str, str, str, int, tuple[str, ...]]] = {
    # name: (study, a text in it, what that becomes, line of the mistake, words of the message)
    "no baseline": (STUDY, 'baseline = "relu"', 'baseline = "rleu"', 5, ("'rleu'", "did you mean relu?")),
    "unfit": (STUDY, 'activation = "tanh"', "held_out_levels = 5", 11, ("held_out_levels = 5",)),
    "a long name": (STUDY, "[conditions.relu]", f"[conditions.{'x' * 1001}]", 13, ("at most 1000 letters",)),
    "a long title": (STUDY, 'title = "', f'title = "{"x" * 1001}', 1, ("1000",)),
    "twice": (CROSSED, "epsilon = 1e-6", 'reward = "godot"', 12, ("betas: fast", "reward", "another factor")),
    "values that do not go together": (
        CROSSED, "reward = [", "held_out_levels = [4, 5]\nreward = [", 10, ("held_out_levels",),
    ),
    "too many": (CROSSED, "[3e-4, 1e-3]", f"{[i / 1000 for i in range(1, 140)]}", 8, ("1,112 conditions",)),
    "one name for two": (
        CROSSED, "[factors.betas]",
        '[factors.first]\n"a" = { epochs = 3 }\n"a, b" = { epochs = 4 }\n'
        '[factors.second]\n"b, c" = { horizon = 512 }\n"c" = { horizon = 1024 }\n[factors.betas]',
        8, ("both called",),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_has_a_message_with_its_line(name: str, tmp_path: Path) -> None:
    text, old, new, line, words = MISTAKES[name]
    assert text.count(old) == 1
    with pytest.raises(UserError) as caught:
        _load(tmp_path, text.replace(old, new))
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'mine.toml'}, line {line}: ") and len(message.splitlines()) == 1
    assert all(word in message for word in words), message


# --- The worlds of a study ------------------------------------------------------------------------


def test_godots_world_is_the_published_code(tmp_path: Path) -> None:
    """By tests/env/rules.md: four slots, clip range 0.2, actor [256], and its environment."""
    text = STUDY.replace("[run]", '[run]\nenv = "pneuma/Pneuma-v0"')
    run = make_run(_load(tmp_path, text, "godot").fields("tanh"))
    assert (run.env, run.slots, run.clip_range, run.actor) == ("pneuma/PneumaGodot-v0", 4, 0.2, (256,))
    assert (run.scale, run.order, run.reward, run.activation) == ("raw", "fixed", ("godot",), "tanh")


def test_what_a_study_varies_or_sets_itself_stays_in_godots_world(tmp_path: Path) -> None:
    text = STUDY.replace('activation = "tanh"', "actor = [64]").replace("[run]", "[run]\nclip_range = 0.3")
    study = _load(tmp_path, text, "godot")
    runs = [make_run(study.fields(name)) for name in study.conditions]
    assert [run.actor for run in runs] == [(64,), (128,)]  # the second as in Table 6.2, not [256]
    assert [run.clip_range for run in runs] == [0.3, 0.3]


def test_a_name_finds_a_file_in_examples_and_before_it_one_here(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("examples").mkdir()
    Path("examples/mine.toml").write_text(STUDY.replace("Two activations", "An example"))
    assert load_study("mine").title == "An example"
    Path("mine.toml").write_text(STUDY)
    assert load_study("mine").title == "Two activations"
    assert load_study("examples/cartpole.toml").title == load_study("cartpole").title  # a shipped one's path


# --- Plans -----------------------------------------------------------------------------------------

OPTIMIZERS = """\
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
    path.write_text(OPTIMIZERS)
    return load_study(str(path))


def test_cells_go_seed_by_seed_in_the_studys_order_and_equal_conditions_are_named(study: Study) -> None:
    plan = make_plan(study, Query())
    assert plan.conditions == ("adam", "sgd", "also-adam")
    cells = [(cell.seed, cell.condition) for cell in plan.cells]
    assert cells == [(seed, condition) for seed in (0, 1) for condition in plan.conditions]
    assert [note for note in plan.notes if "identical settings" in note and "adam, also-adam" in note]
    first, _, third = plan.cells[:3]
    assert first.run_id == third.run_id


def test_conditions_whose_updates_round_a_budget_differently_are_named(tmp_path: Path) -> None:
    """8 rollouts of 2,048 steps, 3,200 of 5, and 63 records of 256 are the first with 16,000."""
    path = tmp_path / "learners.toml"
    conditions = "".join(f'[conditions.{name}]\nalgorithm = "{name}"\n' for name in ("ppo", "a2c", "dqn"))
    path.write_text(
        f'title = "L"\n[run]\nenv = "CartPole-v1"\n{conditions}[presets.quick]\nseeds = 1\nsteps = 16_000\n'
    )
    study = load_study(str(path))
    amounts = "whole updates are trained, so that steps differ: ppo 16,384, a2c 16,000, dqn 16,128"
    assert amounts in make_plan(study, Query()).notes
    alone = make_plan(study, Query(conditions=("ppo",)))
    assert not any("whole updates" in note for note in alone.notes)


def test_fields_in_which_conditions_differ_are_found(study: Study) -> None:
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
    path.write_text(OPTIMIZERS.replace('"sgd"\n', '"upgd"\n') + '[run]\nenv = "Pendulum-v1"\n')
    study = load_study(str(path))
    with pytest.raises(UserError, match="optimizer = upgd is not allowed: the engine sb3 lacks it"):
        make_plan(study, Query())


def test_a_preset_may_have_other_seeds_and_steps_for_one_condition(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"{OPTIMIZERS}[presets.quick.conditions.sgd]\nseeds = [1]\nsteps = 1_024\n")
    plan = make_plan(load_study(str(path)), Query(conditions=("adam", "sgd")))
    assert [(cell.condition, cell.seed, cell.run.steps) for cell in plan.cells] == [
        ("adam", 0, 50_000), ("adam", 1, 50_000), ("sgd", 1, 1024),
    ]  # fmt: skip
