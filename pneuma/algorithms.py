"""The learning algorithms and their optimizers: which engines train each, which of a run's fields it reads.

Data for `pneuma.config`, which resolves a run by it. What an algorithm does not read is at its default
in a resolved run (None, where only some algorithms have it), and a study that sets it is refused.
"""

from __future__ import annotations

from typing import Any

OPEN_LEARNERS = {
    "sac": "stable_baselines3:SAC",
    "td3": "stable_baselines3:TD3",
    "ddpg": "stable_baselines3:DDPG",
    "qr-dqn": "sb3_contrib:QRDQN",
    "tqc": "sb3_contrib:TQC",
    "crossq": "sb3_contrib:CrossQ",
    "recurrent-ppo": "sb3_contrib:RecurrentPPO",
}
"""Learners without fields of their own, and their classes. Any other class of this kind is named itself."""
OF_OPEN_LEARNERS = ("policy", "algorithm_kwargs")
"""Fields by which Stable-Baselines3 trains as a script of one's own would, without exact resume."""

ALGORITHM_ENGINES: dict[str, tuple[str, ...]] = {
    "ppo": ("batched", "sb3"),
    "a2c": ("sb3",),
    "trpo": ("sb3",),
    "dqn": ("sb3",),
    "double-dqn": ("sb3",),
}
"""The engines that train each algorithm with fields of its own, the usual one first."""

ALGORITHMS = (*ALGORITHM_ENGINES, *OPEN_LEARNERS)

_NETWORK = (
    "actor", "activation", "optimizer", "weight_decay", "slots", "gamma", "learning_rate",
    "learning_rate_schedule",
)  # fmt: skip
_ACTOR_CRITIC = (*_NETWORK, "critic", "gae_lambda", "value_baseline")
_GRADIENT = ("value_coefficient", "entropy_coefficient", "gradient_limit", "clip")
_PPO = ("learners", "first_layer_scale", "normalize_advantage", "clip_range_schedule")
_DQN = (
    *_NETWORK, "exploration", "exploration_fraction", "minibatch", "gradient_limit", "buffer_size",
    "learning_starts", "train_every", "gradient_steps", "target_every",
)  # fmt: skip

ALGORITHM_FIELDS: dict[str, tuple[str, ...]] = {
    "ppo": (*_ACTOR_CRITIC, *_GRADIENT, *_PPO, "clip_range", "minibatch", "epochs"),
    "a2c": (*_ACTOR_CRITIC, *_GRADIENT),
    "trpo": (*_ACTOR_CRITIC, "minibatch", "epochs", "target_kl", "conjugate_steps", "line_search_steps"),
    "dqn": _DQN,
    "double-dqn": _DQN,
}
"""The fields each algorithm reads, beside those that all read and those of its optimizer."""

ROLLOUT_LEARNERS = ("ppo", "a2c", "trpo", "recurrent-ppo")
"""Learners whose `n_steps` are the steps of a rollout, which is the field `horizon`."""
VALUE_BASED = tuple(name for name, fields in ALGORITHM_FIELDS.items() if "exploration" in fields)
"""Algorithms that act by estimated values of actions (thesis chapter 3)."""

OF_ALGORITHMS = frozenset(key for keys in ALGORITHM_FIELDS.values() for key in keys)

_TWO_NETWORKS: dict[str, Any] = {"actor": (64, 64), "critic": (64, 64), "activation": "tanh"}
_DQN_DEFAULTS: dict[str, Any] = {
    "actor": (64, 64), "activation": "relu", "optimizer": "adam", "gamma": 0.99, "learning_rate": 1e-4,
    "minibatch": 32, "gradient_limit": 10.0, "buffer_size": 1_000_000, "learning_starts": 100,
    "train_every": 4, "gradient_steps": 1, "target_every": 10_000, "exploration": 0.05,
    "exploration_fraction": 0.1,
}  # fmt: skip

ALGORITHM_DEFAULTS: dict[str, dict[str, Any]] = {
    "ppo": {
        **_TWO_NETWORKS, "optimizer": "adam", "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 3e-4,
        "clip_range": 0.2, "horizon": 2048, "minibatch": 64, "epochs": 10, "value_coefficient": 0.5,
        "entropy_coefficient": 0.0, "gradient_limit": 0.5, "normalize_advantage": True,
    },
    "a2c": {
        **_TWO_NETWORKS, "optimizer": "rmsprop", "gamma": 0.99, "gae_lambda": 1.0, "learning_rate": 7e-4,
        "horizon": 5, "value_coefficient": 0.5, "entropy_coefficient": 0.0, "gradient_limit": 0.5,
    },
    "trpo": {
        **_TWO_NETWORKS, "optimizer": "adam", "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 1e-3,
        "horizon": 2048, "minibatch": 128, "epochs": 10, "target_kl": 0.01, "conjugate_steps": 15,
        "line_search_steps": 10,
    },
    "dqn": _DQN_DEFAULTS,
    "double-dqn": _DQN_DEFAULTS,
    "recurrent-ppo": {"horizon": 128},
}  # fmt: skip
"""What a run has where nobody sets it: the defaults of the classes of Stable-Baselines3 and sb3-contrib."""

OPTIMIZER_DEFAULTS: dict[str, dict[str, Any]] = {
    "adam": {"betas": (0.9, 0.999), "epsilon": 1e-8},
    "sgd": {"momentum": 0.0, "dampening": 0.0},
    "rmsprop": {"smoothing": 0.99, "epsilon": 1e-8, "momentum": 0.0},
    "upgd": {"betas": (0.9, 0.999), "epsilon": 1e-5, "utility_decay": 0.999, "noise": 0.001},
}
"""The fields that each optimizer reads, with torch's defaults, or UPGD's authors'; the others are None in a
resolved run."""

_SMALL_EPSILON = {"epsilon": 1e-5}
OPTIMIZERS_OF_ALGORITHMS: dict[str, dict[str, dict[str, Any]]] = {
    "ppo": {"adam": _SMALL_EPSILON},
    "a2c": {"adam": _SMALL_EPSILON, "rmsprop": _SMALL_EPSILON},
    "trpo": {"adam": _SMALL_EPSILON},
}
"""Where an algorithm has other defaults of an optimizer than the optimizer itself."""

OPTIMIZER_ENGINES: dict[str, tuple[str, ...]] = {
    "adam": ("batched", "sb3"), "sgd": ("batched", "sb3"), "rmsprop": ("batched", "sb3"),
    "upgd": ("batched",),
}  # fmt: skip
"""The engines that have each optimizer."""

OF_OPTIMIZERS = frozenset(key for defaults in OPTIMIZER_DEFAULTS.values() for key in defaults)


def has_fields(algorithm: str) -> bool:
    """Return whether an algorithm has fields; what a learner without them is told is `algorithm_kwargs`."""
    return algorithm in ALGORITHM_FIELDS


def is_own_algorithm(algorithm: str) -> bool:
    """Return whether an algorithm is a class of neither Stable-Baselines3 nor sb3-contrib."""
    module, colon, _ = algorithm.rpartition(":")
    return bool(colon) and module.partition(".")[0] not in ("stable_baselines3", "sb3_contrib")


def engines_of(algorithm: str) -> tuple[str, ...]:
    """Return the engines that train an algorithm, the usual one first."""
    return ALGORITHM_ENGINES.get(algorithm, ("sb3",))


def default_fields(algorithm: str, optimizer: str = "") -> dict[str, Any]:
    """Return the defaults of an algorithm and of an optimizer, which is the algorithm's own if left out."""
    defaults = ALGORITHM_DEFAULTS.get(algorithm, {})
    optimizer = optimizer or defaults.get("optimizer", "")
    own = OPTIMIZERS_OF_ALGORITHMS.get(algorithm, {}).get(optimizer, {})
    return {**defaults, **OPTIMIZER_DEFAULTS.get(optimizer, {}), **own}
