"""A run's configuration: resolved, checked, and equal where it means the same training."""

from __future__ import annotations

import itertools
import re
from dataclasses import asdict, fields
from typing import Any

import pytest

from pneuma.algorithms import ALGORITHMS, MAILMAN, TABULAR
from pneuma.config import (
    ACTIVATIONS,
    BASES,
    OPTIMIZER_SETTINGS,
    EnvConfig,
    Run,
    as_settings,
    env_config,
    make_env_config,
    make_run,
    read_setting,
    read_settings,
    stream_seed,
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


# --- Resolving -----------------------------------------------------------------------------------


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
    assert make_run(as_settings(run)) == run


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


@pytest.mark.parametrize(("base", "optimizer"), list(itertools.product(BASES, OPTIMIZER_SETTINGS)))
def test_a_run_comes_back_from_its_settings(base: str, optimizer: str) -> None:
    run = make_run({**BASES[base], "optimizer": optimizer, "seed": 7})
    assert make_run(as_settings(run)) == run


def test_settings_hold_only_what_json_can() -> None:
    for value in as_settings(make_run(BASES["table-6-1"])).values():
        assert value is None or isinstance(value, (bool, int, float, str, list))


def test_the_environment_of_a_run_is_its_part_of_the_settings() -> None:
    config = env_config(make_run({"episode_steps": 77, "end_on_clear": True, "seed": 3}))
    assert config == make_env_config({"episode_steps": 77, "end_on_clear": True})
    assert type(config) is EnvConfig


def test_the_environment_knows_no_settings_of_the_learner() -> None:
    with pytest.raises(UserError, match="unknown key 'gamma'"):
        read_settings(EnvConfig, {"gamma": 0.9})


# --- Refusing ------------------------------------------------------------------------------------


def _misspellings(key: str) -> set[str]:
    """Return what slips of the finger make of a key: a letter left out, two swapped, another dash."""
    swapped = {key[:i] + key[i + 1] + key[i] + key[i + 2 :] for i in range(len(key) - 1)}
    dropped = {key[:i] + key[i + 1 :] for i in range(len(key))}
    styles = {key.replace("_", "-"), key.replace("_", ""), key.upper(), key.title()}
    return (swapped | dropped | styles) - set(KEYS)


@pytest.mark.parametrize("key", KEYS)
def test_a_misspelt_key_is_refused_with_the_right_one(key: str) -> None:
    for wrong in _misspellings(key):
        with pytest.raises(UserError) as caught:
            make_run({wrong: 1})
        assert str(caught.value).startswith(f"unknown key {wrong!r} (did you mean {key}?)")


# For every number: values beyond each end, then the last ones within.
NUMBERS: dict[str, tuple[Any, Any, Any, Any]] = {
    "seed": (-1, 2**32, 0, 2**32 - 1),
    "steps": (0, 10**12 + 1, 1, 10**12),
    "slots": (0, 1025, 1, 1024),
    "episode_steps": (0, 1_000_001, 1, 1_000_000),
    "random_levels": (0, 10_001, 1, 10_000),
    "players": (0, 9, 1, 8),
    "ending_cost": (-0.1, 1000.1, 0, 1000),
    "gamma": (-0.01, 1.01, 0, 1),
    "gae_lambda": (-0.01, 1.01, 0, 1),
    "learning_rate": (0, 100.1, 1e-12, 100),
    "clip_range": (0, 100.1, 1e-12, 100),
    "horizon": (1, 10**6 + 1, 64, 10**6),  # 2 is the least, but a minibatch must fit in
    "minibatch": (1, 10**6 + 1, 2, 256),
    "epochs": (0, 1001, 1, 1000),
    "value_coefficient": (-0.1, 1.1e6, 0, 1e6),
    "entropy_coefficient": (-0.1, 1.1e6, 0, 1e6),
    "gradient_limit": (0, 1.1e9, 1e-12, 1e9),
    "epsilon": (0, 1.1, 1e-12, 1),
    "momentum": (-0.1, 1, 0, 0.999),
    "dampening": (-0.1, 1.1, 0, 1),
    "smoothing": (-0.1, 1, 0, 0.999),
    "utility_decay": (-0.1, 1, 0, 0.9999),
    "noise": (-0.1, 1000.1, 0, 1000),
    "weight_decay": (-0.1, 1.1, 0, 1),
    "evaluation_episodes": (0, 10_001, 1, 10_000),
    "fork_step": (-1, 10**12 + 1, 0, 10**12),
    "target_kl": (0, 100.1, 1e-12, 100),
    "conjugate_steps": (0, 1001, 1, 1000),
    "line_search_steps": (0, 1001, 1, 1000),
    "exploration": (-0.1, 1.1, 0, 1),
    "exploration_fraction": (-0.1, 1.1, 0, 1),
    "buffer_size": (0, 10**8 + 1, 1, 10**8),
    "learning_starts": (-1, 10**9 + 1, 0, 10**9),
    "train_every": (0, 10**6 + 1, 1, 10**6),
    "gradient_steps": (0, 10_001, 1, 10_000),
    "target_every": (0, 10**12 + 1, 1, 10**12),
    "action_slip": (-0.1, 1.1, 0, 1),
    "reward_noise": (-0.1, 1.1e6, 0, 1e6),
}
WHOLE = (
    *("seed", "steps", "slots", "episode_steps", "horizon", "minibatch", "epochs", "evaluation_episodes"),
    *("random_levels", "players", "fork_step", "conjugate_steps", "line_search_steps", "buffer_size"),
    *("learning_starts", "train_every", "gradient_steps", "target_every"),
)
LISTS: dict[str, list[Any]] = {
    "actor": [[], [0], [65_537], [1] * 9, [1.5], 128, "128", [[1]]],
    "critic": [[], [0], [65_537], [1] * 9, [1.5], 256, "256", [[1]]],
    "betas": [[0.9], [0.9, 0.9, 0.9], [0.9, 1], [-0.1, 0.9], 0.9, ["a", "b"]],
    "classes": [[], "", 3, "a class", ["tank"] * 9, [3]],
    "weapons": [[], "", 3, "a sword", ["sword"] * 9, [3]],
    "reward": [[], "", 3, "kill", "module:", ":function", ["kills"] * 9, [3]],
}
WORDS = (
    *("level", "env", "engine", "algorithm", "activation", "clip", "optimizer", "learners"),
    *("observation", "start", "coast", "kill_credit", "xp_scope", "time_limit"),
)
WORDS_OR_NOTHING = ("characters", "perceive", "order", "scale", "parent", "fork_reset")
FLAGS = ("end_on_clear", "magic", "value_baseline")


def _assert_refused(key: str, value: Any, shown: str) -> str:
    with pytest.raises(UserError) as caught:
        make_run({key: value})
    message = str(caught.value)
    assert message.startswith(f"{key} = {shown} is not allowed")
    assert len(message.splitlines()) == 1
    return message


def test_every_key_is_tested_here() -> None:
    assert {*NUMBERS, *LISTS, *WORDS, *WORDS_OR_NOTHING, *FLAGS} == set(KEYS)


@pytest.mark.parametrize("key", NUMBERS)
def test_a_number_beyond_either_end_is_refused(key: str) -> None:
    for value in NUMBERS[key][:2]:
        _assert_refused(key, value, str(value))


@pytest.mark.parametrize("key", NUMBERS)
def test_the_last_numbers_within_are_taken(key: str) -> None:
    for value in NUMBERS[key][2:]:
        assert read_setting(Run, key, value) == value


@pytest.mark.parametrize("key", NUMBERS)
@pytest.mark.parametrize(
    ("value", "shown"),
    [("5", '"5"'), (True, "true"), (float("nan"), "NaN"), (float("inf"), "Infinity"), ([1], "[1]")],
)
def test_what_is_no_number_is_refused(key: str, value: Any, shown: str) -> None:
    _assert_refused(key, value, shown)


@pytest.mark.parametrize("key", ["seed", "learning_rate"])
def test_a_number_too_large_for_a_float_is_refused(key: str) -> None:
    """TOML's integers have no end in Python."""
    _assert_refused(key, 10**400, str(10**400))


@pytest.mark.parametrize("key", WHOLE)
def test_a_fraction_is_refused_where_a_whole_number_is_wanted(key: str) -> None:
    assert "a whole number" in _assert_refused(key, 100.5, "100.5")


@pytest.mark.parametrize("key", WHOLE)
def test_a_whole_numbers_greatest_value_is_told_exactly(key: str) -> None:
    """A person who takes the message at its word must not be refused again."""
    greatest = {**NUMBERS, "minibatch": (0, 0, 0, 10**6)}[key][3]
    message = _assert_refused(key, NUMBERS[key][1], str(NUMBERS[key][1]))
    told = message.rpartition("at most ")[2].replace(",", "")
    assert float(told) == greatest


@pytest.mark.parametrize(("key", "value"), [(key, value) for key in LISTS for value in LISTS[key]])
def test_a_list_of_the_wrong_kind_is_refused(key: str, value: Any) -> None:
    with pytest.raises(UserError, match=f"^{key} = .* is not allowed"):
        make_run({key: value})


@pytest.mark.parametrize("key", WORDS)
@pytest.mark.parametrize("value", [3, True, "", [], None])
def test_what_is_no_word_is_refused(key: str, value: Any) -> None:
    with pytest.raises(UserError, match=f"^{key} = .* is not allowed"):
        make_run({key: value})


@pytest.mark.parametrize("key", WORDS_OR_NOTHING)
@pytest.mark.parametrize("value", [3, True, [], None])
def test_what_is_neither_a_word_nor_nothing_is_refused(key: str, value: Any) -> None:
    with pytest.raises(UserError, match=f"^{key} = .* is not allowed"):
        make_run({key: value})


@pytest.mark.parametrize("key", FLAGS)
@pytest.mark.parametrize("value", [1, 0, "true", None])
def test_only_true_and_false_are_flags(key: str, value: Any) -> None:
    with pytest.raises(UserError, match=f"^{key} = .* true or false$"):
        make_run({key: value})


@pytest.mark.parametrize(
    ("key", "written", "meant"),
    [
        ("activation", "rleu", "relu"),
        ("activation", "ReLU", "relu"),
        ("activation", "LeakyReLU", "leaky-relu"),
        ("activation", "Tanh", "tanh"),
        ("optimizer", "RMSProp", "rmsprop"),
        ("optimizer", "adamw", "adam"),
        ("clip", "seperate", "separate"),
        ("env", "Pneuma-v0", "pneuma/Pneuma-v0"),
    ],
)
def test_a_misspelt_value_is_refused_with_the_right_one(key: str, written: str, meant: str) -> None:
    assert f"(did you mean {meant}?)" in _assert_refused(key, written, f'"{written}"')


def test_the_activations_are_those_of_the_thesis() -> None:
    assert set(ACTIVATIONS) == {"tanh", "relu", "leaky-relu"}


# --- Random streams ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stream", "purpose", "slot", "expected"),
    [
        # printf '0/world/0' | sha256sum begins c0d6a0f53063ef94, least significant byte first:
        ("0", "world", 0, 0x94EF6330F5A0D6C0),
        # printf '7/evaluation/3' | sha256sum begins 975d2156f2a3acc8
        ("7", "evaluation", 3, 0xC8ACA3F256215D97),
    ],
)
def test_a_streams_seed_is_a_known_hash(stream: str, purpose: str, slot: int, expected: int) -> None:
    assert stream_seed(stream, purpose, slot) == expected


def test_no_two_streams_share_a_seed() -> None:
    purposes = ("world", "weights", "actions", "minibatches", "evaluation", "evaluation-actions")
    keys = list(itertools.product(map(str, range(50)), purposes, range(20)))
    seeds = {stream_seed(*key) for key in keys}
    assert len(seeds) == len(keys) == 50 * 6 * 20
    assert all(0 <= seed < 2**64 for seed in seeds)


def test_slot_zero_is_the_stream_without_a_slot() -> None:
    assert stream_seed("3", "weights") == stream_seed("3", "weights", 0)
