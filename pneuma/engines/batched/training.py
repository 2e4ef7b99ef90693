"""The compiled engine's trainer: a run's worlds, its learner, and their state as plain arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pneuma.config import Run, is_gymnasium_id
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.rollout import Collector, GymnasiumCollector
from pneuma.engines.loop import ResumableTrainer
from pneuma.engines.mlp import Layers, Network
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Checkpoint, Records
from pneuma.engines.stopping import IsStopping, never


class BatchedTrainer(ResumableTrainer):
    """Trains one run by compiled programs. One learner serves all players, or each player has its own."""

    def __init__(self, run: Run, is_stopping: IsStopping = never) -> None:
        super().__init__(run, is_stopping)
        self.collector = GymnasiumCollector(run) if is_gymnasium_id(run.env) else Collector(run)
        features, actions = self.collector.slots.observations.shape[1], self.collector.actions
        self.learners = [Learner(run, features, actions, player) for player in range(run.policies)]

    def update(self, before: int, after: int, records: Records) -> bool:
        rollout = self.collector.collect(self.actor)
        records.episodes.extend(self.collector.episode_rows(rollout, before))
        budget_left = 1 - after / self.run.trained_steps
        all_metrics = []
        for player, learner in enumerate(self.learners):
            player_rollout = rollout.of_player(player, len(self.learners))
            all_metrics.append(learner.learn_from(player_rollout, budget_left))
        records.metrics.append({"step": after, **_means(all_metrics)})
        for learner, metrics in zip(self.learners, all_metrics, strict=True):
            if not learner.is_finite(metrics):
                return False
        # earlier, the next update's losses show that logits overflow
        is_last = after == self.run.trained_steps
        return not (is_last and overflows(self._joint_policy(), self.collector.slots.observations))

    def policy(self) -> Policy:
        return replace(self._joint_policy(), scaling=self.collector.slots.scaling)

    @property
    def actor(self) -> Network:
        """Return the actor that all players share, or the players' actors, without copying a single one."""
        actors = [learner.actor for learner in self.learners]
        if len(actors) == 1:
            return actors[0]
        return actors[0]._replace(weights=np.concatenate([actor.weights for actor in actors]))

    def _joint_policy(self) -> Policy:
        """Return the policy that all share, or the players' policies as one."""
        policies = [learner.policy() for learner in self.learners]
        if len(policies) == 1:
            return policies[0]
        actor = _stack([policy.actor for policy in policies])
        critic = _stack([policy.critic for policy in policies])
        return Policy(self.run.activation, actor, critic)

    def training_xp(self) -> np.ndarray:
        xp: np.ndarray = self.collector.slots.worlds.players["xp"]
        return xp

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        worlds = self.collector.slots.saved_state()
        arrays = {f"worlds/{name}": array for name, array in worlds.items()}
        numbers = {
            "actions": self.collector.generator.bit_generator.state,
            "minibatches": [learner.generator.bit_generator.state for learner in self.learners],
        }
        for player, learner in enumerate(self.learners):
            for name, array in learner.saved_state().items():
                arrays[f"learner-{player}/{name}"] = array
        return Checkpoint(step, arrays, numbers, records.copy())

    def restore(self, checkpoint: Checkpoint) -> None:
        numbers = checkpoint.numbers
        self.collector.slots.restore_state(checkpoint.part("worlds/"))
        self.collector.generator.bit_generator.state = numbers["actions"]
        for player, learner in enumerate(self.learners):
            learner.restore_state(checkpoint.part(f"learner-{player}/"))
            learner.generator.bit_generator.state = numbers["minibatches"][player]


def _means(all_metrics: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Return the mean of each metric, without `sum`, which rounds differently from Python 3.12 on."""
    totals = dict(all_metrics[0])
    for metrics in all_metrics[1:]:
        for metric, number in metrics.items():
            totals[metric] += number
    return {metric: total / len(all_metrics) for metric, total in totals.items()}


def _stack(networks: Sequence[Layers]) -> Layers:
    """Return the networks of several players as one, with a first axis of players."""
    layers = []
    for same_layers in zip(*networks, strict=True):
        weights, biases = zip(*same_layers, strict=True)
        layers.append((np.stack(weights), np.stack(biases)))
    return tuple(layers)
