"""What a run is called: the same for the same bits, another for anything that could change them."""

from __future__ import annotations

import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from pneuma.algorithms import MAILMAN
from pneuma.config import Run, make_run
from pneuma.env.level import LEVELS
from pneuma.errors import UserError
from pneuma.study import identity
from pneuma.study.identity import run_id
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study

ACTIVATION_QUICK_SEED_0 = {
    "tanh": "044a83d2515676df",
    "relu": "63b62db827f7bf47",
    "leaky-relu": "0f86b74715fa6f79",
}
"""Stored runs are found by these: a change here retrains everybody's runs. Change it on purpose only."""

OTHER: dict[str, Any] = {
    "players": 2,
    "classes": "tank",
    "weapons": "lance",
    "magic": True,
    "reward": "kills",
    "observation": "pygame",
    "perceive": "nearest:3",
    "order": "fixed",
    "scale": "raw",
    "start": "first",
    "observe_facing": True,
    "bodies": "pass",
    "coast": "deadly",
    "trees": "pass",
    "terrain_stops": "players",
    "bite_while_knocked": True,
    "healing_cap": True,
    "kill_credit": "near",
    "xp_scope": "forever",
    "ending_cost": 1.0,
    "time_limit": "terminate",
    "characters": "pygame",
    "env": "pneuma/PneumaGodot-v0",
    "episode_steps": 500,
    "end_on_clear": True,
    "seed": 1,
    "steps": 100_000,
    "slots": 2,
    "actor": [64],
    "critic": [64],
    "activation": "relu",
    "gamma": 0.98,
    "gae_lambda": 0.9,
    "learning_rate": 1e-3,
    "clip_range": 0.2,
    "horizon": 128,
    "minibatch": 32,
    "epochs": 9,
    "value_coefficient": 1.0,
    "entropy_coefficient": 0.0,
    "gradient_limit": "none",
    "clip": "separate",
    "optimizer": "sgd",
    "betas": [0.9, 0.9],
    "epsilon": 1e-8,
    "weight_decay": 0.01,
    "evaluation_episodes": 20,
    "parent": "0123456789abcdef",
    "fork_step": 256,
    "fork_reset": "optimizer",
}
"""For every field with more than one value, one that is not the default."""

OF_OTHER_OPTIMIZERS = {
    "momentum": ("sgd", 0.9),
    "dampening": ("sgd", 0.9),
    "smoothing": ("rmsprop", 0.9),
    "utility_decay": ("upgd", 0.99),
    "noise": ("upgd", 0.01),
}
OF_OTHER_ALGORITHMS: dict[str, tuple[dict[str, Any], Any]] = {
    "algorithm": ({"algorithm": "dqn"}, "double-dqn"),
    "value_baseline": ({"algorithm": "a2c"}, False),
    "target_kl": ({"algorithm": "trpo"}, 0.02),
    "conjugate_steps": ({"algorithm": "trpo"}, 10),
    "line_search_steps": ({"algorithm": "trpo"}, 20),
    "exploration": ({"algorithm": "dqn"}, 0.1),
    "exploration_fraction": ({"algorithm": "dqn"}, 0.5),
    "buffer_size": ({"algorithm": "dqn"}, 64),
    "learning_starts": ({"algorithm": "dqn"}, 1000),
    "train_every": ({"algorithm": "dqn"}, 8),
    "gradient_steps": ({"algorithm": "dqn"}, 2),
    "target_every": ({"algorithm": "dqn"}, 1),
    "action_slip": ({"algorithm": "q-learning", "env": MAILMAN}, 0.1),
    "reward_noise": ({"algorithm": "q-learning", "env": MAILMAN}, 1.0),
}
"""For every field that PPO does not read, fields under which it is, and a value that is not the default."""

OF_ONE_VALUE = {"engine"}


def test_every_field_of_a_run_is_tested_here() -> None:
    several = {*OF_OTHER_OPTIMIZERS, *OF_OTHER_ALGORITHMS, *OF_ONE_VALUE}
    tested = {*OTHER, *several, "level", "random_levels", "held_out_levels"}
    assert tested == {item.name for item in fields(Run)}


def test_the_shipped_studys_runs_keep_their_names() -> None:
    cells = make_plan(load_study("activation"), Selection(preset="quick", seeds=(0,))).cells
    assert {cell.condition: cell.run_id for cell in cells} == ACTIVATION_QUICK_SEED_0


def test_every_field_changes_the_name() -> None:
    usual = run_id(make_run({}))
    for key, value in OTHER.items():
        assert run_id(make_run({key: value})) != usual, key
    for key, (optimizer, value) in OF_OTHER_OPTIMIZERS.items():
        given = {"optimizer": optimizer, **({"momentum": 0.5} if key == "dampening" else {})}
        assert run_id(make_run({**given, key: value})) != run_id(make_run(given)), key
        assert run_id(make_run({key: value})) == usual, key  # Adam reads none of them
    for key, (other, value) in OF_OTHER_ALGORITHMS.items():
        assert run_id(make_run({**other, key: value})) != run_id(make_run(other)), key
        if key not in ("algorithm", "value_baseline"):
            assert run_id(make_run({key: value})) == usual, key  # PPO reads none of them


def test_a_run_of_an_older_version_is_the_same_run_still() -> None:
    assert run_id(make_run({"learners": "shared"})) == run_id(make_run({}))
    with pytest.raises(UserError, match="learners"):
        make_run({"learners": "independent"})


@pytest.mark.parametrize("version", ["RULES_VERSION", "ENGINE_VERSIONS"])
def test_a_raised_version_changes_the_name(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = run_id(make_run({}))
    monkeypatch.setattr(identity, version, 99 if version == "RULES_VERSION" else {"batched": 99, "sb3": 99})
    assert run_id(make_run({})) != before


def test_the_same_run_has_one_name_in_two_studies(tmp_path: Path) -> None:
    presets = "[presets.quick]\nseeds = 1\nsteps = 256\n"
    one, two = tmp_path / "one.toml", tmp_path / "two.toml"
    one.write_text(f'title = "A"\nbase = "table-6-2"\n[conditions.a]\n{presets}')
    two.write_text(
        f'title = "B"\nfigure = "b"\nbase = "table-6-2"\n[run]\nepochs = 10\n[conditions.b]\n{presets}'
    )
    (first,), (second,) = (make_plan(load_study(str(path)), Selection()).cells for path in (one, two))
    assert first.run_id == second.run_id


# --- Levels of a user's own ----------------------------------------------------------------------


@pytest.fixture
def level(tmp_path: Path) -> Path:
    return Path(shutil.copytree(LEVELS / "thesis", tmp_path / "mine"))


def _name(level: Path | str) -> str:
    return run_id(make_run({"level": str(level)}))


@pytest.mark.parametrize("file", ["level.toml", "ground.csv", "obstacles.csv", "objects.csv"])
def test_the_contents_of_a_level_folder_change_the_name(level: Path, file: str) -> None:
    before = _name(level)
    assert _name(level) == before
    original = (level / file).read_bytes()
    (level / file).write_bytes(original + b"\n")
    assert _name(level) != before
    (level / file).write_bytes(original)
    assert _name(level) == before


def test_the_contents_of_ones_own_characters_change_the_name(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    shutil.copy(LEVELS.parent / "characters.toml", path)
    before = run_id(make_run({"characters": str(path)}))
    path.write_bytes(path.read_bytes() + b"\n")
    assert run_id(make_run({"characters": str(path)})) != before


def test_contents_cannot_be_shifted_from_one_file_to_the_next(level: Path) -> None:
    (level / "ground.csv").write_bytes(b"ab")
    (level / "obstacles.csv").write_bytes(b"c")
    before = _name(level)
    (level / "ground.csv").write_bytes(b"a")
    (level / "obstacles.csv").write_bytes(b"bc")
    assert _name(level) != before


def test_a_shipped_level_is_not_mistaken_for_a_folder_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shipped name means the shipped level (`pneuma.env.level`), wherever the command is called."""
    before = _name("thesis")
    shutil.copytree(LEVELS / "thesis", tmp_path / "thesis")
    monkeypatch.chdir(tmp_path)
    assert _name("thesis") == before
