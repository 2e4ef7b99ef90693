"""Ids of runs: equal for equal bits, different for anything that could change them."""

from __future__ import annotations

import shutil
from dataclasses import fields, replace
from pathlib import Path

import pytest

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import GYMNASIUM_FIELDS, Run, make_run
from pneuma.engines.environment import check_environment
from pneuma.env.load_level import LEVELS
from pneuma.study import identity
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Cell, Query, make_plan
from pneuma.study.spec import load_study

ACTIVATION_SEED_0 = {
    "tanh": "e56b7b085b7bf45b",
    "relu": "dab520d8db36a850",
    "leaky-relu": "906f306f84d47b82",
}
"""Stored runs are found by these: a change here retrains everybody's runs. Change it on purpose only."""

DEFAULT_IDS = {
    "adam": "5815058912419fe4", "sgd": "b89de5ff66e99ec1", "rmsprop": "d8bfc45fbecced64",
    "upgd": "ebb49191447ccab3", "a2c": "1b343c09ff4588d4", "trpo": "7b9701ba409844d2",
    "dqn": "800e43d9942d89fb", "double-dqn": "a29fcc0bf1e38d1c",
}  # fmt: skip
"""Of a run of each optimizer and algorithm, with their own defaults."""

ELSEWHERE = {"engine", "level", "characters", "reward"}
"""Fields that are not hashed by their value, but by a version or by the contents of files."""
UNREAD = {"momentum": 0.9, "noise": 0.01, "target_kl": 0.02, "buffer_size": 64}
"""Fields that PPO and Adam do not read."""


def test_the_shipped_studys_runs_keep_their_ids() -> None:
    selection = Query(seeds=(0,), steps=50_000, settings={"slots": 1})
    cells = make_plan(load_study("activation", "text"), selection).cells
    assert {cell.condition: cell.run_id for cell in cells} == ACTIVATION_SEED_0


@pytest.mark.parametrize("name", DEFAULT_IDS)
def test_a_new_field_moves_no_id(name: str) -> None:
    key = "optimizer" if name in OPTIMIZERS else "algorithm"
    remedy = f"a new field that {name} reads: `declare` it with the value that changes nothing, not with None"
    assert run_id(make_run({key: name})) == DEFAULT_IDS[name], remedy


def test_a_configuration_is_a_run_without_its_seed_and_steps() -> None:
    run = make_run({"seed": 2})
    assert config_id(replace(run, seed=1, steps=1024)) == config_id(run)
    assert config_id(replace(run, horizon=512)) != config_id(run) != run_id(run)


def test_every_field_with_an_effect_changes_the_id() -> None:
    run = make_run({})
    for field in fields(Run):
        another = '{"another": 1}' if field.name == "algorithm_kwargs" else "another"
        if field.name not in (*ELSEWHERE, *GYMNASIUM_FIELDS):
            assert run_id(replace(run, **{field.name: another})) != run_id(run), field.name  # type: ignore[arg-type]
    for key, shipped in {"level": "random:test:0", "characters": "pygame", "reward": "kills"}.items():
        assert run_id(make_run({key: shipped})) != run_id(run), key
    for key, value in UNREAD.items():
        assert run_id(make_run({key: value})) == run_id(run), key


def test_a_raised_version_changes_the_id(monkeypatch: pytest.MonkeyPatch) -> None:
    before = run_id(make_run({}))
    monkeypatch.setattr(identity, "RULES_VERSION", 99)
    assert run_id(make_run({})) != before
    monkeypatch.undo()
    monkeypatch.setattr(identity, "ENGINE_VERSIONS", {"batched": 99})
    assert run_id(make_run({})) != before


@pytest.fixture
def level(tmp_path: Path) -> Path:
    return Path(shutil.copytree(LEVELS / "thesis", tmp_path / "my:level"))


def _name(level: Path | str) -> str:
    return run_id(make_run({"level": str(level)}))


def test_the_contents_of_a_level_folder_change_the_id(level: Path) -> None:
    (level / "objects.csv").write_bytes(b"9" * 2**20)  # a large file is hashed to its end
    before = _name(level)
    for file in ("level.toml", "ground.csv", "obstacles.csv", "objects.csv"):
        original = (level / file).read_bytes()
        for changed in (original + b"\n", original[:-1] + b"?"):  # longer, and in its last byte alone
            (level / file).write_bytes(changed)
            assert _name(level) != before, file
        (level / file).write_bytes(original)
        assert _name(level) == before
    names = set()
    for ground, obstacles in ((b"ab", b"c"), (b"a", b"bc")):  # shifted from one file to the next
        (level / "ground.csv").write_bytes(ground)
        (level / "obstacles.csv").write_bytes(obstacles)
        names.add(_name(level))
    assert len(names) == 2


def test_bytes_that_look_like_another_file_are_the_contents_of_their_own(level: Path) -> None:
    """The length of each file is hashed before its contents."""
    for file in level.iterdir():
        file.unlink()
    (level / "ground.csv").write_bytes(b"1")
    (level / "objects.csv").write_bytes(b"2")
    two_files = _name(level)
    (level / "objects.csv").unlink()
    (level / "ground.csv").write_bytes(b"1objects.csv\x002")
    assert _name(level) != two_files


def test_a_shipped_level_is_not_mistaken_for_a_folder_of_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shipped name means the shipped level (`pneuma.env.load_level`), wherever the command is called."""
    before = _name("thesis")
    shutil.copytree(LEVELS / "thesis", tmp_path / "thesis")
    monkeypatch.chdir(tmp_path)
    assert _name("thesis") == before


OWN = """
title = "T"
base = "table-6-2"
[conditions.world]
reward = ["thesis", "of_mine.parts:reward"]
players = 2
level = "isle"
characters = "sub/mine.toml"
[conditions.other]
env = "CartPole-v1"
env_module = "package_of_mine"
wrappers = ["../up_of_mine.py:Wrapper"]
[presets.quick]
seeds = 1
steps = 512
"""


def test_user_files_are_found_in_the_studys_folder_or_in_the_current_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = tmp_path / "there"
    sources = {
        "there/of_mine/parts.py": "def reward(events, players, stats):\n    return events['kills']\n",
        "there/package_of_mine/__init__.py": "from . import more\n",
        "there/package_of_mine/more.py": "",
        "up_of_mine.py": "import gymnasium\nWrapper = gymnasium.Wrapper\n",
        "there/sub/mine.toml": "[monsters.bamboo]\nhp = 7\n",
        "there/own.toml": OWN,
    }
    for name, text in sources.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    shutil.copytree(LEVELS / "thesis", there / "isle")

    def cells() -> tuple[Cell, ...]:
        return make_plan(load_study(str(there / "own.toml"), "text"), Query()).cells

    world, other = cells()
    check_environment(world.run)
    check_environment(other.run)
    assert world.run.reward == ("thesis", f"{there / 'of_mine/parts.py'}:reward")
    assert world.run.level == str(there / "isle") and world.run.characters == str(there / "sub" / "mine.toml")
    assert other.run.env_module == str(there / "package_of_mine" / "__init__.py")
    assert other.run.wrappers == (f"{tmp_path / 'up_of_mine.py'}:Wrapper",)
    before = other.run_id
    (there / "package_of_mine" / "more.py").write_text("\n")
    assert cells()[1].run_id != before
    elsewhere = tmp_path / "elsewhere" / "own.toml"
    elsewhere.parent.mkdir()
    elsewhere.write_text(OWN)
    monkeypatch.chdir(there)
    assert make_plan(load_study(str(elsewhere), "text"), Query()).cells[0].run.level == "isle"


def test_a_reward_has_one_id_by_the_name_or_the_path_of_its_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "package_alike").mkdir()
    (tmp_path / "package_alike" / "__init__.py").touch()
    for name in ("named_alike", "package_alike.inside"):
        path = tmp_path / f"{name.replace('.', '/')}.py"
        path.write_text("def reward(events, players, stats):\n    return 1\n")
        by_path, by_name = make_run({"reward": f"{path}:reward"}), make_run({"reward": f"{name}:reward"})
        assert run_id(by_path) == run_id(by_name)
