"""Every key of a run's configuration misspelt, and every value that it may not have, refused by name."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from pneuma.config import ACTIVATIONS, Run, make_run, read_field
from pneuma.errors import UserError

KEYS = [item.name for item in fields(Run)]


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
    *("bodies", "trees", "terrain_stops"),
)
WORDS_OR_NOTHING = ("characters", "perceive", "order", "scale", "parent", "fork_reset")
FLAGS = ("end_on_clear", "magic", "value_baseline", "observe_facing", "bite_while_knocked", "healing_cap")


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
        assert read_field(Run, key, value) == value


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
