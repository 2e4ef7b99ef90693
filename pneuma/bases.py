"""The sets of fields that studies and searches start from, by name."""

from __future__ import annotations

from typing import Any

from pneuma.sb3_names import DEFAULTS

BASES: dict[str, dict[str, Any]] = {
    "table-6-1": {
        "clip_range": 0.2,
        "horizon": 2048,
        "epochs": 15,
        "value_coefficient": 1.0,
        "betas": (0.9, 0.999),
        "activation": "relu",
        "gradient_limit": None,
    },
    "table-6-2": {
        "clip_range": 0.1,
        "horizon": 256,
        "epochs": 10,
        "value_coefficient": 0.5,
        "betas": (0.9, 0.9),
        "activation": "tanh",
        "gradient_limit": 0.5,
    },
}
"""Thesis Tables 6.1 and 6.2, completed with what the text says elsewhere (sections 6.1 and 6.2)."""

for _base in BASES.values():
    _base.update(
        gamma=0.99, gae_lambda=0.95, learning_rate=3e-4, minibatch=64, entropy_coefficient=0.01,
        optimizer="adam", epsilon=1e-5, actor=(128,), critic=(256,), slots=1, clip="joint",
    )  # fmt: skip
BASES["stable-baselines3"] = DEFAULTS
