"""The learning algorithms and their optimizers: the engines that train them, and their fields' defaults.

`pneuma.config` declares each field of a run with the algorithms that read it. In a resolved run, a field that
the algorithm does not read has its default (None, where only some algorithms have it). A study that sets it
is refused.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Optimizer:
    """An optimizer of the engine `batched`.

    Attributes:
        defaults: the fields that it reads, with torch's defaults, or those of UPGD's authors.
        torch_class: its class in `torch.optim`, which the engine `sb3` uses; empty if there is none.
        decays_weights_itself: whether its step uses `weight_decay`, instead of gradients that contain it.
    """

    defaults: Mapping[str, Any]
    torch_class: str = ""
    decays_weights_itself: bool = False

    @property
    def engines(self) -> tuple[str, ...]:
        return ("batched", "sb3") if self.torch_class else ("batched",)


OPTIMIZERS = {
    "adam": Optimizer({"betas": (0.9, 0.999), "epsilon": 1e-8}, "Adam"),
    "sgd": Optimizer({"momentum": 0.0, "dampening": 0.0}, "SGD"),
    "rmsprop": Optimizer({"smoothing": 0.99, "epsilon": 1e-8, "momentum": 0.0}, "RMSprop"),
    "upgd": Optimizer(
        {"betas": (0.9, 0.999), "epsilon": 1e-5, "utility_decay": 0.999, "noise": 0.001},
        decays_weights_itself=True,
    ),
}


@dataclass(frozen=True)
class Algorithm:
    """A learning algorithm.

    Attributes:
        defaults: of fields, as in the class of Stable-Baselines3 or sb3-contrib.
        optimizers: defaults of optimizers that differ from the optimizers' own.
        engines: those that train it, the default one first.
        learner: the class of an algorithm without fields of its own: see `pneuma.engines.sb3_open`.
    """

    defaults: Mapping[str, Any] = field(default_factory=dict)
    optimizers: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    engines: tuple[str, ...] = ("sb3",)
    learner: str = ""


_TWO_NETWORKS: dict[str, Any] = {"actor": (64, 64), "critic": (64, 64), "activation": "tanh"}
_SMALL_EPSILON = {"epsilon": 1e-5}
_DQN = Algorithm(
    {
        "actor": (64, 64), "activation": "relu", "optimizer": "adam", "gamma": 0.99, "learning_rate": 1e-4,
        "minibatch": 32, "gradient_limit": 10.0, "buffer_size": 1_000_000, "learning_starts": 100,
        "train_every": 4, "gradient_steps": 1, "target_every": 10_000, "exploration": 0.05,
        "exploration_fraction": 0.1,
    }
)  # fmt: skip

ALGORITHMS: dict[str, Algorithm] = {
    "ppo": Algorithm(
        {
            **_TWO_NETWORKS, "optimizer": "adam", "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 3e-4,
            "clip_range": 0.2, "horizon": 2048, "minibatch": 64, "epochs": 10, "value_coefficient": 0.5,
            "entropy_coefficient": 0.0, "gradient_limit": 0.5, "normalize_advantage": True,
        },
        {"adam": _SMALL_EPSILON},
        ("batched", "sb3"),
    ),
    "a2c": Algorithm(
        {
            **_TWO_NETWORKS, "optimizer": "rmsprop", "gamma": 0.99, "gae_lambda": 1.0, "learning_rate": 7e-4,
            "horizon": 5, "value_coefficient": 0.5, "entropy_coefficient": 0.0, "gradient_limit": 0.5,
        },
        {"adam": _SMALL_EPSILON, "rmsprop": _SMALL_EPSILON},
    ),
    "trpo": Algorithm(
        {
            **_TWO_NETWORKS, "optimizer": "adam", "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 1e-3,
            "horizon": 2048, "minibatch": 128, "epochs": 10, "target_kl": 0.01, "conjugate_steps": 15,
            "line_search_steps": 10,
        },
        {"adam": _SMALL_EPSILON},
    ),
    "dqn": _DQN,
    "double-dqn": _DQN,
    "sac": Algorithm(learner="stable_baselines3:SAC"),
    "td3": Algorithm(learner="stable_baselines3:TD3"),
    "ddpg": Algorithm(learner="stable_baselines3:DDPG"),
    "qr-dqn": Algorithm(learner="sb3_contrib:QRDQN"),
    "tqc": Algorithm(learner="sb3_contrib:TQC"),
    "crossq": Algorithm(learner="sb3_contrib:CrossQ"),
    "recurrent-ppo": Algorithm({"horizon": 128}, learner="sb3_contrib:RecurrentPPO"),
    "maskable-ppo": Algorithm({"horizon": 2048}, learner="sb3_contrib:MaskablePPO"),
}  # fmt: skip

VALUE_BASED = ("dqn", "double-dqn")
"""Algorithms that act by estimated values of actions (thesis chapter 3)."""
LIBRARY_HORIZONS = {"PPO": 2048, "A2C": 5, "TRPO": 2048, "RecurrentPPO": 128, "MaskablePPO": 2048}
"""Defaults of the horizon of the libraries' learners that are named by `module:Class`."""


def find_algorithm(algorithm_name: str) -> Algorithm:
    """Return an algorithm by its name, or a learner by `module:Class`."""
    if algorithm_name in ALGORITHMS:
        return ALGORITHMS[algorithm_name]
    defaults = {}
    class_name = algorithm_name.rpartition(":")[2]
    if class_name in LIBRARY_HORIZONS and not is_own_algorithm(algorithm_name):
        defaults["horizon"] = LIBRARY_HORIZONS[class_name]
    return Algorithm(defaults, learner=algorithm_name)


def has_rollouts(algorithm_name: str) -> bool:
    """Return whether an algorithm's argument `n_steps` is the field `horizon`: the steps of a rollout.

    That of a learner with replay is another. It is not known of a user's own class.
    """
    return "horizon" in find_algorithm(algorithm_name).defaults


def is_masked(algorithm_name: str) -> bool:
    """Return whether an algorithm takes only the actions that its environment's `action_masks()` allows."""
    return find_algorithm(algorithm_name).learner.endswith(":MaskablePPO")


def is_own_algorithm(algorithm_name: str) -> bool:
    """Return whether an algorithm is a class of neither Stable-Baselines3 nor sb3-contrib."""
    module, colon, _ = algorithm_name.rpartition(":")
    return bool(colon) and module.partition(".")[0] not in ("stable_baselines3", "sb3_contrib")


def default_fields(algorithm: str, optimizer: str = "") -> dict[str, Any]:
    """Return the defaults of an algorithm and of an optimizer, which is by default the algorithm's."""
    declaration = find_algorithm(algorithm)
    optimizer = optimizer or declaration.defaults.get("optimizer", "")
    defaults = dict(declaration.defaults)
    if optimizer:
        defaults |= OPTIMIZERS[optimizer].defaults
        defaults |= declaration.optimizers.get(optimizer, {})
    return defaults
