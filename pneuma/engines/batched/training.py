"""A run between two updates: its worlds, and who learns in them."""

from __future__ import annotations

from typing import Any

import numpy as np

from pneuma.config import Run
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.rollout import Collector, episode_rows
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Row
from pneuma.engines.team import Team


class Training:
    """The worlds of a run, and its learners: one of all players, or one for each.

    Attributes:
        collector: the worlds and the actions' stream.
        learners: one; or the players', in their order, where they learn independently.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.collector = Collector(run)
        features = self.collector.worlds.observations.shape[2]
        actions = int(self.collector.worlds.action_space.n)
        self.learners = [Learner(run, features, actions, player) for player in range(run.policies)]

    def policy(self) -> Policy | Team:
        """Return the policy, or the players'."""
        policies = tuple(learner.policy() for learner in self.learners)
        return policies[0] if len(policies) == 1 else Team(policies)

    def update(self, first_step: int) -> tuple[list[dict[str, float]], list[dict[str, Any]]]:
        """Collect one horizon and learn from it; return every learner's metrics and the episodes that ended.

        Args:
            first_step: agent steps taken before.
        """
        count = len(self.learners)
        rollout = self.collector.collect([learner.networks["actor"] for learner in self.learners])
        told = [
            learner.learn_from(rollout.of_player(player, count))
            for player, learner in enumerate(self.learners)
        ]
        return told, episode_rows(rollout, first_step, self.run.slots * self.run.players)

    def is_finite(self, told: list[dict[str, float]]) -> bool:
        """Tell whether every learner's losses, gradient norms and parameters are finite."""
        return all(learner.is_finite(own) for learner, own in zip(self.learners, told, strict=True))

    def overflows(self) -> bool:
        """Tell whether some learner's logits of what its players see are no numbers, as of huge weights."""
        seen, count = self.collector.worlds.observations, len(self.learners)  # seen: (N, players, features)
        return any(
            overflows(learner.policy(), seen[:, player::count].reshape(-1, seen.shape[2]))
            for player, learner in enumerate(self.learners)
        )


def mean_metrics(told: list[dict[str, float]]) -> dict[str, float]:
    """Return the means of learners' metrics over the learners."""
    if len(told) == 1:
        return told[0]
    return {name: float(np.mean([own[name] for own in told])) for name in told[0]}


def learner_rows(step: int, told: list[dict[str, float]]) -> list[Row]:
    """Return a row for each learner of an update; none where there is one alone."""
    if len(told) == 1:
        return []
    return [{"step": step, "learner": player, **own} for player, own in enumerate(told)]
