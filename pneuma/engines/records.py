"""Records of a run in training: rows of episodes, updates and evaluations; and checkpoints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pneuma.config import Run, is_gymnasium_id
from pneuma.env.fields import ACTION_NAMES

POLICY_FILE = "policy.safetensors"
"""The file of a `Policy` in its run's folder."""
EPISODE_COLUMNS = ("slot", "episode", "step", "return", "length", "kills", "hp", "ending")
METRIC_COLUMNS = (
    "step", "policy_loss", "value_loss", "entropy", "approx_kl", "clip_fraction", "grad_norm",
    "grad_norm_actor", "grad_norm_critic", "explained_variance", "dead_units",
    *(f"action_{i}" for i in range(len(ACTION_NAMES))),
)  # fmt: skip
EVALUATION_COLUMNS = (
    "step", "episodes", "share_killed", "score", "return", "length", "died", "argmax_starts",
    "argmax_share_killed", "argmax_score", "argmax_return", "random_share_killed",
)  # fmt: skip
WORLD_COLUMNS = (
    "share_killed", "score", "died", "argmax_share_killed", "argmax_score", "random_share_killed",
)  # fmt: skip
"""Columns of evaluations in Pneuma's worlds alone."""
VALUE_COLUMNS = (
    "q_estimate", "q_true", "success", "random_return", "random_spread", "steps_to_clear", "hp_lost",
    "commonest_action", "kill_evenness",
)  # fmt: skip
"""Additional columns of some evaluations.

- q_estimate, q_true: where values of actions are learned
- success, random_return, random_spread: in environments that are not Pneuma's, the share of successful
  episodes, if `info` reports success, and mean and standard deviation of a random player's returns
- steps_to_clear, hp_lost, commonest_action, kill_evenness: in Pneuma's worlds, the steps until no monster is
  left, the HP that a player loses in an episode, the most frequent action's share of steps, and how evenly
  several players share the kills; older runs lack these four
"""

Row = Mapping[str, Any]
Numbers = Sequence[float] | np.ndarray
NAN = math.nan


def episode_row(
    slot: int, episode: int, step: int, returned: float, length: int, ending: str
) -> dict[str, Any]:
    """Return the row of an episode where there are no monsters."""
    return {
        "slot": slot, "episode": episode, "step": step, "return": returned, "length": length, "kills": NAN,
        "hp": NAN, "ending": ending,
    }  # fmt: skip


def metrics_row(step: int, metrics: Row) -> dict[str, Any]:
    return {**dict.fromkeys(METRIC_COLUMNS, NAN), "step": step, **metrics}


def has_finite_losses(metrics: Row) -> bool:
    """Return whether an update's losses and gradient norm are finite, of those that its learner has.

    The explained variance is left out, because it is undefined if all returns are equal.
    """
    watched_metrics = metrics.keys() & {"policy_loss", "value_loss", "entropy", "grad_norm"}
    return all(math.isfinite(metrics[metric]) for metric in watched_metrics)


def evaluation_row(
    step: int, returns: Numbers, lengths: Numbers, best_returns: Numbers, extra_columns: Row
) -> dict[str, Any]:
    """Return the evaluation of a policy where there are no monsters.

    It is of returns and lengths of episodes, and of returns of episodes with the best actions.
    """
    return {
        **dict.fromkeys(EVALUATION_COLUMNS, NAN),
        "step": step,
        "episodes": len(returns),
        "return": float(np.mean(returns)),
        "length": float(np.mean(lengths)),
        "argmax_starts": len(best_returns),
        "argmax_return": float(np.mean(best_returns)),
        **extra_columns,
    }


def action_shares(run: Run, actions: np.ndarray, action_count: int) -> dict[str, float]:
    """Return the share of each action, as columns of the metrics.

    In other environments with more actions than columns, these are the most frequent ones.
    """
    column_count = len(ACTION_NAMES)
    shares = np.bincount(actions.ravel(), minlength=max(action_count, column_count)) / actions.size
    if is_gymnasium_id(run.env) and len(shares) > column_count:
        shares = np.sort(shares)[::-1][:column_count]
    return {f"action_{i}": float(share) for i, share in enumerate(shares)}


@dataclass
class Records:
    """The records of a run: rows of `EPISODE_`, `METRIC_` and `EVALUATION_COLUMNS`, in order.

    Evaluations may also have some of `VALUE_COLUMNS`.
    """

    episodes: list[Row] = field(default_factory=list)
    metrics: list[Row] = field(default_factory=list)
    evaluations: list[Row] = field(default_factory=list)

    def copy(self) -> Records:
        return Records(list(self.episodes), list(self.metrics), list(self.evaluations))


# --- Checkpoints -----------------------------------------------------------------------------------


class CheckpointError(ValueError):
    """A checkpoint from which an engine cannot resume."""


@dataclass(frozen=True)
class Checkpoint:
    """A run's complete state after an update, from which its engine resumes with the same bits.

    `arrays` contain learner, optimizer, random generators and worlds, and `numbers` all else, as JSON.
    """

    step: int
    arrays: Mapping[str, np.ndarray]
    numbers: Mapping[str, Any] = field(default_factory=dict)
    records: Records = field(default_factory=Records)

    def part(self, prefix: str) -> dict[str, np.ndarray]:
        """Return the arrays whose names begin with a prefix, without the prefix."""
        matching_arrays = {}
        for array_name, array in self.arrays.items():
            if array_name.startswith(prefix):
                matching_arrays[array_name.removeprefix(prefix)] = array
        return matching_arrays
