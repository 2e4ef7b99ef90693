"""Search files: what is read, and what is refused with its place and fix."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.presets import WORLDS
from pneuma.search.space import Parameter
from pneuma.search.spec import Search, load_search

GOOD = """
title = "A search"
base = "table-6-2"
start = ["table-6-2", "table-6-1"]
generation = 4

[run]
gradient_limit = 0.5

[objectives.killed]
outcome = "final-share-killed"

[space.learning_rate]
low = 1e-5
high = 1e-2
log = true

[space.epochs]
low = 1
high = 10

[space.optimizer]
choices = ["adam", "sgd"]

[space.momentum]
low = 0.0
high = 0.9
when = { optimizer = "sgd" }

[space.actor]
choices = [[32], [128]]

[presets.quick]
trials = 4
seeds = 2
steps = 512
"""


def load(folder: Path, text: str) -> Search:
    """Write a search file and load it, in the text's world."""
    path = folder / "mine.toml"
    path.write_text(text)
    return load_search(str(path), "text")


def test_a_search_is_read_whole(tmp_path: Path) -> None:
    search = load(tmp_path, GOOD)
    assert search.presets["quick"].seeds == (1000, 1001)
    assert [*search.space] == ["learning_rate", "epochs", "optimizer", "momentum", "actor"]
    assert [search.params_of(start) for start in search.start] == [
        {"learning_rate": 3e-4, "epochs": 10, "optimizer": "adam", "actor": "[128]"},
        {"learning_rate": 3e-4, "optimizer": "adam", "actor": "[128]"},  # 15 epochs are outside
    ]
    assert search.fields({"optimizer": "sgd", "momentum": 0.5, "actor": "[32]"}) == {
        "gradient_limit": 0.5, "optimizer": "sgd", "momentum": 0.5, "actor": (32,),
    }  # fmt: skip


def test_a_parameter_is_asked_for_only_where_it_counts(tmp_path: Path) -> None:
    for optimizer in ("adam", "sgd"):

        def suggest(parameter: Parameter, chosen: str = optimizer) -> object:
            return chosen if parameter.name == "optimizer" else parameter.extremes[0]

        assert ("momentum" in load(tmp_path, GOOD).suggest(suggest)) == (optimizer == "sgd")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [  # what is changed, into what, and what is said of it
        ("[space.epochs]", "[space.epoch]", "[space] epoch: unknown parameter 'epoch' (did you"),
        ("[space.epochs]\n", "[space.epochs]\nstep = 2\n", "It will be replaced with [1, 9]"),
        ("[space.epochs]\n", "[space.epochs]\nstep = 0.5\n", "step = 0.5 is not allowed: a whole number"),
        ('"table-6-1"]', '{ epochs = 11 }]', '{"epochs": 11} is not in the space: [space.epochs] allows'),
        ('"table-6-1"]', '"table-6-3"]', "(did you mean table-6-2?): must be"),
        ("high = 1e-2", "high = 1e-6", "`low <= high` must hold, but got (low=1e-05, high=1e-06)"),
        ('optimizer = "sgd" }', 'optimiser = "sgd" }', "unknown parameter 'optimiser'"),
        ('optimizer = "sgd" }', 'actor = [32] }', "actor is searched, too: [space.actor]"),
        ('optimizer = "sgd" }', 'activation = "relu" }', 'momentum never applies: no trial'),
        ('optimizer = "sgd" }', 'learning_rate = 3e-4 }', 'momentum never applies: no trial'),
        ("[space.epochs]\nlow = 1\n", "[space.epochs]\nchoices = [1, 2]\n", "unexpected keyword"),
        ("gradient_limit = 0.5", "epochs = 3", "epochs is already varied by [space.epochs]"),
        ("gradient_limit = 0.5", "held_out_levels = 5", "held_out_levels = 5 is not allowed"),
        ("[run]", '[sampler]\nname = "tpee"\n[run]', "unknown name 'tpee' (did you mean tpe?)"),
        ("[run]", '[sampler]\nname = "tpe"\nstartup = 1\n[run]', "unexpected keyword argument 'startup'"),
        ("[run]", '[sampler]\nname = "gp"\n[run]', "any other is named as module:Class"),
        ("[run]", '[sampler]\nname = "optuna:Study"\n[run]', "not a class of Optuna's BaseSampler"),
        ("[run]", '[sampler]\nname = "optuna.samplers:CmaEsSampler"\n[run]', "state as a pickle"),
        (
            "[run]", '[pruner]\nname = "optuna.pruners:PercentilePruner"\npercentile = 101\n[run]',
            "Percentile must be between",
        ),
        (
            "[run]", '[pruner]\nname = "median"\n[objectives.more]\noutcome = "final-return"\n[run]',
            "median requires a single objective",
        ),
        ("[space.epochs]\nlow = 1\n", "[space.noise]\nlow = 1\n", "noise has no effect"),
    ],
)  # fmt: skip
def test_mistakes_are_refused_by_name(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert GOOD.count(old) >= 1
    with pytest.raises(UserError) as caught:
        load(tmp_path, GOOD.replace(old, new, 1))
    assert message in str(caught.value)
    assert "mine.toml" in str(caught.value)


def test_a_search_in_the_published_codes_world(tmp_path: Path) -> None:
    load(tmp_path, GOOD)
    there = load_search(str(tmp_path / "mine.toml"), "godot")
    assert (there.name, there.label, there.full_title) == ("mine", "mine-godot", "A search (godot)")
    assert there.fields({}) == {  # the search sets the actor itself
        "gradient_limit": 0.5, "env": "pneuma/PneumaGodot-v0", "clip_range": 0.2,
    }  # fmt: skip


def test_the_first_trials_have_what_the_world_and_its_observation_say() -> None:
    search = load_search("godot")
    first = search.params_of(search.start[0])
    world = ("scale", "order", "xp_scope", "reward")
    assert [first[key] for key in world] == ["raw", "fixed", "forever", '["godot"]']


def test_a_search_is_found_by_its_path_a_shipped_name_or_its_name_here_and_is_in_the_arena(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    load(tmp_path, GOOD)
    with pytest.raises(UserError, match="unknown search 'mine'; known are .* more; `pneuma search list`"):
        load_search("mine")
    monkeypatch.chdir(tmp_path)
    found = [load_search(name) for name in ("mine", "mine.toml", str(tmp_path / "mine.toml"))]
    assert [search.label for search in found] == ["mine-arena"] * 3
    assert found[0].space == found[1].space == found[2].space
    assert (load_search("ppo").label, load_search("ppo", "text").label) == ("ppo-arena", "ppo-text")
    (tmp_path / "ppo.toml").write_text(GOOD)
    assert load_search("ppo").title != "A search"
    with pytest.raises(UserError, match="this is the name of a shipped search"):
        load_search("ppo.toml")


def test_a_search_of_another_environment_has_no_world(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace("gradient_limit = 0.5", 'gradient_limit = 0.5\nenv = "CartPole-v1"', 1))
    search = load_search(str(path))
    assert (search.label, search.full_title) == ("mine", "A search")
    for world in WORLDS:
        with pytest.raises(UserError, match="search mine has only one environment"):
            load_search(str(path), world)
