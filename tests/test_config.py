"""A run's configuration: resolved, checked, and equal where it means the same training."""

from __future__ import annotations

import itertools
import re
from dataclasses import asdict, fields
from typing import Any

import pytest

from pneuma.algorithms import ALGORITHMS, MAILMAN, TABULAR
from pneuma.config import (
    BASES,
    OPTIMIZER_FIELDS,
    EnvConfig,
    Run,
    as_fields,
    env_config,
    make_env_config,
    make_run,
    read_fields,
)
from pneuma.errors import UserError

KEYS = [item.name for item in fields(Run)]

# Design section 3, row by row: what each of the thesis's two tables says.
COMMON_OF_BOTH_TABLES: dict[str, Any] = {
    "gamma": 0.99,
    "gae_lambda": 0.95,
    "learning_rate": 0.0003,
    "minibatch": 64,
    "entropy_coefficient": 0.01,
    "optimizer": "adam",
    "epsilon": 0.00001,
    "actor": (128,),
    "critic": (256,),
    "slots": 1,
}
TABLES: dict[str, dict[str, Any]] = {
    "table-6-1": {
        **COMMON_OF_BOTH_TABLES,
        "clip_range": 0.2,
        "horizon": 2048,
        "epochs": 15,
        "value_coefficient": 1.0,
        "betas": (0.9, 0.999),
        "activation": "relu",
        "gradient_limit": None,
    },
    "table-6-2": {
        **COMMON_OF_BOTH_TABLES,
        "clip_range": 0.1,
        "horizon": 256,
        "epochs": 10,
        "value_coefficient": 0.5,
        "betas": (0.9, 0.9),
        "activation": "tanh",
        "gradient_limit": 0.5,
    },
}


@pytest.mark.parametrize("base", TABLES)
def test_each_base_is_the_table_of_the_thesis(base: str) -> None:
    run = asdict(make_run(BASES[base]))
    assert {key: run[key] for key in TABLES[base]} == TABLES[base]


def test_there_are_no_bases_but_the_two_tables() -> None:
    assert set(BASES) == set(TABLES)


@pytest.mark.parametrize(
    ("steps", "horizon", "slots", "trained", "updates"),
    [
        (50_000, 256, 1, 50_176, 196),  # 195 x 256 = 49,920 is short by 80
        (51_200, 256, 1, 51_200, 200),  # already whole
        (51_201, 256, 1, 51_456, 201),
        (1, 256, 1, 256, 1),
        (50_000, 256, 4, 50_176, 49),  # 49 x 1,024
        (50_000, 2048, 1, 51_200, 25),  # 24 x 2,048 = 49,152
    ],
)
def test_a_budget_is_rounded_up_to_whole_horizons(
    steps: int, horizon: int, slots: int, trained: int, updates: int
) -> None:
    run = make_run({"steps": steps, "horizon": horizon, "slots": slots})
    assert (run.steps, run.updates) == (trained, updates)


@pytest.mark.parametrize(
    ("optimizer", "read"),
    [
        ("adam", {"betas": (0.9, 0.999), "epsilon": 1e-5}),
        ("sgd", {"momentum": 0.0, "dampening": 0.0}),
        ("rmsprop", {"smoothing": 0.99, "epsilon": 1e-5, "momentum": 0.0}),
        ("upgd", {"betas": (0.9, 0.999), "epsilon": 1e-5, "utility_decay": 0.999, "noise": 0.001}),
    ],
)
def test_an_optimizer_has_its_own_settings_and_no_others(optimizer: str, read: dict[str, Any]) -> None:
    run = asdict(make_run({"optimizer": optimizer}))
    all_of_them = ("betas", "epsilon", "momentum", "dampening", "smoothing", "utility_decay", "noise")
    assert {key: run[key] for key in all_of_them} == {**dict.fromkeys(all_of_them), **read}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_algorithm_has_its_own_settings_and_no_others(algorithm: str) -> None:
    """What it does not read is at its default, whatever was said; None where only others have it."""
    env = MAILMAN if algorithm in TABULAR else "pneuma/Pneuma-v0"
    said = {"critic": [64], "clip_range": 0.3, "buffer_size": 32, "target_kl": 0.5, "reward_noise": 2.0}
    run = make_run({**said, "algorithm": algorithm, "env": env})
    expected: dict[str, Any] = {
        "critic": (64,) if algorithm in ("ppo", "a2c", "trpo") else (256,),
        "clip_range": 0.3 if algorithm == "ppo" else 0.1,
        "buffer_size": 32 if algorithm in ("dqn", "double-dqn") else None,
        "target_kl": 0.5 if algorithm == "trpo" else None,
        "reward_noise": 2.0 if algorithm in TABULAR else None,
        "betas": None if algorithm in TABULAR else (0.9, 0.999),
        "engine": "batched" if algorithm == "ppo" else "tabular" if algorithm in TABULAR else "sb3",
    }
    assert {key: getattr(run, key) for key in expected} == expected
    assert make_run(as_fields(run)) == run


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"algorithm": "dqn", "engine": "batched"}, "cannot train the algorithm dqn; sb3 can"),
        (
            {"value_baseline": False, "engine": "batched"},
            "cannot train advantages without a baseline; sb3 can",
        ),
        ({"engine": "tabular"}, "cannot train the algorithm ppo; batched and sb3 can"),
        ({"algorithm": "q-learning", "env": MAILMAN, "engine": "sb3"}, "q-learning; tabular can"),
        (
            {"algorithm": "q-learning"},
            "not allowed in pneuma/Pneuma-v0: one of ppo, a2c, trpo,",
        ),
        ({"env": MAILMAN}, "not allowed in pneuma/Mailman-v0: one of q-learning, double-q-learning"),
        ({"algorithm": "dqn", "train_every": 3}, "train_every = 3 is not allowed: horizon = 256"),
        ({"algorithm": "q-learning", "env": MAILMAN, "learning_rate": 2}, "learning_rate = 2 is not allowed"),
        ({"algorithm": "trpo", "minibatch": 257}, "minibatch = 257 is not allowed"),
    ],
)
def test_what_does_not_go_with_an_algorithm_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=re.escape(message)):
        make_run(settings)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({}, {"optimizer": "adam", "betas": [0.9, 0.999], "epsilon": 1e-5}),
        ({}, {"momentum": 0.9, "smoothing": 0.5}),  # Adam reads neither
        ({"optimizer": "sgd"}, {"optimizer": "sgd", "momentum": 0, "betas": [0.5, 0.5]}),
        ({}, {"betas": None, "momentum": None}),
        ({"steps": 1}, {"steps": 256}),
        ({"steps": 512}, {"steps": 512.0}),
        ({"gamma": 1}, {"gamma": 1.0}),
        ({"actor": [64, 64]}, {"actor": (64.0, 64)}),
        ({"gradient_limit": "none"}, {"gradient_limit": None}),
        ({"gradient_limit": None}, {"gradient_limit": None, "clip": "separate"}),  # nothing is clipped
    ],
)
def test_two_ways_to_write_one_training_are_equal_runs(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert make_run(one) == make_run(other)
    assert hash(make_run(one)) == hash(make_run(other))


@pytest.mark.parametrize(("horizon", "slots", "most"), [(32, 1, 32), (32, 2, 64)])
def test_a_minibatch_is_at_most_a_rollout(horizon: int, slots: int, most: int) -> None:
    settings = {"horizon": horizon, "slots": slots, "minibatch": most}
    assert make_run(settings).minibatch == most
    with pytest.raises(UserError, match=rf"minibatch = {most + 1} .* at most .* {most}$"):
        make_run({**settings, "minibatch": most + 1})


@pytest.mark.parametrize(("base", "optimizer"), list(itertools.product(BASES, OPTIMIZER_FIELDS)))
def test_a_run_comes_back_from_its_settings(base: str, optimizer: str) -> None:
    run = make_run({**BASES[base], "optimizer": optimizer, "seed": 7})
    assert make_run(as_fields(run)) == run


def test_settings_hold_only_what_json_can() -> None:
    for value in as_fields(make_run(BASES["table-6-1"])).values():
        assert value is None or isinstance(value, (bool, int, float, str, list))


def test_the_environment_of_a_run_is_its_part_of_the_settings() -> None:
    config = env_config(make_run({"episode_steps": 77, "end_on_clear": True, "seed": 3}))
    assert config == make_env_config({"episode_steps": 77, "end_on_clear": True})
    assert type(config) is EnvConfig


def test_the_environment_knows_no_settings_of_the_learner() -> None:
    with pytest.raises(UserError, match="unknown key 'gamma'"):
        read_fields(EnvConfig, {"gamma": 0.9})
