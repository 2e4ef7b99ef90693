"""Q-learning and double Q-learning in tables, on the mailman's day of the thesis's Fig. 2.1.

    python studies/scripts/tabular.py [FILE]      writes the table (default: paper_figures/tables/tabular.md)

"For deterministic environments, the ideal value is alpha = 1" (section 3.1): three learning rates on a day of
which route and values are known. "The problem actually occurred due to the imprecision of the action-values,
regardless of the source" (section 3.3): under noise on the rewards, Q-learning and double Q-learning. From
the letters both actions pay the same, so that the greater of two imprecise values is too great.
"""

from __future__ import annotations

import hashlib
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

POST_OFFICE, LETTERS, HOME = 0, 1, 2
"""The three places: every day begins at the post office and ends at home."""
GO_ON, GO_HOME = 0, 1
PLACES, ACTIONS = 3, 2

SEEDS = 50
STEPS = 5_000
LAST_STEPS = 250
"""The steps at the end over which returns are averaged."""
GAMMA = 0.99
EXPLORATION = 0.1
"""The probability of a random action."""

FILE = Path(__file__).parents[2] / "paper_figures" / "tables" / "tabular.md"


@dataclass(frozen=True)
class Condition:
    """One setting of the learner.

    Attributes:
        learning_rate: the step size alpha.
        reward_noise: the standard deviation of normal noise on every reward.
        tables: 1 for Q-learning, 2 for double Q-learning.
    """

    learning_rate: float
    reward_noise: float = 0.0
    tables: int = 1


CONDITIONS = {
    "rate-1": Condition(1.0),
    "rate-half": Condition(0.5),
    "rate-tenth": Condition(0.1),
    "noisy-rate-1": Condition(1.0, reward_noise=1.0),
    "noisy-rate-half": Condition(0.5, reward_noise=1.0),
    "noisy-rate-tenth": Condition(0.1, reward_noise=1.0),
    "noisy-double-rate-1": Condition(1.0, reward_noise=1.0, tables=2),
    "noisy-double-rate-half": Condition(0.5, reward_noise=1.0, tables=2),
    "noisy-double-rate-tenth": Condition(0.1, reward_noise=1.0, tables=2),
}


def random_stream(seed: int, purpose: str) -> np.random.Generator:
    """Return the generator of a seed for one purpose, as Pneuma's engines derive theirs."""
    digest = hashlib.sha256(f"{seed}/{purpose}/0".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:8], "little"))


def go(place: int, action: int) -> tuple[int, float]:
    """Return the next place and the reward: 1 for delivering the letters, -1 for going home without them."""
    if place == LETTERS:
        return HOME, 1.0
    if action == GO_ON:
        return LETTERS, 0.0
    return HOME, -1.0


def temporal_difference(
    tables: np.ndarray, updated: int, place: int, action: int, reward: float, next_place: int, gamma: float
) -> float:
    """Return the temporal-difference error of a step (thesis Eq. 3.2; with two tables Eq. 3.9).

    The updated table chooses the next action, and the other one values it. A single table does both.

    Args:
        tables: (1 or 2, places, actions) values.
        updated: the table that learns from the step.
        place: where the step began.
        action: the action taken.
        reward: the reward received.
        next_place: where the step ended; nothing follows at home.
        gamma: the discount factor.
    """
    next_value = 0.0
    if next_place != HOME:
        best_action = tables[updated, next_place].argmax()
        valuing = len(tables) - 1 - updated
        next_value = float(tables[valuing, next_place, best_action])
    return reward + gamma * next_value - float(tables[updated, place, action])


def estimated_value(tables: np.ndarray, place: int) -> float:
    """Return the tables' estimate of a place: one table's value of the action that the other ranks best."""
    estimates = []
    for choosing in range(len(tables)):
        best_action = tables[choosing, place].argmax()
        valuing = len(tables) - 1 - choosing
        estimates.append(float(tables[valuing, place, best_action]))
    return float(np.mean(estimates))


def train(
    condition: Condition, seed: int, steps: int = STEPS, exploration: float = EXPLORATION
) -> tuple[float, float]:
    """Train one run.

    Returns:
        The mean return of the days that ended in the last 250 steps, and by how much the value of the letters
        was overestimated on average in the second half. Their true value is 1.
    """
    action_stream = random_stream(seed, "actions")
    reward_stream = random_stream(seed, "world")
    tables = np.zeros((condition.tables, PLACES, ACTIONS))
    letters_values = np.zeros(steps)
    last_returns = []
    place, day_return = POST_OFFICE, 0.0
    for step in range(steps):
        if action_stream.random() < exploration:
            action = int(action_stream.integers(ACTIONS))
        else:
            values = tables[:, place].mean(axis=0)
            action = int(action_stream.choice(np.flatnonzero(values == values.max())))
        next_place, reward = go(place, action)
        if condition.reward_noise:
            reward += float(reward_stream.normal(0.0, condition.reward_noise))
        updated = int(action_stream.integers(condition.tables))
        error = temporal_difference(tables, updated, place, action, reward, next_place, GAMMA)
        tables[updated, place, action] += condition.learning_rate * error
        letters_values[step] = estimated_value(tables, LETTERS)
        day_return += reward
        place = next_place
        if place == HOME:
            if step >= steps - LAST_STEPS:
                last_returns.append(day_return)
            place, day_return = POST_OFFICE, 0.0
    return float(np.mean(last_returns)), float(letters_values[steps // 2 :].mean()) - 1.0


def mean_with_interval(values: np.ndarray) -> str:
    """Return a mean with Student's 95 % interval as text."""
    mean = values.mean()
    half_width = stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    return f"{mean:.3f} [{mean - half_width:.3f}, {mean + half_width:.3f}]".replace("-0.000", "0.000")


def make_table(seeds: int = SEEDS) -> str:
    """Train every condition with seeds from 0 on; return their results as a Markdown table."""
    lines = [
        "| condition | runs | return at the end of training | overestimation of the letters |",
        "| --- | --- | --- | --- |",
    ]
    for name, condition in CONDITIONS.items():
        runs = [train(condition, seed) for seed in range(seeds)]
        returns, overestimations = np.array(runs).T
        cells = [name, str(seeds), mean_with_interval(returns), mean_with_interval(overestimations)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else FILE
    file.write_text(make_table(), encoding="utf-8")
    print(f"wrote {file}")
