"""Evaluation of tables on `pneuma/Mailman-v0`: played as any policy is, and beside what can be computed.

There are no monsters there: the return is the primary outcome. As the whole process is known, values
have no sampling error of their own: the true ones, and the best, are computed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.records import EVALUATION_COLUMNS
from pneuma.env.mailman import HOME, POST_OFFICE, MailmanEnv, decision_process

LONGEST_ROUTE = 2


class TableEvaluation:
    """Judges the tables of one run; made once, asked at every evaluation point."""

    def __init__(self, run: Run) -> None:
        assert run.action_slip is not None and run.reward_noise is not None
        self.run = run
        self.env = MailmanEnv(run.action_slip, run.reward_noise)
        self.process = decision_process(run.action_slip)
        self.best = optimal_values(self.process, run.gamma)

    def evaluate(self, tables: np.ndarray, step: int) -> dict[str, Any]:
        """Return one row: returns and lengths as played, explored as at training's end; values as computed.

        `argmax_return` is what the greedy route earns on average. `q_estimate` and `q_true` are means over
        post office and letters, the latter of the greedy route's discounted value; `q_error` is the
        greatest distance of any entry from the best route's.

        Args:
            tables: (1 or 2, places, actions).
            step: agent steps trained.
        """
        mean = tables.mean(axis=0)
        greedy = mean.argmax(axis=1)[:HOME]
        returns, lengths = self._play(mean, step)
        true = policy_values(self.process, greedy, self.run.gamma)
        return {
            **dict.fromkeys(EVALUATION_COLUMNS, float("nan")),
            "step": step,
            "episodes": self.run.evaluation_episodes,
            "return": float(np.mean(returns)),
            "length": float(np.mean(lengths)),
            "argmax_starts": 1,
            "argmax_return": float(policy_values(self.process, greedy, 1.0)[POST_OFFICE]),
            "q_estimate": float(estimated_values(tables)[:HOME].mean()),
            "q_true": float(true.mean()),
            "q_error": float(np.abs(mean[:HOME] - self.best).max()),
        }

    def _play(self, values: np.ndarray, step: int) -> tuple[list[float], list[int]]:
        """Return every episode's return and length."""
        generator = np.random.default_rng(stream_seed(self.run.stream, "evaluation-actions", step))
        self.env.reset(seed=stream_seed(self.run.stream, "evaluation"))
        played = [self._play_one(values, generator) for _ in range(self.run.evaluation_episodes)]
        returns, lengths = zip(*played, strict=True)
        return list(returns), list(lengths)

    def _play_one(self, values: np.ndarray, generator: np.random.Generator) -> tuple[float, int]:
        place, total, length, ended = self.env.reset()[0], 0.0, 0, False
        while not ended:
            explore = generator.random() < (self.run.exploration or 0.0)
            action = generator.integers(values.shape[1]) if explore else values[place].argmax()
            place, reward, ended, _, _ = self.env.step(np.int64(action))
            total, length = total + reward, length + 1
        return total, length


def estimated_values(tables: np.ndarray) -> np.ndarray:
    """Return what tables hold a place to be worth, (places,): of Q-learning the greatest entry.

    Of double Q-learning, what one table says of the other's best action, the mean of both (Eq. 3.9): the
    estimate that it learns from.
    """
    count = len(tables)
    rated = [
        np.take_along_axis(tables[count - 1 - i], tables[i].argmax(axis=1)[:, None], axis=1)[:, 0]
        for i in range(count)
    ]
    return np.asarray(np.mean(rated, axis=0))


def optimal_values(process: tuple[np.ndarray, np.ndarray], gamma: float) -> np.ndarray:
    """Return the best route's values of actions, (post office and letters, actions)."""
    chances, rewards = process
    values, worth = rewards, np.zeros(HOME + 1)
    for _ in range(LONGEST_ROUTE):
        values = rewards + gamma * chances @ worth
        worth[:HOME] = values.max(axis=1)
    return values


def policy_values(process: tuple[np.ndarray, np.ndarray], actions: np.ndarray, gamma: float) -> np.ndarray:
    """Return what post office and letters are worth, (2,), by one action in each."""
    chances, rewards = process
    worth = np.zeros(HOME + 1)
    for _ in range(LONGEST_ROUTE):
        worth[:HOME] = (rewards + gamma * chances @ worth)[np.arange(HOME), actions]
    return worth[:HOME]
