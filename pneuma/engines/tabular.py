"""The tabular engine: Q-learning and double Q-learning on `pneuma/Mailman-v0` (thesis chapter 3).

Every step is learned from at once (Eq. 3.3). An update, after which a run may be stopped, is `horizon` steps.

There are no monsters, so the return is the primary outcome. As the process is known, true and best values are
computed exactly.
"""

from __future__ import annotations

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.loop import ResumableTrainer
from pneuma.engines.mailman import ACTIONS, HOME, LETTERS, PLACES, POST_OFFICE, MailmanEnv, decision_process
from pneuma.engines.policy import Policy
from pneuma.engines.records import (
    Checkpoint,
    Records,
    Row,
    action_shares,
    episode_row,
    evaluation_row,
    metrics_row,
)

ENDING = "home"
LONGEST_ROUTE = 2


class TableTrainer(ResumableTrainer):
    """Trains a run's tables: (1 or 2, places, actions) values, 0 at first; two in double Q-learning."""

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self.env = _make_env(run)
        count = 2 if run.algorithm == "double-q-learning" else 1
        self.tables = np.zeros((count, PLACES, ACTIONS))
        self._generator = np.random.default_rng(stream_seed(run.seed, "actions"))
        self._place = int(self.env.reset(seed=stream_seed(run.seed, "world"))[0])
        self._return, self._length, self._episode = 0.0, 0, 0
        self._finished: list[Row] = []

    def update(self, before: int, after: int, records: Records) -> bool:
        steps = (self._step(taken) for taken in range(before, after))
        actions, errors = (np.array(each) for each in zip(*steps, strict=True))
        loss, shares = float((errors**2).mean()), action_shares(self.run, actions, ACTIONS)
        records.metrics.append(metrics_row(after, {"value_loss": loss, **shares}))
        records.episodes.extend(self._finished)
        self._finished.clear()
        return bool(np.isfinite(self.tables).all())

    def evaluate(self, step: int) -> Row:
        """Evaluate the tables: returns and lengths by play with exploration, values by computation.

        `argmax_return` is the mean return of the greedy route. `q_estimate` and `q_true` are means over post
        office and letters; the latter is the discounted value of the greedy route.
        """
        run, mean = self.run, self.tables.mean(axis=0)
        process, greedy = decision_process(self.env.slip), mean.argmax(axis=1)[:HOME]
        best = policy_values(process, greedy, 1.0)[POST_OFFICE:LETTERS]
        values = {
            "q_estimate": float(estimated_values(self.tables)[:HOME].mean()),
            "q_true": float(policy_values(process, greedy, run.gamma).mean()),
        }
        return evaluation_row(step, *_play(run, mean, step), best, values)

    def _step(self, taken: int) -> tuple[int, float]:
        """Take one step, after `taken` others, and learn from it; return the action and its error."""
        action = self._choose(taken)
        next_place, reward, ended, _, _ = self.env.step(np.int64(action))
        updated = int(self._generator.integers(len(self.tables)))
        step = self._place, action, reward, None if ended else int(next_place)
        error = temporal_difference(self.tables, updated, step, self.run.gamma)
        self.tables[updated, self._place, action] += self.run.learning_rate * error
        self._return, self._length, self._place = self._return + reward, self._length + 1, int(next_place)
        if ended:
            row = episode_row(0, self._episode, taken + 1, self._return, self._length, ENDING)
            self._finished.append(row)
            self._return, self._length, self._episode = 0.0, 0, self._episode + 1
            self._place = int(self.env.reset()[0])
        return action, error

    def _choose(self, taken: int) -> int:
        """Return a random action, or one with the greatest value, with ties broken at random."""
        if self._generator.random() < exploration_rate(self.run, taken):
            return int(self._generator.integers(self.tables.shape[2]))
        values = self.tables[:, self._place].mean(axis=0)
        return int(self._generator.choice(np.flatnonzero(values == values.max())))

    def policy(self) -> Policy:
        """Return the mean of the tables as a network without hidden layers, for one-hot observations."""
        table = self.tables.mean(axis=0).astype(np.float32)
        layer = (table, np.zeros(table.shape[1], np.float32))
        return Policy(self.run.activation, (layer,), (), self.run.exploration)

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        numbers = {
            "actions": self._generator.bit_generator.state,
            "world": self.env.np_random.bit_generator.state,
            "day": [self._place, self._return, self._length, self._episode],
        }
        return Checkpoint(step, {"tables": self.tables.copy()}, numbers, records.copy())

    def restore(self, checkpoint: Checkpoint) -> None:
        self.tables = checkpoint.arrays["tables"].copy()
        self._generator.bit_generator.state = checkpoint.numbers["actions"]
        self.env.np_random.bit_generator.state = checkpoint.numbers["world"]
        self._place, self._return, self._length, self._episode = checkpoint.numbers["day"]
        self.env.place = self._place


def _make_env(run: Run) -> MailmanEnv:
    return MailmanEnv(run.action_slip or 0.0, run.reward_noise or 0.0)


def temporal_difference(
    tables: np.ndarray, updated: int, step: tuple[int, int, float, int | None], gamma: float
) -> float:
    """Return the temporal-difference error of a step (thesis Eq. 3.2; with two tables Eq. 3.9).

    The step is place, action, reward, and the next place, None at the end. The updated one of the tables,
    (1 or 2, places, actions), chooses the next action, and the other one values it. A single table does both.
    """
    place, action, reward, next_place = step
    rated = 0.0
    if next_place is not None:
        best = tables[updated, next_place].argmax()
        rated = float(tables[len(tables) - 1 - updated, next_place, best])
    return reward + gamma * rated - float(tables[updated, place, action])


def exploration_rate(run: Run, taken: int) -> float:
    """Return the probability of a random action after so many steps; it falls linearly, then stays."""
    least, falling = run.exploration or 0.0, (run.exploration_fraction or 0.0) * run.steps
    return least if taken >= falling else 1 + (least - 1) * taken / falling


# --- Evaluation -----------------------------------------------------------------------------------


def _play(run: Run, values: np.ndarray, step: int) -> tuple[list[float], list[int]]:
    generator = np.random.default_rng(stream_seed(run.seed, "evaluation-actions", step))
    env = _make_env(run)
    env.reset(seed=stream_seed(run.seed, "evaluation"))
    returns, lengths = [0.0] * run.evaluation_episodes, [0] * run.evaluation_episodes
    for episode in range(run.evaluation_episodes):
        place, ended = env.reset()[0], False
        while not ended:
            explore = generator.random() < (run.exploration or 0.0)
            action = generator.integers(values.shape[1]) if explore else values[place].argmax()
            place, reward, ended, _, _ = env.step(np.int64(action))
            returns[episode] += reward
            lengths[episode] += 1
    return returns, lengths


def estimated_values(tables: np.ndarray) -> np.ndarray:
    """Return the tables' estimate of each place's value, (places,).

    For double Q-learning, this is the value in one table of the other table's best action, averaged over both
    tables (Eq. 3.9). It is the estimate from which it learns.
    """
    best = tables.argmax(axis=2, keepdims=True)
    return np.asarray(np.take_along_axis(tables[::-1], best, axis=2)[..., 0].mean(axis=0))


def policy_values(process: tuple[np.ndarray, np.ndarray], actions: np.ndarray, gamma: float) -> np.ndarray:
    """Return the values of post office and letters, (2,), for one action in each."""
    chances, rewards = process
    worth = np.zeros(HOME + 1)
    for _ in range(LONGEST_ROUTE):
        worth[:HOME] = (rewards + gamma * chances @ worth)[np.arange(HOME), actions]
    return worth[:HOME]
