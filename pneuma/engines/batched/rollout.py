"""Rollouts: a run's policy plays its worlds for one horizon in one compiled call.

worlds, actor and random numbers → observations, actions, rewards, ends, finished episodes

A whole rollout runs without Python, unless environments or rewards are not Pneuma's own. Slot i is
player i % P of world i // P. The rounding of rewards is as in `pneuma.env.sb3`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from pneuma.config import Run, env_config, slot_seeds, stream_seed
from pneuma.engines.gymnasium_env import GymnasiumSlots
from pneuma.engines.mlp import Network, choose
from pneuma.env import rules
from pneuma.env.compiling import cached
from pneuma.env.fields import is_own_reward
from pneuma.env.kernel import GO_ON, RECORD, RESET, STEP, run_worlds
from pneuma.env.slots import make_slots
from pneuma.env.state import open_state
from pneuma.env.worlds import ENDINGS

ENDED = np.dtype(
    [
        ("slot", "i8"), ("episode", "i8"), ("step", "i8"), ("return", "f8"), ("length", "i8"),
        ("kills", "i8"), ("hp", "f8"), ("ending", "i8"),
    ],
)  # fmt: skip
"""A finished episode; `step` counts the rollout's steps from 1."""

kernel: Any = cached(error_model="numpy")


class Rollout(NamedTuple):
    """One horizon of T steps in S slots."""

    observations: np.ndarray  # (S, T, features) float32, before each step
    actions: np.ndarray  # (S, T) int64
    rewards: np.ndarray  # (S, T) float32, without the value after a time limit
    starts: np.ndarray  # (S, T) float32: 1 if the step before ended an episode
    last_observations: np.ndarray  # (S, features), after the last step
    last_ends: np.ndarray  # (S,) float32: 1 where the last step ended an episode
    ended: np.ndarray  # (K,) `ENDED`, in order
    terminal_observations: np.ndarray  # (K, features), the last one of each ended episode

    def of_player(self, player: int, players: int) -> Rollout:
        """Return the rollout of one player of each world."""
        *arrays, ended_episodes, terminal = self
        is_player = ended_episodes["slot"] % players == player
        ended_episodes = ended_episodes[is_player]
        ended_episodes["slot"] //= players
        player_arrays = [np.ascontiguousarray(array[player::players]) for array in arrays]
        return Rollout._make([*player_arrays, ended_episodes, terminal[is_player]])


def empty_rollout(slots: int, steps: int, features: int) -> Rollout:
    """Return a rollout to fill in, with space for an ending in every step."""
    rewards, starts = np.zeros((2, slots, steps), np.float32)
    return Rollout(
        np.zeros((slots, steps, features), np.float32), np.zeros((slots, steps), np.int64), rewards, starts,
        np.zeros((slots, features), np.float32), np.zeros(slots, np.float32),
        np.zeros(slots * steps, ENDED), np.zeros((slots * steps, features), np.float32),
    )  # fmt: skip


class Collector:
    """The worlds in which a run collects rollouts. Each player of each world is one slot here."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self.generator = np.random.default_rng(stream_seed(run.seed, "actions"))
        self.slots = self._make_slots()
        self.actions = int(self.slots.action_space.n)

    def _make_slots(self) -> Any:
        world_config = env_config(self._run)
        slots = make_slots(self._run.slots * world_config.players, world_config)
        slots.worlds.seed(slot_seeds(self._run))
        slots.worlds.reset()
        return slots

    def collect(self, actor: Network) -> Rollout:
        slots, features = self.slots.observations.shape
        rollout = empty_rollout(slots, self._run.horizon, features)
        draws = self.generator.random((self._run.horizon, slots), np.float32)
        endings = self._play(actor, draws, rollout)
        rollout.last_observations[:], rollout.last_ends[:] = self.slots.observations, self.slots.begins
        return rollout._replace(
            ended=rollout.ended[:endings], terminal_observations=rollout.terminal_observations[:endings]
        )

    def _play(self, actor: Network, draws: np.ndarray, rollout: Rollout) -> int:
        """Fill in a rollout; return the number of endings."""
        worlds = self.slots.worlds
        handle, default_starts = worlds.handle, worlds.default_starts
        if not any(map(is_own_reward, self._run.reward)):
            return _play(handle, actor, draws, default_starts, rollout)
        actions = np.zeros(worlds.players.shape, np.int64)
        endings = 0
        for step, step_draws in enumerate(draws):  # as `_play` does: a user's reward is plain Python
            _choose(handle, actor, step_draws, rollout, step, actions)
            worlds.advance(actions)
            endings = _keep_step(handle, default_starts, rollout, step, endings, actions)
        return endings

    def episode_rows(self, rollout: Rollout, first_step: int) -> list[dict[str, Any]]:
        """Return the rows of the episodes that ended, in a rollout after `first_step` steps."""
        finished_rows = []
        for episode in rollout.ended.tolist():
            finished_row: dict[str, Any] = dict(zip(ENDED.names or (), episode, strict=True))
            finished_row["step"] = first_step + finished_row["step"] * len(rollout.actions)
            finished_row["ending"] = ENDINGS[finished_row["ending"]]
            finished_rows.append(finished_row)
        return finished_rows


class GymnasiumCollector(Collector):
    """Gymnasium's environments in a run's slots; each of their steps is Python."""

    def _make_slots(self) -> Any:
        return GymnasiumSlots(self._run, slot_seeds(self._run), training=True)

    def _play(self, actor: Network, draws: np.ndarray, rollout: Rollout) -> int:
        slots = self.slots
        is_playing, actions = np.ones(draws.shape[1], np.bool_), np.empty(draws.shape[1], np.int64)
        endings = 0
        for step, step_draws in enumerate(draws):
            rollout.observations[:, step], rollout.starts[:, step] = slots.observations, slots.begins
            choose(actor, slots.observations, step_draws, is_playing, actions)
            rollout.actions[:, step] = actions
            ended = slots.step(actions)
            rollout.rewards[:, step] = slots.rewards
            for slot in np.flatnonzero(ended):
                ending = rules.TIME_LIMIT if slots.truncated[slot] else rules.RUNNING
                rollout.ended[endings] = (slot, 0, step + 1, 0.0, 0, 0, 0.0, ending)
                rollout.terminal_observations[endings] = slots.terminal[slot]
                endings += 1
        return endings

    def episode_rows(self, rollout: Rollout, first_step: int) -> list[dict[str, Any]]:
        finished_rows = list(self.slots.finished)
        self.slots.finished.clear()
        return finished_rows


@kernel
def _play(handle: Any, actor: Any, draws: Any, default_starts: Any, rollout: Any) -> int:
    state = open_state(handle)
    actions = np.zeros((state.players.shape[0], state.players.shape[1]), np.int64)
    endings: Any = np.int64(0)  # `_keep_step` would be compiled twice, for a literal 0 and for other numbers
    for step in range(draws.shape[0]):
        _choose(handle, actor, draws[step], rollout, step, actions)
        run_worlds(handle.ctypes.data, actions.ctypes, STEP | RECORD)
        endings = _keep_step(handle, default_starts, rollout, step, endings, actions)
    return endings


@kernel
def _choose(handle: Any, actor: Any, draws: Any, rollout: Any, step: int, actions: Any) -> None:
    """Record what each slot observes and sample its action; idle slots observe zeros."""
    state = open_state(handle)
    players = state.players.shape[1]
    features = state.observations.shape[2]
    observations = np.zeros((len(draws), features), np.float32)
    for i in range(len(draws)):
        slot = state.slots[i // players, i % players]
        if not slot.idle:
            for j in range(features):  # a slice would compile the text of an error
                observations[i, j] = state.observations[i // players, i % players, j]
                rollout.observations[i, step, j] = observations[i, j]
        rollout.starts[i, step] = slot.begins
    slot_actions = np.empty(len(draws), np.int64)
    choose(actor, observations, draws, np.ones(len(draws), np.bool_), slot_actions)
    for i in range(len(draws)):
        rollout.actions[i, step] = actions[i // players, i % players] = slot_actions[i]


@kernel
def _keep_step(handle: Any, default_starts: Any, rollout: Any, step: int, endings: int, actions: Any) -> int:
    """Keep each slot's reward and ending of a step and reset ended worlds; return the number of endings."""
    state = open_state(handle)
    players = state.players.shape[1]
    any_ended = False
    for i in range(state.players.size):
        w, p = i // players, i % players
        player, slot = state.players[w, p], state.slots[w, p]
        has_ended = state.worlds[w].ending != rules.RUNNING
        any_ended |= has_ended
        state.reset_starts[w] = default_starts[w] if has_ended else GO_ON
        rollout.rewards[i, step] = state.events[w, p].reward
        if slot.ending != rules.RUNNING:
            ended_row = rollout.ended[endings]
            ended_row.slot = i
            ended_row.episode = slot.episodes - 1
            ended_row.step = step + 1
            ended_row["return"] = slot.returns
            ended_row.length = slot.lengths
            ended_row.kills = player.kills
            ended_row.hp = player.hp
            ended_row.ending = slot.ending
            for j in range(state.observations.shape[2]):
                rollout.terminal_observations[endings, j] = state.observations[w, p, j]
            endings += 1
    if any_ended:
        run_worlds(handle.ctypes.data, actions.ctypes, RESET)
    return endings


@kernel
def advantages(
    rewards: Any, values: Any, starts: Any, last_values: Any, last_ends: Any, gamma: Any, decay: Any
) -> Any:
    """Return generalised advantages, (S, T) float32 (Schulman et al. 2016; thesis Eq. 4.14).

    All arrays are float32. Values are of the states before each step, (S, T), and after the last one, (S,).
    `starts` and `last_ends` are 1 where the step before ended an episode; `decay` is gamma times lambda.
    """
    all_advantages = np.zeros_like(rewards)
    slots, steps = rewards.shape
    for i in range(slots):
        going_on = np.float32(1) - last_ends[i]
        next_value = last_values[i]
        last_advantage = np.float32(0)
        for t in range(steps - 1, -1, -1):
            delta = rewards[i, t] + gamma * next_value * going_on - values[i, t]
            last_advantage = delta + decay * going_on * last_advantage
            all_advantages[i, t] = last_advantage
            going_on = np.float32(1) - starts[i, t]
            next_value = values[i, t]
    return all_advantages
