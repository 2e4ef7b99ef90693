"""Golden traces: some numbers of small runs, by engine and the version that it trained them with.

They change with the arithmetic of engine, rules or libraries. If it was ours that changed, raise
ENGINE_VERSIONS or RULES_VERSION: stored runs must not pass for what the code would train today.
"""

from __future__ import annotations

from typing import Any

import pytest

from pneuma.config import ENGINE_VERSIONS, make_run
from pneuma.engines.loop import train_run
from pneuma.presets import BASES

SMALL: dict[str, Any] = {
    **BASES["table-6-2"],
    "actor": [16], "critic": [24], "horizon": 64, "minibatch": 32, "epochs": 2, "evaluation_episodes": 4,
    "episode_steps": 40, "seed": 11,
}  # fmt: skip
# The run of an engine's version, whose budget ends within an update: how many episodes end; step, length and
# return of some; last numbers.
Numbers = tuple[dict[str, Any], int, dict[int, tuple[int, int, float]], dict[str, float]]
GOLDEN: dict[tuple[str, int], Numbers] = {
    ("sb3", 3): (
        {**SMALL, "steps": 250, "engine": "sb3"}, 6,
        {0: (40, 40, -19.29), 1: (80, 40, -18.76), 5: (240, 40, -38.74)},
        {
            "policy_loss": 0.000103667, "value_loss": 91.7025, "entropy": 1.60934,
            "approx_kl": 1.47242e-06, "clip_fraction": 0.0, "explained_variance": 0.0338046,
            "grad_norm": 45.0114, "grad_norm_actor": 0.384351, "grad_norm_critic": 45.0097,
            "dead_units": 0.1, "action_0": 0.171875, "action_1": 0.28125, "action_4": 0.21875,
            "share_killed": 0.0178571, "return": -33.61, "length": 40.0, "died": 0.0,
            "argmax_share_killed": 0.0, "argmax_return": -34.9133, "random_share_killed": 0.0178571,
        },
    ),
    ("batched", 4): (
        {**SMALL, "steps": 500, "slots": 2}, 12,
        {0: (80, 40, -27.26), 3: (160, 40, -31.44), 11: (480, 40, -11.62)},
        {
            "policy_loss": -0.000912876, "value_loss": 41.0047, "entropy": 1.60904,
            "approx_kl": 2.90796e-05, "clip_fraction": 0.0, "explained_variance": -0.00265437,
            "grad_norm": 33.48, "grad_norm_actor": 0.550502, "grad_norm_critic": 33.4752,
            "dead_units": 0.125, "action_0": 0.226562, "action_1": 0.140625, "action_4": 0.257812,
            "share_killed": 0.0, "return": -37.55, "length": 40.0, "died": 0.0,
            "argmax_share_killed": 0.0, "argmax_return": -36.8033, "random_share_killed": 0.0178571,
        },
    ),
}  # fmt: skip


@pytest.mark.parametrize(("engine", "version"), GOLDEN)
def test_a_run_is_trained_to_the_numbers_of_its_engines_version(engine: str, version: int) -> None:
    fields, episodes, some, numbers = GOLDEN[engine, version]
    records = train_run(make_run(fields), lambda progress: True).records
    assert len(records.episodes) == episodes
    for index, expected in some.items():
        row = records.episodes[index]
        assert (row["step"], row["length"], row["return"]) == pytest.approx(expected, abs=1e-4)
    # The policy loss is a mean of terms of about 1 that cancel: processors differ in its last bits (1e-7).
    last = {**records.metrics[-1], **records.evaluations[-1]}
    assert {key: last[key] for key in numbers} == pytest.approx(numbers, rel=1e-3, abs=1e-6)


def test_every_engine_has_a_golden_trace_of_its_version() -> None:
    assert dict(GOLDEN.keys()) == ENGINE_VERSIONS
