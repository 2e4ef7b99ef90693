"""Golden traces: some numbers of small runs, by engine and the version that it trained them with.

They change with the arithmetic of engine, rules or libraries. If it was ours that changed, raise
ENGINE_VERSIONS or RULES_VERSION: stored runs must not pass for what the code would train today.
"""

from __future__ import annotations

from typing import Any

import pytest

from pneuma.algorithms import MAILMAN
from pneuma.config import BASES, ENGINE_VERSIONS, make_run
from pneuma.engines.base import load_engine

SMALL: dict[str, Any] = {
    **BASES["table-6-2"],
    "actor": [16], "critic": [24], "horizon": 64, "minibatch": 32, "epochs": 2, "evaluation_episodes": 4,
    "episode_steps": 40, "seed": 11,
}  # fmt: skip
TABLE: dict[str, Any] = {
    "env": MAILMAN, "algorithm": "double-q-learning", "horizon": 50, "steps": 200, "learning_rate": 0.5,
    "evaluation_episodes": 5, "gamma": 0.9, "seed": 11, "reward_noise": 1.0,
}  # fmt: skip
RUNS: dict[str, dict[str, Any]] = {
    "sb3": {**SMALL, "steps": 256, "engine": "sb3"},
    "batched, shared": {**SMALL, "steps": 512, "slots": 2},
    "batched, independent": {**SMALL, "steps": 512, "players": 2, "learners": "independent"},
    "tabular": TABLE,
}
# How many episodes end, and step, length and return of some; the last metrics, actions' shares, evaluation.
GOLDEN: dict[tuple[str, int], dict[str, Any]] = {
    ("sb3", 2): {
        "episodes": 6,
        "episode": {0: (40, 40, -15.06), 1: (80, 40, -34.68), 5: (240, 40, -38.6)},
        "metrics": {
            "policy_loss": 7.9453e-05, "value_loss": 89.6666, "entropy": 1.60917, "approx_kl": 3.33041e-06,
            "clip_fraction": 0.0, "explained_variance": 0.0885627, "grad_norm": 50.6409,
            "grad_norm_actor": 0.324228, "grad_norm_critic": 50.6398, "dead_units": 0.125,
        },
        "actions": [0.171875, 0.28125, 0.1875, 0.140625, 0.21875],
        "evaluation": {
            "share_killed": 0.0, "return": -37.5675, "length": 40.0, "died": 0.0, "argmax_share_killed": 0.0,
            "argmax_return": -36.36, "random_share_killed": 0.0357143, "hunter_share_killed": 0.142857,
        },
    },
    ("batched, shared", 3): {
        "episodes": 12,
        "episode": {0: (80, 40, -30.13), 3: (160, 40, -31.44), 11: (480, 40, -11.62)},
        "metrics": {
            "policy_loss": -0.000548483, "value_loss": 47.6907, "entropy": 1.60915, "approx_kl": 2.48551e-05,
            "clip_fraction": 0.0, "explained_variance": -0.0177258, "grad_norm": 29.5914,
            "grad_norm_actor": 0.543584, "grad_norm_critic": 29.5862, "dead_units": 0.075,
        },
        "actions": [0.210938, 0.15625, 0.195312, 0.179688, 0.257812],
        "evaluation": {
            "share_killed": 0.0, "return": -37.69, "length": 40.0, "died": 0.0, "argmax_share_killed": 0.0,
            "argmax_return": -37.0367, "random_share_killed": 0.0357143, "hunter_share_killed": 0.142857,
        },
    },
    ("batched, independent", 3): {
        "episodes": 12,
        "episode": {0: (80, 40, -30.13), 1: (80, 40, -35.1), 8: (400, 40, -36.0)},
        "metrics": {
            "policy_loss": -0.000571774, "value_loss": 85.4988, "entropy": 1.60917, "approx_kl": 6.67898e-06,
            "clip_fraction": 0.0, "explained_variance": 0.0396808, "grad_norm": 62.011,
            "grad_norm_actor": 0.641133, "grad_norm_critic": 62.0073, "dead_units": 0.125,
        },
        "actions": [0.203125, 0.171875, 0.1875, 0.179688, 0.257812],
        "evaluation": {
            "share_killed": 0.0178571, "return": -35.9225, "length": 40.0, "died": 0.0,
            "argmax_share_killed": 0.0, "argmax_return": -37.0017, "random_share_killed": 0.0178571,
            "hunter_share_killed": 0.285714,
        },
    },
    ("tabular", 1): {
        "episodes": 105,
        "episode": {0: (2, 2, 0.3824), 2: (5, 1, -0.5411), 39: (75, 1, -2.0567)},
        "metrics": {"value_loss": 1.17148},
        "actions": [0.98, 0.02, 0, 0, 0],
        "evaluation": {
            "return": 0.544806, "length": 2.0, "argmax_return": 1.0, "q_estimate": 0.731302, "q_true": 0.95,
            "q_error": 0.845375,
        },
    },
}  # fmt: skip


@pytest.mark.parametrize("name", RUNS)
def test_a_run_is_trained_to_the_numbers_of_its_engines_version(name: str) -> None:
    run = make_run(RUNS[name])
    records = next(load_engine(run.engine).train([run], {}, lambda progress: True)).records
    golden = GOLDEN[name, ENGINE_VERSIONS[run.engine]]
    assert len(records.episodes) == golden["episodes"]
    for place, told in golden["episode"].items():
        row = records.episodes[place]
        assert (row["step"], row["length"], row["return"]) == pytest.approx(told, abs=1e-4)
    # The policy loss is a mean of terms of about 1 that cancel: processors differ in its last bits (1e-7).
    last, evaluated = records.metrics[-1], records.evaluations[-1]
    assert {key: last[key] for key in golden["metrics"]} == pytest.approx(
        golden["metrics"], rel=1e-3, abs=5e-7
    )
    assert [last[f"action_{action}"] for action in range(5)] == pytest.approx(golden["actions"], abs=1e-6)
    assert {key: evaluated[key] for key in golden["evaluation"]} == pytest.approx(
        golden["evaluation"], rel=1e-3
    )


def test_every_engine_has_a_golden_trace_of_its_version() -> None:
    assert {name.partition(",")[0] for name in RUNS} == set(ENGINE_VERSIONS)
    assert set(GOLDEN) == {(name, ENGINE_VERSIONS[name.partition(",")[0]]) for name in RUNS}
