"""What a run is called: the same for the same bits, another for anything that could change them."""

from __future__ import annotations

import shutil
from dataclasses import fields, replace
from pathlib import Path

import pytest

from pneuma.config import OF_GYMNASIUM, Run, make_run
from pneuma.env.level import LEVELS
from pneuma.errors import UserError
from pneuma.study import identity
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study

ACTIVATION_QUICK_SEED_0 = {
    "tanh": "044a83d2515676df",
    "relu": "63b62db827f7bf47",
    "leaky-relu": "0f86b74715fa6f79",
}
"""Stored runs are found by these: a change here retrains everybody's runs. Change it on purpose only."""

ELSEWHERE = {"engine", "level", "characters", "reward"}
"""Fields that are hashed otherwise than by their value: by a version, by the contents of files."""
UNREAD = {"momentum": 0.9, "noise": 0.01, "target_kl": 0.02, "buffer_size": 64, "action_slip": 0.1}
"""Fields that PPO and Adam do not read."""


def test_the_shipped_studys_runs_keep_their_names() -> None:
    selection = Selection(preset="quick", seeds=(0,), settings={"slots": 1})
    cells = make_plan(load_study("activation", "text"), selection).cells
    assert {cell.condition: cell.run_id for cell in cells} == ACTIVATION_QUICK_SEED_0


def test_a_configuration_is_a_run_without_its_seed_and_steps() -> None:
    run = make_run({})
    assert {config_id(replace(run, seed=seed, steps=steps)) for seed in (0, 1) for steps in (512, 1024)} == {
        config_id(run)
    }
    assert config_id(replace(run, horizon=512)) != config_id(run) != run_id(run)


def test_every_field_that_is_read_changes_the_name() -> None:
    run, another = make_run({}), "another"
    for field in fields(Run):
        if field.name not in (*ELSEWHERE, *OF_GYMNASIUM):
            assert run_id(replace(run, **{field.name: another})) != run_id(run), field.name  # type: ignore[arg-type]
    for key, shipped in {"level": "random:test:0", "characters": "pygame", "reward": "kills"}.items():
        assert run_id(make_run({key: shipped})) != run_id(run), key
    for key, value in UNREAD.items():
        assert run_id(make_run({key: value})) == run_id(run), key


def test_a_run_of_an_older_version_is_the_same_run_still() -> None:
    assert run_id(make_run({"learners": "shared"})) == run_id(make_run({}))
    with pytest.raises(UserError, match="learners"):
        make_run({"learners": "independent"})


def test_a_raised_version_changes_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    before = run_id(make_run({}))
    monkeypatch.setattr(identity, "RULES_VERSION", 99)
    assert run_id(make_run({})) != before
    monkeypatch.undo()
    monkeypatch.setattr(identity, "ENGINE_VERSIONS", {"batched": 99})
    assert run_id(make_run({})) != before


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
