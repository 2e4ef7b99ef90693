"""A stored policy: networks as plain arrays, independent of the engine that trained them.

A policy is stored as safetensors with JSON, so that reading an untrusted file runs no code.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np
from safetensors.numpy import load, save

from pneuma.config import ACTIVATIONS
from pneuma.engines.mlp import (
    Layers,
    dead_units,
    layer_widths,
    network,
    outputs_of,
    sample_rows,
)
from pneuma.engines.normalization import Scaling
from pneuma.engines.records import POLICY_FILE
from pneuma.errors import UserError

if TYPE_CHECKING:
    from pneuma.env.worlds import Worlds

LEARNER_FILE = "policy.zip"
"""The policy of a learner of `sb3_open`, as Stable-Baselines3 saves it."""

ACTION_ARRAYS = ("deviation", "bounds", "choices")
"""Attributes of a `Policy` that are stored as arrays."""


class SavedPolicy(Protocol):
    """The policy at the end of a run: its file in the run's folder, and the contents."""

    @property
    def file(self) -> str: ...

    def to_bytes(self) -> bytes: ...


@dataclass(frozen=True, repr=False)
class Policy:
    """An actor and a critic, or one network of action values, as multilayer perceptrons.

    Attributes:
        activation: of the hidden layers.
        actor: its last layer gives logits, or the values of actions.
        critic: its last layer gives one value; empty if the actor gives action values.
        exploration: if the actor gives action values, the probability of a random action; otherwise the
            action with the greatest value is taken (thesis Eq. 4.4). None if it gives logits.
        deviation: (dimensions,) for continuous actions, the standard deviation of their normal distribution;
            the actor gives its mean.
        bounds: (2, …) for continuous actions, the lowest and the highest action, in shape and type of the
            action space; actions are clipped to them.
        choices: (…) for actions that are several choices at once, the number of values of each choice; their
            logits follow one another.
        scaling: how observations are normalised before the networks see them, if they are.
    """

    file: ClassVar[str] = POLICY_FILE
    activation: str
    actor: Layers
    critic: Layers
    exploration: float | None = None
    deviation: np.ndarray | None = None
    bounds: np.ndarray | None = None
    choices: np.ndarray | None = None
    scaling: Scaling | None = None

    def __repr__(self) -> str:
        """Return the sizes of the networks, not their numbers, in one line."""
        actor = layer_widths(self.actor).tolist()
        critic = layer_widths(self.critic).tolist() if self.critic else "none"
        return f"Policy({self.activation}, actor {actor}, critic {critic})"

    @property
    def features(self) -> int:
        return int(self.actor[0][0].shape[-2])

    @property
    def actions(self) -> int:
        """The number of actions, or of numbers in an action, or of logits of all its choices."""
        return int(self.actor[-1][1].shape[-1])

    @property
    def players(self) -> int:
        """The number of players with policies of their own; 1 if all share one.

        Row i of observations belongs to player i % players of world i // players.
        """
        return _players(self.actor)

    def logits(self, observations: np.ndarray) -> np.ndarray:
        """Return actions' unnormalised log-probabilities, or values: (N, features) -> (N, actions)."""
        return self._outputs(self.actor, observations)

    def values(self, observations: np.ndarray) -> np.ndarray:
        """Return the critic's values: (N, features) -> (N,)."""
        return self._outputs(self.critic, observations)[:, 0]

    def _outputs(self, layers: Layers, observations: np.ndarray) -> np.ndarray:
        """Return a network's outputs: (N, features) -> (N, outputs); row i is of player i % players."""
        scaled_observations = self.scaling(observations) if self.scaling else observations
        rows = np.ascontiguousarray(scaled_observations, np.float32)
        if len(rows) % self.players:
            allowed = f"give one for each of {self.players} players"
            raise UserError(f"{len(rows)} observations are not allowed: {allowed}")
        weights, widths, activation = network(layers, self.activation)
        outputs = np.empty((len(rows), widths[-1]), np.float32)
        for player, own_weights in enumerate(weights):
            own_rows = np.ascontiguousarray(rows[player :: self.players])
            outputs[player :: self.players] = outputs_of(own_weights, widths, activation, own_rows)
        return outputs

    def sample(self, observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Sample an action for each observation: (N, features) -> (N,), or (N, …) of several numbers."""
        logits = self.logits(observations)
        if self.deviation is not None:
            noise = self.deviation * generator.standard_normal(logits.shape, np.float32)
            return self._clip(logits + noise)
        if self.exploration is not None:
            explores = generator.random(len(logits)) < self.exploration
            random_actions = generator.integers(logits.shape[1], size=len(logits))
            return np.where(explores, random_actions, logits.argmax(axis=1))
        return self._join([_sample_choice(choice, generator) for choice in self._split(logits)])

    def best(self, observations: np.ndarray) -> np.ndarray:
        """Return the most probable action, or that of the greatest value, in the shape of `sample`'s."""
        logits = self.logits(observations)
        if self.deviation is not None:
            return self._clip(logits)
        return self._join([choice.argmax(axis=1) for choice in self._split(logits)])

    def predict(
        self,
        observation: np.ndarray | dict[str, np.ndarray],
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """Return actions for one observation, (features,), or several, (N, features), and the state.

        It is a `PolicyPredictor` of Stable-Baselines3, for its `evaluate_policy`. Sampled actions follow
        `numpy.random.seed`.
        """
        observation_array = np.asarray(observation)
        flat_observations = observation_array.reshape(-1, self.features)
        generator = np.random.default_rng(np.random.randint(2**31))
        actions = self.best(flat_observations) if deterministic else self.sample(flat_observations, generator)
        if observation_array.ndim == 1:
            return actions[0], state
        return actions, state

    def _split(self, logits: np.ndarray) -> list[np.ndarray]:
        """Return the logits of each of an action's choices."""
        if self.choices is None:
            return [logits]
        return np.split(logits, self.choices.ravel().cumsum()[:-1], axis=1)

    def _join(self, actions: list[np.ndarray]) -> np.ndarray:
        """Return actions from those of each choice."""
        if self.choices is None:
            return actions[0]
        return np.stack(actions, axis=1).reshape(-1, *self.choices.shape)

    def _clip(self, actions: np.ndarray) -> np.ndarray:
        assert self.bounds is not None
        low, high = self.bounds
        return np.clip(actions.reshape(-1, *low.shape), low, high).astype(low.dtype)

    def entropy(self, observations: np.ndarray) -> float:
        """Return the mean entropy of the actions over observations, (N, features), in nats."""
        if self.deviation is not None:
            return float((0.5 * np.log(2 * np.pi * np.e) + np.log(self.deviation)).sum())
        logits = self.logits(observations).astype(float)
        return sum(_entropy(choice) for choice in self._split(logits))

    def to_bytes(self) -> bytes:
        """Serialise as safetensors, with activation and exploration in the header."""
        metadata: dict[str, object] = {"schema": 1, "activation": self.activation}
        if self.exploration is not None:
            metadata["exploration"] = self.exploration
        return save(self._arrays(), metadata={"pneuma": json.dumps(metadata)})

    @property
    def checksum(self) -> str:
        """16 hexadecimal digits, which two policies share only if they are equal to the last bit.

        They are of the SHA-256 of activation, exploration, and each array's name, type, shape and
        little-endian bytes. A file's own layout, which depends on safetensors' version, does not count.
        """
        digest = hashlib.sha256(json.dumps([self.activation, self.exploration]).encode())
        for array_name, array in sorted(self._arrays().items()):
            little_endian = array.astype(array.dtype.newbyteorder("<"))
            digest.update(json.dumps([array_name, little_endian.dtype.str, array.shape]).encode())
            digest.update(little_endian.tobytes())
        return digest.hexdigest()[:16]

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return all arrays by the names that they have in a file."""
        arrays: dict[str, np.ndarray] = {}
        for network_name, layers in (("actor", self.actor), ("critic", self.critic)):
            for i, (weight, bias) in enumerate(layers):
                arrays[f"{network_name}.{i}.weight"] = np.ascontiguousarray(weight)
                arrays[f"{network_name}.{i}.bias"] = np.ascontiguousarray(bias)
        for array_name in ACTION_ARRAYS:
            array = getattr(self, array_name)
            if array is not None:
                arrays[array_name] = np.ascontiguousarray(array)
        if self.scaling is not None:
            arrays["observations.mean"] = self.scaling.mean
            arrays["observations.variance"] = self.scaling.variance
        return arrays


def _sample_choice(logits: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    return sample_rows(np.ascontiguousarray(logits), generator.random(len(logits), np.float32))


def _entropy(logits: np.ndarray) -> float:
    log_probabilities = logits - logits.max(axis=1, keepdims=True)
    log_probabilities -= np.log(np.exp(log_probabilities).sum(axis=1, keepdims=True))
    return float(-(np.exp(log_probabilities) * log_probabilities).sum(axis=1).mean())


def overflows(policy: Policy, observations: np.ndarray) -> bool:
    """Return whether finite observations, (N, features), give logits that are not finite."""
    with np.errstate(over="ignore", invalid="ignore"):
        logits = policy.logits(observations)
    return bool(np.isfinite(observations).all() and not np.isfinite(logits).all())


def read_sound_policy(encoded_policy: bytes) -> Policy:
    """Read a policy, which may be untrusted, from the bytes of `Policy.to_bytes`."""
    try:
        policy = _read_policy(encoded_policy)
        is_sound = _is_sound(policy)
    except Exception:  # safetensors, JSON and shapes raise different errors
        is_sound = False
    if not is_sound:
        raise UserError(f"{POLICY_FILE}: is not a policy, or its layers do not match each other")
    return policy


def checksum_of_file(encoded_policy: bytes) -> str:
    """Return the `checksum` of a policy, from the bytes of `Policy.to_bytes`; it is not tried."""
    return _read_policy(encoded_policy).checksum


def _read_policy(encoded_policy: bytes) -> Policy:
    header = json.loads(encoded_policy[8 : 8 + int.from_bytes(encoded_policy[:8], "little")])
    metadata = json.loads(header["__metadata__"]["pneuma"])
    arrays = load(encoded_policy)
    scaling = None
    if "observations.mean" in arrays:
        scaling = Scaling(arrays["observations.mean"], arrays["observations.variance"])
    return Policy(
        activation=metadata["activation"],
        actor=_layers_in(arrays, "actor"),
        critic=_layers_in(arrays, "critic"),
        exploration=metadata.get("exploration"),
        scaling=scaling,
        **{array_name: arrays.get(array_name) for array_name in ACTION_ARRAYS},
    )


def _layers_in(arrays: Mapping[str, np.ndarray], network: str) -> Layers:
    layers: list[tuple[np.ndarray, np.ndarray]] = []
    while f"{network}.{len(layers)}.weight" in arrays:
        layer_name = f"{network}.{len(layers)}"
        layers.append((arrays[f"{layer_name}.weight"], arrays[f"{layer_name}.bias"]))
    return tuple(layers)


def _is_sound(policy: Policy) -> bool:
    """Return whether a policy's parts match, so that it can play, compiled or not: it is tried once."""
    for layers in (policy.actor, policy.critic):
        # compiled functions trust these: nothing there checks an index
        widths = [policy.features, *(weight.shape[-1] for weight, _ in layers)]
        for (weight, bias), inputs, outputs in zip(layers, widths[:-1], widths[1:], strict=True):
            shape = (*policy.actor[0][0].shape[:-2], inputs, outputs)
            is_array = (
                weight.dtype == bias.dtype == np.float32 and weight.ndim in (2, 3) and bool(weight.size)
            )
            if not is_array or weight.shape != shape or bias.shape != (*shape[:-2], outputs):
                return False
    choices = policy.choices
    if choices is not None and (choices.min() < 1 or choices.sum() != policy.actions):
        return False
    observations = np.zeros((policy.players, policy.features), np.float32)
    outputs = policy.sample(observations, np.random.default_rng(0))
    if policy.exploration is None:
        if policy.critic[-1][1].shape[-1] != 1:
            return False
        outputs = np.append(outputs, policy.values(observations))
    return policy.activation in ACTIVATIONS and bool(np.isfinite(outputs).all())


def action_sampler(
    policy: Policy, worlds: Worlds, generator: np.random.Generator
) -> Callable[[Worlds], np.ndarray]:
    """Return a function that samples actions, (N, P), from a policy in worlds."""
    check_fits(policy, worlds)

    def act(worlds: Worlds) -> np.ndarray:
        flat_observations = worlds.observations.reshape(-1, policy.features)
        return policy.sample(flat_observations, generator).reshape(worlds.players.shape)

    return act


def check_fits(policy: Policy, worlds: Worlds) -> None:
    """Refuse worlds with other observations, actions or (where each has a policy) players."""
    trained = {"features": policy.features, "actions": policy.actions}
    present = {"features": worlds.observations.shape[2], "actions": int(worlds.action_space.n)}
    if policy.players > 1:
        trained["players"], present["players"] = policy.players, worlds.players.shape[1]
    for name in trained:
        if trained[name] != present[name]:
            raise UserError(f"was trained on {trained[name]} {name}, but these settings have {present[name]}")


def _players(layers: Layers) -> int:
    """Return the number of players with networks of their own; 1 if all share one, or there are no layers."""
    return len(layers[0][0]) if layers and layers[0][0].ndim == 3 else 1


def dead_share(policy: Policy, observations: np.ndarray) -> float:
    """Return the share of hidden units, of actor and critic, that are dead: see `mlp.is_dead_output`."""
    rows = np.ascontiguousarray(observations, np.float32)
    dead_count = unit_count = 0
    for layers in (policy.actor, policy.critic):
        if layers:
            weights, widths, activation = network(layers, policy.activation)
            dead, units = dead_units(weights[0], widths, activation, rows)
            dead_count, unit_count = dead_count + dead, unit_count + units
    return dead_count / unit_count
