"""Rollouts: a run's policy plays its worlds for one horizon, in one compiled call.

worlds, actor and random numbers → observations, actions, rewards, ends, finished episodes

Everything but the learning happens in here, so that a step costs no Python. Episodes are told apart and
rewards rounded as the slots of Stable-Baselines3 do it (`pneuma.env.sb3`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from pneuma.config import Run, env_config, stream_seed
from pneuma.engines.batched.networks import Layers, flat, sizes
from pneuma.env import rules
from pneuma.env.worlds import ENDINGS, Worlds

ACTIVATION_CODES = {"tanh": 0, "relu": 1, "leaky-relu": 2}
ENDED = np.dtype(
    [
        ("slot", "i8"), ("episode", "i8"), ("step", "i8"), ("return", "f8"), ("length", "i8"),
        ("kills", "i8"), ("hp", "f8"), ("ending", "i8"),
    ],
)  # fmt: skip
"""A finished episode; `step` counts steps of the rollout from 1."""

kernel: Any = njit(cache=True, error_model="numpy")


@dataclass(frozen=True)
class Rollout:
    """What one horizon of T steps in S slots brought.

    Attributes:
        observations: (S, T, features) float32, before each step.
        actions: (S, T) int64.
        rewards: (S, T) float32, without what a time limit cut off.
        starts: (S, T) float32, 1 where a step is an episode's first.
        last_observations: (S, features), after the last step.
        last_ends: (S,) float32, 1 where the last step ended an episode.
        ended: (K,) `ENDED`, in order.
        terminal_observations: (K, features), what the last step of each showed.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    starts: np.ndarray
    last_observations: np.ndarray
    last_ends: np.ndarray
    ended: np.ndarray
    terminal_observations: np.ndarray


class Collector:
    """The worlds of a run's slots, and the episodes that are being played in them.

    Attributes:
        worlds: one for each slot.
        returns, lengths, episodes: (S,) of the episodes so far.
        begins: (S,) float32, 1 where the next step is an episode's first.
        generator: draws the actions.
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        self.worlds = Worlds(run.slots, env_config(run))
        self.worlds.seed([stream_seed(run.stream, "world", slot) for slot in range(run.slots)])
        self.worlds.reset()
        self.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
        self.returns = np.zeros(run.slots)
        self.lengths = np.zeros(run.slots, np.int64)
        self.episodes = np.zeros(run.slots, np.int64)
        self.begins = np.ones(run.slots, np.float32)

    def is_cut_off(self, ended: np.ndarray) -> np.ndarray:
        """Tell which finished episodes a time limit cut off, so that their last state has a value, (K,)."""
        limit = ended["ending"] == rules.TIME_LIMIT
        return limit if self._run.time_limit == "truncate" else np.zeros_like(limit)

    def collect(self, actor: Layers) -> Rollout:
        """Play one horizon with an actor."""
        run, features = self._run, self.worlds.observations.shape[2]
        slots, steps = run.slots, run.horizon
        observations = np.zeros((slots, steps, features), np.float32)
        actions = np.zeros((slots, steps), np.int64)
        rewards, starts = np.zeros((2, slots, steps), np.float32)
        ended = np.zeros(slots * steps, ENDED)
        terminal = np.zeros((16, features), np.float32)
        count = 0
        done = 0
        draws = self.generator.random((steps, slots), np.float32)
        while done < steps:  # more than once only where the room for endings was too little
            done, count = _play(
                self.worlds.handle, flat(actor), sizes(actor), ACTIVATION_CODES[run.activation], draws,
                self.worlds.usual_starts, self.returns, self.lengths, self.episodes, self.begins,
                observations, actions, rewards, starts, ended, terminal, done, count,
            )  # fmt: skip
            if done < steps:
                terminal = np.concatenate([terminal, np.zeros_like(terminal)])
        last = self.worlds.observations[:, 0].copy()
        return Rollout(
            observations, actions, rewards, starts, last, self.begins.copy(), ended[:count], terminal[:count]
        )


def episode_rows(rollout: Rollout, first_step: int, slots: int) -> list[dict[str, Any]]:
    """Return the finished episodes as records; `first_step` agent steps were taken before the rollout."""
    return [
        {
            "slot": int(row["slot"]),
            "episode": int(row["episode"]),
            "step": first_step + int(row["step"]) * slots,
            "return": float(row["return"]),
            "length": int(row["length"]),
            "kills": int(row["kills"]),
            "hp": float(row["hp"]),
            "ending": ENDINGS[int(row["ending"])],
        }
        for row in rollout.ended
    ]


def value_of(critic: Layers, activation: str, observations: np.ndarray) -> np.ndarray:
    """Return the critic's values of a few observations: (K, features) -> (K,) float32."""
    weights, widths = flat(critic), sizes(critic)
    values = np.zeros(len(observations), np.float32)
    scratch = np.zeros((2, int(widths.max())), np.float32)
    for i, observation in enumerate(observations):
        values[i] = _forward(weights, widths, ACTIVATION_CODES[activation], observation, scratch)[0]
    return values


@kernel
def _play(
    handle: Any, weights: Any, widths: Any, activation: int, draws: Any, usual_starts: Any,
    returns: Any, lengths: Any, episodes: Any, begins: Any, observations: Any, actions: Any,
    rewards: Any, starts: Any, ended: Any, terminal: Any, step: int, count: int,
) -> tuple[int, int]:  # fmt: skip
    """Play from `step` on; return the step reached, short of the last where `terminal` was full."""
    s = rules.open_state(handle)
    slots = s.worlds.shape[0]
    chosen = np.zeros((slots, 1), np.int64)
    over = np.zeros(slots, np.bool_)
    scratch = np.zeros((2, widths.max()), np.float32)
    steps = draws.shape[0]
    while step < steps and count + slots <= terminal.shape[0]:
        for i in range(slots):
            observations[i, step] = s.observations[i, 0]
            starts[i, step] = begins[i]
            logits = _forward(weights, widths, activation, s.observations[i, 0], scratch)
            chosen[i, 0] = actions[i, step] = _sample(logits, draws[step, i])
        any_ended = rules.step_worlds(handle, chosen, False) > 0
        for i in range(slots):
            rewards[i, step] = s.events[i, 0].reward
            returns[i] += s.events[i, 0].reward
            lengths[i] += 1
            over[i] = s.worlds[i].ending != 0
            begins[i] = over[i]
            if over[i]:
                row = ended[count]
                row.slot = i
                row.episode = episodes[i]
                row.step = step + 1
                row["return"] = returns[i]
                row.length = lengths[i]
                row.kills = s.players[i, 0].kills
                row.hp = s.players[i, 0].hp
                row.ending = s.worlds[i].ending
                terminal[count] = s.observations[i, 0]
                count += 1
                episodes[i] += 1
                returns[i] = 0.0
                lengths[i] = 0
        if any_ended:
            rules.reset_worlds(handle, usual_starts, over)
            rules.step_worlds(handle, chosen, True)
        step += 1
    return step, count


@kernel
def _forward(weights: Any, widths: Any, activation: int, x: Any, scratch: Any) -> Any:
    """Return a network's outputs for one observation; they lie in `scratch`."""
    at = 0
    inputs = x
    for layer in range(len(widths) - 1):
        n, m = widths[layer], widths[layer + 1]
        out = scratch[layer % 2, :m]
        bias = weights[at + n * m : at + n * m + m]
        for j in range(m):
            out[j] = bias[j]
        for i in range(n):
            row = weights[at + i * m : at + (i + 1) * m]
            value = inputs[i]
            for j in range(m):
                out[j] += value * row[j]
        at += n * m + m
        if layer < len(widths) - 2:
            _activate(activation, out)
        inputs = out
    return inputs


@kernel
def _activate(activation: int, x: Any) -> None:
    if activation == 0:
        for j in range(len(x)):
            x[j] = math.tanh(x[j])
    elif activation == 1:
        for j in range(len(x)):
            x[j] = max(x[j], np.float32(0))
    else:
        for j in range(len(x)):
            x[j] = x[j] if x[j] > 0 else x[j] * np.float32(0.01)


@kernel
def _sample(logits: Any, draw: Any) -> int:
    """Draw from a softmax by a number in [0, 1)."""
    highest = logits[0]
    for value in logits:
        highest = max(highest, value)
    total = np.float32(0)
    for j in range(len(logits)):
        logits[j] = math.exp(logits[j] - highest)
        total += logits[j]
    left = draw * total
    for j in range(len(logits) - 1):
        left -= logits[j]
        if left < 0:
            return j
    return len(logits) - 1


@kernel
def advantages(
    rewards: Any, values: Any, starts: Any, last_values: Any, last_ends: Any, gamma: Any, decay: Any
) -> Any:
    """Return generalised advantages, (S, T) float32 (Schulman et al. 2016; thesis Eq. 3.15).

    Args:
        rewards: (S, T) float32, as all that follows.
        values: (S, T), of the states before each step.
        starts: (S, T), 1 where a step is an episode's first.
        last_values: (S,), after the last step.
        last_ends: (S,), 1 where the last step ended an episode.
        gamma: discount.
        decay: gamma times lambda.
    """
    result = np.zeros_like(rewards)
    slots, steps = rewards.shape
    for i in range(slots):
        going_on = np.float32(1) - last_ends[i]
        next_value = last_values[i]
        last = np.float32(0)
        for t in range(steps - 1, -1, -1):
            delta = rewards[i, t] + gamma * next_value * going_on - values[i, t]
            last = delta + decay * going_on * last
            result[i, t] = last
            going_on = np.float32(1) - starts[i, t]
            next_value = values[i, t]
    return result
