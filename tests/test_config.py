"""A run's configuration: resolved, checked, equal where it means the same training; its random streams."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from pneuma.algorithms import ALGORITHMS, VALUE_BASED
from pneuma.config import as_fields, make_run, stream_seed
from pneuma.errors import UserError
from pneuma.presets import BASES

# Design section 3, row by row: what each of the thesis's two tables says.
COMMON_OF_BOTH_TABLES: dict[str, Any] = {
    "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 0.0003, "minibatch": 64, "entropy_coefficient": 0.01,
    "optimizer": "adam", "epsilon": 0.00001, "actor": (128,), "critic": (256,), "slots": 1,
}  # fmt: skip
ROWS = ("clip_range", "horizon", "epochs", "value_coefficient", "betas", "activation", "gradient_limit")
TABLES = {
    "table-6-1": (0.2, 2048, 15, 1.0, (0.9, 0.999), "relu", None),
    "table-6-2": (0.1, 256, 10, 0.5, (0.9, 0.9), "tanh", 0.5),
}


@pytest.mark.parametrize("base", TABLES)
def test_each_base_is_the_table_of_the_thesis(base: str) -> None:
    run, table = asdict(make_run(BASES[base])), dict(zip(ROWS, TABLES[base], strict=True))
    assert {key: run[key] for key in (*COMMON_OF_BOTH_TABLES, *ROWS)} == {**COMMON_OF_BOTH_TABLES, **table}


def test_the_update_in_which_a_budget_ends_is_completed() -> None:
    for steps, slots, trained, updates in (
        (1, 1, 256, 1),
        (51_200, 1, 51_200, 200),  # whole updates
        (51_201, 1, 51_456, 201),
        (50_000, 4, 50_176, 49),  # 49 x 1,024
    ):
        run = make_run({"steps": steps, "horizon": 256, "slots": slots})
        assert (run.steps, run.trained_steps, run.updates) == (steps, trained, updates)


@pytest.mark.parametrize(
    ("optimizer", "read"),
    [
        ("adam", {"betas": (0.9, 0.999), "epsilon": 1e-5}),  # PPO's
        ("sgd", {"momentum": 0.0, "dampening": 0.0}),
        ("rmsprop", {"smoothing": 0.99, "epsilon": 1e-8, "momentum": 0.0}),  # torch's own
        ("upgd", {"betas": (0.9, 0.999), "epsilon": 1e-5, "utility_decay": 0.999, "noise": 0.001}),
    ],
)
def test_an_optimizer_has_its_own_fields_and_no_others(optimizer: str, read: dict[str, Any]) -> None:
    run = asdict(make_run({"optimizer": optimizer}))
    all_of_them = ("betas", "epsilon", "momentum", "dampening", "smoothing", "utility_decay", "noise")
    assert {key: run[key] for key in all_of_them} == {**dict.fromkeys(all_of_them), **read}


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_algorithm_has_its_own_fields_and_no_others(algorithm: str) -> None:
    """What it does not read is at its default, whatever is set; None where only others have it."""
    is_open = bool(ALGORITHMS[algorithm].learner)
    settings = {"critic": [64], "clip_range": 0.3, "buffer_size": 32, "target_kl": 0.5}
    env = "CartPole-v1" if is_open else "pneuma/Pneuma-v0"
    run = make_run({**settings, "algorithm": algorithm, "env": env})
    expected: dict[str, Any] = {
        "critic": (64,) if algorithm in ("ppo", "a2c", "trpo") else (256,),
        "clip_range": 0.3 if algorithm == "ppo" else 0.1,
        "buffer_size": 32 if algorithm in VALUE_BASED else None,
        "target_kl": 0.5 if algorithm == "trpo" else None,
        "betas": None if is_open or algorithm == "a2c" else (0.9, 0.999),
        "engine": "batched" if algorithm == "ppo" else "sb3",
    }
    assert {key: getattr(run, key) for key in expected} == expected
    assert make_run(as_fields(run)) == run


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ({}, {"optimizer": "adam", "betas": [0.9, 0.999], "epsilon": 1e-5}),
        ({}, {"momentum": 0.9, "smoothing": 0.5}),  # Adam reads neither
        ({"optimizer": "sgd"}, {"optimizer": "sgd", "momentum": 0, "betas": [0.5, 0.5]}),
        ({}, {"betas": None, "momentum": None}),
        ({"steps": 2048}, {"steps": 2048.0}),
        ({"gamma": 1}, {"gamma": 1.0}),
        ({"env": "CartPole-v1"}, {"env": "CartPole-v1", "env_kwargs": {}}),
        ({"actor": [64, 64]}, {"actor": (64.0, 64)}),
        ({"gradient_limit": "none"}, {"gradient_limit": None}),
        ({"gradient_limit": None}, {"gradient_limit": None, "clip": "separate"}),  # nothing is clipped
        ({"players": 1}, {"players": 1, "learners": "independent"}),
    ],
)
def test_two_ways_to_write_one_training_are_equal_runs(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert make_run(one) == make_run(other)


def test_whole_numbers_are_whole_however_they_are_written() -> None:
    with pytest.raises(UserError, match="^epochs = 100.5 is not allowed: .*whole number"):
        make_run({"epochs": 100.5})
    for value in (256.0, np.int64(256), np.float64(256)):
        assert repr(make_run({"horizon": value}).horizon) == "256"
    assert repr(make_run({"entropy_coefficient": -0.0}).entropy_coefficient) == "0.0"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"players": 2, "learners": "independent", "engine": "sb3"}, "learners = .*: sb3 trains one policy"),
        ({"optimizer": "upgd", "engine": "sb3"}, "optimizer = upgd .*: the engine sb3 lacks it; batched has"),
        ({"env": "CartPole-v1", "wrappers": [{"stack_size": 4}]}, "wrappers = .*: module:Class"),
        ({"algorithm": "qr-dqn"}, "algorithm = qr-dqn .* in pneuma/Pneuma-v0: only Gymnasium's other"),
        ({"algorithm": "dqn", "engine": "batched"}, 'engine = "batched" .*: it cannot train the algorithm'),
        ({"value_baseline": False, "engine": "batched"}, "train advantages without a baseline; sb3 can"),
        ({"device": "cuda", "engine": "batched"}, "cannot train a run with device = cuda; sb3 can"),
        ({"device": "cuda:1"}, "device = .*cuda:1.* is not allowed"),
        (
            {"device": "cuda", "optimizer": "upgd"},
            "optimizer = upgd .*: the engine sb3 lacks it; batched has",
        ),
        ({"algorithm": "dqn", "train_every": 3}, "train_every = 3 .*: horizon = 256 is no multiple"),
        ({"held_out_levels": 3}, "held_out_levels = 3 .*: thesis is not of random:train"),
    ],
)
def test_what_does_not_go_together_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message) as refused:
        make_run(fields)
    assert "not allowed" in str(refused.value)


def test_a_streams_seed_is_a_known_hash() -> None:
    """`printf 7/evaluation/3 | sha256sum` begins 975d2156f2a3acc8, least significant byte first."""
    assert stream_seed(7, "evaluation", 3) == 0xC8ACA3F256215D97
