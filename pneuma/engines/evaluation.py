"""Evaluation of a frozen policy, with random streams that training never uses.

In Pneuma's worlds all engines evaluate in the same way: `evaluation_episodes` (50) as in training, and one
with the best actions from each distinct start place, even if training uses only the first. The primary
outcome is the share of monsters killed. `score` scales it from the random player (0) to all monsters (1).

Where XP is never reset, policies are trained on what they observe after many episodes. So there each episode
of an evaluation begins with the XP that a player has in one of the training worlds at that moment: evaluation
world i takes that of training world i % N, player by player. The random player observes nothing, and XP
changes rewards alone, which are not recorded of it: it always begins with 0. So do agents of a user's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pneuma.algorithms import VALUE_BASED
from pneuma.arithmetic import log
from pneuma.config import Run, evaluation_config, stream_seed
from pneuma.engines.mlp import choose, network
from pneuma.engines.policy import Policy
from pneuma.engines.stopping import IsStopping, check_stop, never
from pneuma.env import rules
from pneuma.env.fields import MAX_STEPS
from pneuma.env.players import RandomPlayer
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

WEIGHT_LEFT_OUT = 0.01
"""Rewards after a truncated episode count until their discount is below this."""

Act = Callable[[np.ndarray], np.ndarray]
"""From observations, (N, features), to actions, (N,) whole numbers."""
Choose = Callable[[np.ndarray], np.ndarray]
"""From which players still play, (N * P,) booleans, to the actions of all, (N, P)."""


@dataclass(frozen=True)
class OwnAgent:
    """A user's agent, with the methods of a `Policy`; its actions are checked.

    `act` chooses as in training, and `choose` the best actions from the observations alone. Without it,
    attacks stand in for the best actions, so that random numbers do not shift.
    """

    act: Act
    choose: Act | None
    actions: int

    def sample(self, observations: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """Call `act`, which has its own random numbers: (N, features) -> (N,)."""
        return self._call(self.act, observations)

    def best(self, observations: np.ndarray) -> np.ndarray:
        """Call `choose`, or attack if there is none: (N, features) -> (N,)."""
        if self.choose is None:
            return np.full(len(observations), rules.ATTACK)
        return self._call(self.choose, observations)

    def _call(self, act: Act, observations: np.ndarray) -> np.ndarray:
        """Return a function's actions; refuse anything but one valid action per observation."""
        count = len(observations)
        agent_output = act(observations.copy())
        try:
            actions = np.asarray(agent_output)
        except ValueError:  # lists of unlike lengths
            actions = np.empty(0)
        is_fitting = actions.shape == (count,) and actions.dtype.kind in "iu"
        if not is_fitting or not 0 <= actions.min() <= actions.max() < self.actions:
            raise UserError(
                f"the agent gave {str(agent_output)[:60]!r}: must be {count} whole numbers from 0 to "
                f"{self.actions - 1}, one per observation (Stable-Baselines3's predict: take [0])"
            )
        return actions


class Evaluation:
    def __init__(self, run: Run, is_stopping: IsStopping = never) -> None:
        self.run, self._is_stopping = run, is_stopping
        self.episodes = run.evaluation_episodes
        self.argmax_starts = len(Worlds(1, evaluation_config(run)).level.starts)
        self.worlds = Worlds(self.episodes + self.argmax_starts, evaluation_config(run))
        episode_numbers = np.arange(len(self.worlds)) - self.episodes
        self._starts = np.maximum(episode_numbers, -1)  # at random, then each place once
        self.random_share = self._play_at_random()
        self.action_values: ActionValues | None = None
        if run.algorithm in VALUE_BASED:
            self.action_values = ActionValues(run, self.argmax_starts, is_stopping)

    def evaluate(
        self, policy: Policy | OwnAgent, step: int, training_xp: np.ndarray | None = None
    ) -> dict[str, Any]:
        """Return one row of `records.EVALUATION_COLUMNS` for the policy that acts at agent step `step`.

        It also has some of `VALUE_COLUMNS`, as `q_estimate` and `q_true` for a policy of action values.

        Args:
            policy: its features and actions are those of the worlds.
            step: the evaluation's random stream depends on it.
            training_xp: (N, P) the XP with which episodes begin if XP is never reset; 0 if left out.
        """
        self._play(self._action_chooser(policy, step), training_xp)
        worlds, tallies = self.worlds, self.worlds.tallies
        cleared = tallies["cleared"]
        kills = worlds.players["kills"]
        killed_share = kills.sum(axis=1) / max(worlds.monsters.shape[1], 1)
        sampled, best = slice(None, self.episodes), slice(self.episodes, None)
        action_counts = worlds.action_counts[sampled].sum(axis=0)
        evaluation_row = {
            "step": step,
            "episodes": self.episodes,
            "argmax_starts": self.argmax_starts,
            "score": self._score(killed_share[sampled]),
            "argmax_score": self._score(killed_share[best]),
            "argmax_share_killed": float(killed_share[best].mean()),
            "argmax_return": float(tallies["returns"][best].mean()),
            "random_share_killed": self.random_share,
            "commonest_action": float(action_counts.max() / action_counts.sum()),
        }
        sampled_values = {
            "share_killed": killed_share,
            "return": tallies["returns"],
            "length": worlds.worlds["steps"],
            "died": worlds.worlds["ending"] == rules.KILLED,
            "steps_to_clear": np.where(cleared, cleared, self.run.episode_steps),
            "hp_lost": tallies["hp_lost"],
        }
        for column, world_values in sampled_values.items():
            evaluation_row[column] = float(world_values[sampled].mean())
        if kills.shape[1] > 1:
            evaluation_row["kill_evenness"] = evenness(kills[sampled])
        if self.action_values and isinstance(policy, Policy):
            evaluation_row |= self.action_values.measure(policy, training_xp)
        return evaluation_row

    def _score(self, killed_share: np.ndarray) -> float:
        """Return the score of a share of monsters killed: 0 for the random player's, 1 for all.

        NaN if there are no monsters, or the random player kills them all.
        """
        if not self.worlds.monsters.shape[1] or self.random_share == 1:
            return math.nan
        return float((killed_share.mean() - self.random_share) / (1 - self.random_share))

    def _play_at_random(self) -> float:
        generator = np.random.default_rng(stream_seed(self.run.seed, "random-player"))
        random_player = RandomPlayer(generator)
        self._play(lambda _: random_player.act(self.worlds))
        kill_counts = self.worlds.players["kills"][: self.episodes].sum(axis=1)
        return float(kill_counts.mean()) / max(self.worlds.monsters.shape[1], 1)

    def _action_chooser(self, policy: Policy | OwnAgent, step: int) -> Choose:
        """Return a function that chooses actions: sampled ones in the first worlds, else the best."""
        generator = np.random.default_rng(stream_seed(self.run.seed, "evaluation-actions", step))
        players, features = self.worlds.observations.shape[1:]
        sampled_rows = self.episodes * players
        observations = self.worlds.observations.reshape(-1, features)  # (N * P, features)
        actions = np.zeros(self.worlds.players.shape, np.int64)
        flat_actions = actions.reshape(-1)
        if isinstance(policy, Policy) and policy.exploration is None:
            actor = network(policy.actor, policy.activation)

            def compute(is_playing: np.ndarray) -> np.ndarray:
                draws = generator.random(sampled_rows, np.float32)
                choose(actor, observations, draws, is_playing, flat_actions)
                return actions

            return compute

        def call(is_playing: np.ndarray) -> np.ndarray:
            """Choose for all rows of a group until its last world has ended."""
            if is_playing[:sampled_rows].any():
                flat_actions[:sampled_rows] = policy.sample(observations[:sampled_rows], generator)
            if is_playing[sampled_rows:].any():
                flat_actions[sampled_rows:] = policy.best(observations[sampled_rows:])
            return actions

        return call

    def _play(self, choose_actions: Choose, training_xp: np.ndarray | None = None) -> None:
        """Play one episode in every world, always the same one, up to its end."""
        self.worlds.seed([stream_seed(self.run.seed, "evaluation", i) for i in range(len(self.worlds))])
        _set_xp(self.worlds, training_xp)
        self.worlds.reset(starts=self._starts)
        players = self.worlds.players.shape[1]
        running_worlds = len(self.worlds)
        is_playing = np.ones(len(self.worlds) * players, np.bool_)
        while running_worlds:
            check_stop(self._is_stopping)
            ended = self.worlds.advance(choose_actions(is_playing))
            if ended:
                running_worlds -= ended
                is_playing = np.repeat(self.worlds.worlds["ending"] == rules.RUNNING, players)


def _set_xp(worlds: Worlds, training_xp: np.ndarray | None) -> None:
    """Give seeded worlds the XP of training worlds, (N, P), in turn, which a reset keeps; None leaves 0."""
    if training_xp is not None:
        worlds.players["xp"] = training_xp[np.arange(len(worlds)) % len(training_xp)]


def evenness(kills: np.ndarray) -> float:
    """Return how evenly players share an episode's kills, a mean over those with any.

    0: one player has every kill; 1: equal shares. It is the entropy of their shares over its greatest value
    (Pielou 1966), of (episodes, players >= 2).
    """
    kills = kills[kills.any(axis=1)]
    if not len(kills):
        return math.nan
    kill_shares = kills / kills.sum(axis=1, keepdims=True)
    entropy = -(kill_shares * log(np.where(kill_shares > 0, kill_shares, 1.0))).sum(axis=1)
    return float(entropy.mean() / log(kills.shape[1]))


# --- Estimated values of actions -----------------------------------------------------------------


class ActionValues:
    """Plays the greedy policy once from every start place, to measure the true value of its states.

    The greatest estimated values of actions are compared with it, as in van Hasselt, Guez and Silver (2015);
    the difference is the overestimation (thesis section 3.3). Episodes begin with the XP that those of
    evaluations begin with, because estimates depend on what the player observes.

    Learners bootstrap at a time limit that truncates. So episodes continue past it, until the rewards of the
    last state before it are known. A time limit that terminates ends them.
    """

    def __init__(self, run: Run, starts: int, is_stopping: IsStopping = never) -> None:
        self.run, self._is_stopping = run, is_stopping
        steps_beyond = _steps_beyond(run)
        longest_steps = run.episode_steps + (steps_beyond or 0)
        self.worlds = Worlds(starts, replace(evaluation_config(run), episode_steps=longest_steps))
        self._is_measurable = steps_beyond is not None

    def measure(self, policy: Policy, training_xp: np.ndarray | None = None) -> dict[str, float]:
        """Return `q_estimate` and `q_true`, means over all visited states.

        Both are NaN if an endless future is not discounted, or hardly at all.
        """
        estimates, rewards, is_present = self._play(policy, training_xp)
        if self.worlds.truncated.any() and not self._is_measurable:
            return {"q_estimate": math.nan, "q_true": math.nan}
        true = discounted(rewards, self.run.gamma)
        is_present[self.run.episode_steps :] = False
        return {"q_estimate": float(estimates[is_present].mean()), "q_true": float(true[is_present].mean())}

    def _play(
        self, policy: Policy, training_xp: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return estimates, rewards and whether the player was alive, each (steps, worlds, players)."""
        worlds = self.worlds
        worlds.seed([stream_seed(self.run.seed, "action-values", i) for i in range(len(worlds))])
        _set_xp(worlds, training_xp)
        worlds.reset(starts=np.arange(len(worlds)))
        estimates, rewards, present = [], [], []
        running_worlds = len(worlds)
        while running_worlds:
            check_stop(self._is_stopping)
            action_values = policy.logits(worlds.observations.reshape(-1, worlds.observations.shape[2]))
            best_actions = action_values.argmax(axis=1).reshape(worlds.players.shape)
            running_worlds -= worlds.step(best_actions)
            estimates.append(action_values.max(axis=1).reshape(worlds.players.shape))
            rewards.append(worlds.events["reward"].copy())
            present.append(worlds.present.copy())
        return np.stack(estimates), np.stack(rewards), np.stack(present)


def discounted(rewards: np.ndarray, gamma: float) -> np.ndarray:
    """Return the discounted sum of rewards from each step on, (steps, …), with nothing after the last."""
    discounted_sums = np.zeros((len(rewards) + 1, *rewards.shape[1:]))
    for step in reversed(range(len(rewards))):
        discounted_sums[step] = rewards[step] + gamma * discounted_sums[step + 1]
    return discounted_sums[:-1]


def _steps_beyond(run: Run) -> int | None:
    """Return how many steps past the time limit must be played; None if no number is enough."""
    if run.time_limit == "terminate" or run.gamma == 0:
        return 0
    if run.gamma == 1:
        return None
    steps_beyond = math.ceil(float(log(WEIGHT_LEFT_OUT) / log(run.gamma)))
    if run.episode_steps + steps_beyond > MAX_STEPS:
        return None
    return steps_beyond
