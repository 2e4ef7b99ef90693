"""Rollouts: a run's policy plays its worlds for one horizon in one compiled call.

worlds, actor and random numbers → observations, actions, rewards, ends, finished episodes

A whole rollout runs without Python, unless a user's own reward must be called after each step. Slot i is
player i % P of world i // P. Episodes, idle slots and the rounding of rewards are as in the environment for
Stable-Baselines3 (`pneuma.env.worlds.Slots`, `pneuma.env.sb3`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pneuma.config import Run, env_config, stream_seed
from pneuma.engines.environment import slot_seeds
from pneuma.engines.mlp import ACTIVATION_CODES, forward, sample
from pneuma.engines.policy import Layers, flat, sizes
from pneuma.env import rules
from pneuma.env.kernel import GO_ON, run_worlds
from pneuma.env.state import LAYOUT_DIGEST, as_bytes, cached, open_state
from pneuma.env.worlds import ENDINGS, Worlds
from pneuma.env_fields import own_rewards

ENDED = np.dtype(
    [
        ("slot", "i8"), ("episode", "i8"), ("step", "i8"), ("return", "f8"), ("length", "i8"),
        ("kills", "i8"), ("hp", "f8"), ("ending", "i8"),
    ],
)  # fmt: skip
"""A finished episode; `step` counts steps of the rollout from 1."""

_WORLDS = ("worlds", "players", "monsters")
_EPISODES = ("returns", "lengths", "episodes", "begins")
kernel: Any = cached(error_model="numpy")


@dataclass(frozen=True)
class Rollout:
    """One horizon of T steps in S slots.

    Attributes:
        observations: (S, T, features) float32, before each step.
        actions: (S, T) int64.
        rewards: (S, T) float32, without the value after a time limit.
        starts: (S, T) float32, 1 if the step before ended an episode.
        last_observations: (S, features), after the last step.
        last_ends: (S,) float32, 1 where the last step ended an episode.
        ended: (K,) `ENDED`, in order.
        terminal_observations: (K, features), the last observation of each ended episode.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    starts: np.ndarray
    last_observations: np.ndarray
    last_ends: np.ndarray
    ended: np.ndarray
    terminal_observations: np.ndarray


class RolloutBuffers(NamedTuple):
    """The arrays that a rollout reads and writes, beside the worlds."""

    returns: Any
    lengths: Any
    episodes: Any
    begins: Any
    idle: Any
    observations: Any
    actions: Any
    rewards: Any
    starts: Any
    ended: Any
    terminal: Any


class Collector:
    """The worlds of a run's slots, with the episodes in progress.

    Attributes:
        worlds: as many as the run's `slots`; each of their players is one slot.
        returns, lengths, episodes: (S,) of the episodes so far.
        begins: (S,) float32, 1 if the last step ended an episode, or there was none.
        idle: (S,) whether the slot's player died earlier in an episode that still runs.
        generator: draws the actions.
        features, actions: the length of an observation, and the number of actions.
        layout: identifies the layout of the arrays of `saved_state`.
    """

    scaling = None  # Pneuma's worlds scale what they show by themselves

    def __init__(self, run: Run) -> None:
        self._run = run
        self.layout = LAYOUT_DIGEST
        self._asks = bool(own_rewards(run.reward))
        self.worlds = Worlds(run.slots, env_config(run))
        self.worlds.seed(slot_seeds(run))
        self.worlds.reset()
        self.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
        slots = run.slots * run.players
        self.returns = np.zeros(slots)
        self.lengths = np.zeros(slots, np.int64)
        self.episodes = np.zeros(slots, np.int64)
        self.begins = np.ones(slots, np.float32)
        self.idle = np.zeros(slots, np.bool_)
        self.features = self.worlds.observations.shape[2]
        self.actions = int(self.worlds.action_space.n)

    @property
    def observations(self) -> np.ndarray:
        """What each slot's player observes now, (S, features)."""
        return self.worlds.observations.reshape(len(self.idle), self.features)

    def collect(self, actor: Layers) -> Rollout:
        steps, slots, features = self._run.horizon, len(self.idle), self.features
        rewards, starts = np.zeros((2, slots, steps), np.float32)
        buffers = RolloutBuffers(
            self.returns, self.lengths, self.episodes, self.begins, self.idle,
            np.zeros((slots, steps, features), np.float32), np.zeros((slots, steps), np.int64),
            rewards, starts,
            np.zeros(slots * steps, ENDED), np.zeros((slots * steps, features), np.float32),
        )  # fmt: skip
        draws = self.generator.random((steps, slots), np.float32)
        play = self._play_asking if self._asks else _play
        activation = ACTIVATION_CODES[self._run.activation]
        count = play(
            self.worlds.handle,
            flat(actor),
            sizes(actor),
            activation,
            draws,
            self.worlds.usual_starts,
            buffers,
        )
        last = self.observations.copy()
        last[self.idle] = 0.0
        return Rollout(
            buffers.observations, buffers.actions, buffers.rewards, buffers.starts, last, self.begins.copy(),
            buffers.ended[:count], buffers.terminal[:count],
        )  # fmt: skip

    def episode_rows(self, rollout: Rollout, first_step: int) -> list[dict[str, Any]]:
        rows = [dict(zip(ENDED.names or (), row, strict=True)) for row in rollout.ended.tolist()]
        for row in rows:
            row |= {"step": first_step + row["step"] * len(self.idle), "ending": ENDINGS[row["ending"]]}
        return rows

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return everything that the next step depends on, except the generator: arrays by name."""
        idle = ("idle",) if self.worlds.players.shape[1] > 1 else ()
        return {
            **{f"worlds/{name}": as_bytes(getattr(self.worlds, name)) for name in _WORLDS},
            **{f"episodes/{name}": getattr(self, name) for name in (*_EPISODES, *idle)},
        }

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        for name, array in self.saved_state().items():
            if array.shape != saved[name].shape:
                raise ValueError(f"{name} is of shape {saved[name].shape}, not {array.shape}")
            array[:] = saved[name]
        self.worlds.observe()

    def fork(self) -> None:
        self.worlds.rekey(slot_seeds(self._run))
        if self._run.fork_reset == "xp":
            self.worlds.players["xp"] = 0.0
            self.worlds.observe()

    def _play_asking(
        self, handle: Any, weights: Any, widths: Any, activation: int, draws: Any, usual_starts: Any,
        buffers: RolloutBuffers,
    ) -> int:  # fmt: skip
        """Do the same as `_play` step by step, because a user's reward is plain Python."""
        worlds = self.worlds
        chosen = np.zeros(worlds.players.shape, np.int64)
        over = np.zeros(len(worlds), np.bool_)
        scratch = np.zeros((2, len(self.idle), int(widths.max())), np.float32)
        count = 0
        for step, draw in enumerate(draws):
            _choose(handle, weights, widths, activation, draw, buffers, step, chosen, scratch)
            worlds.advance(chosen)
            count = _note(handle, usual_starts, buffers, step, count, over, chosen)
        return count


def is_cut_off(run: Run, ended: np.ndarray) -> np.ndarray:
    """Return which finished episodes a time limit cut off, so that their last state has a value, (K,)."""
    limit = ended["ending"] == rules.TIME_LIMIT
    return limit if run.time_limit == "truncate" else np.zeros_like(limit)


def value_of(critic: Layers, activation: str, observations: np.ndarray) -> np.ndarray:
    """Return the critic's values of a few observations: (K, features) -> (K,) float32."""
    widths, count = sizes(critic), len(observations)
    scratch = np.zeros((2, count, int(widths.max())), np.float32)
    scratch[0, :, : widths[0]] = observations
    return np.array(forward(flat(critic), widths, ACTIVATION_CODES[activation], count, scratch)[:, 0])


@kernel
def _play(
    handle: Any, weights: Any, widths: Any, activation: int, draws: Any, usual_starts: Any, buffers: Any
) -> int:
    """Play a horizon, one step for each of `draws`; return the number of endings."""
    s = open_state(handle)
    chosen = np.zeros((s.players.shape[0], s.players.shape[1]), np.int64)
    over = np.zeros(s.players.shape[0], np.bool_)
    scratch = np.zeros((2, len(buffers.idle), widths.max()), np.float32)
    count = 0
    for step in range(draws.shape[0]):
        _choose(handle, weights, widths, activation, draws[step], buffers, step, chosen, scratch)
        run_worlds(handle, chosen, True)
        count = _note(handle, usual_starts, buffers, step, count, over, chosen)
    return count


@kernel
def _choose(
    handle: Any, weights: Any, widths: Any, activation: int, draws: Any, buffers: Any, step: int, chosen: Any,
    scratch: Any,
) -> None:  # fmt: skip
    """Record what each slot observes and draw its action; idle slots observe zeros."""
    s = open_state(handle)
    players = s.players.shape[1]
    for i in range(len(draws)):
        w, p = i // players, i % players
        if buffers.idle[i]:
            buffers.observations[i, step] = 0.0
        else:
            buffers.observations[i, step] = s.observations[w, p]
        buffers.starts[i, step] = buffers.begins[i]
        scratch[0, i, : widths[0]] = buffers.observations[i, step]
    logits = forward(weights, widths, activation, len(draws), scratch)
    for i in range(len(draws)):
        chosen[i // players, i % players] = buffers.actions[i, step] = sample(logits[i], draws[i])


@kernel
def _note(handle: Any, usual_starts: Any, buffers: Any, step: int, count: int, over: Any, chosen: Any) -> int:
    """Record the result of a step for each slot and reset ended worlds; return the number of endings."""
    s = open_state(handle)
    players = s.players.shape[1]
    any_over = False
    for i in range(len(buffers.idle)):
        w, p = i // players, i % players
        player, event = s.players[w, p], s.events[w, p]
        over[w] = s.worlds[w].ending != rules.RUNNING
        any_over |= over[w]
        present = event.present > 0 or event.died > 0
        buffers.rewards[i, step] = event.reward
        buffers.returns[i] += event.reward
        buffers.lengths[i] += 1
        ended = present and (over[w] or player.hp <= 0)
        buffers.begins[i] = ended
        if ended:
            row = buffers.ended[count]
            row.slot = i
            row.episode = buffers.episodes[i]
            row.step = step + 1
            row["return"] = buffers.returns[i]
            row.length = buffers.lengths[i]
            row.kills = player.kills
            row.hp = player.hp
            row.ending = s.worlds[w].ending if player.hp > 0 else rules.KILLED
            buffers.terminal[count] = s.observations[w, p]
            count += 1
            buffers.episodes[i] += 1
            buffers.returns[i] = 0.0
        if ended or over[w]:  # idle slots start again too
            buffers.lengths[i] = 0
        buffers.idle[i] = not present and not over[w]
    if any_over:
        for w in range(len(over)):
            s.begins[w] = usual_starts[w] if over[w] else GO_ON
        run_worlds(handle, chosen, False)
    return count


@kernel
def advantages(
    rewards: Any, values: Any, starts: Any, last_values: Any, last_ends: Any, gamma: Any, decay: Any
) -> Any:
    """Return generalised advantages, (S, T) float32 (Schulman et al. 2016; thesis Eq. 4.14).

    Args:
        rewards: (S, T) float32, like all other arrays.
        values: (S, T), of the states before each step.
        starts: (S, T), 1 where the step before ended an episode.
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
