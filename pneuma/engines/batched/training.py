"""The compiled engine's trainer: a run's worlds, its learner, and their state as plain arrays."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial, reduce
from operator import add
from typing import Any

import jax
import numpy as np

from pneuma.config import Run, is_gymnasium_id, stream_seed
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.rollout import Collector, GymnasiumCollector
from pneuma.engines.loop import ResumableTrainer, begins_fork
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Checkpoint, Records


class BatchedTrainer(ResumableTrainer):
    """Trains one run by compiled programs; each policy, of all players or of one, has a learner."""

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self.collector = GymnasiumCollector(run) if is_gymnasium_id(run.env) else Collector(run)
        sizes = self.collector.observations.shape[1], self.collector.actions
        self.learners = [Learner(run, *sizes, player) for player in range(run.policies)]

    def update(self, before: int, after: int, records: Records) -> bool:
        rollout = self.collector.collect(self._joined().actor)
        records.episodes.extend(self.collector.episode_rows(rollout, before))
        left, several = 1 - after / self.run.steps, len(self.learners)
        parts = [rollout.of_player(player, several) for player in range(several)]
        metrics = [learner.learn_from(part, left) for learner, part in zip(self.learners, parts, strict=True)]
        means = {  # not by `sum`, which rounds differently from Python 3.12 on
            name: reduce(add, (own[name] for own in metrics)) / several for name in metrics[0]
        }
        records.metrics.append({"step": after, **means})
        if not all(learner.is_finite(own) for learner, own in zip(self.learners, metrics, strict=True)):
            return False
        is_last = after == self.run.updates * self.run.steps_per_update  # else the next update shows it
        return not (is_last and overflows(self._joined(), self.collector.observations))

    def policy(self) -> Policy:
        return replace(self._joined(), scaling=self.collector.scaling)

    def _joined(self) -> Policy:
        """Return the policy that all share; or the players' own, as one."""
        policies = [learner.policy() for learner in self.learners]
        if len(policies) == 1:
            return policies[0]
        actor, critic = (
            jax.tree.map(lambda *own: np.stack(own), *part)
            for part in zip(*((policy.actor, policy.critic) for policy in policies), strict=True)
        )
        return Policy(self.run.activation, actor, critic)

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        arrays = {name: array.copy() for name, array in self.collector.saved_state().items()}
        numbers = {
            "layout": self.collector.layout,
            "optimizer": self.run.optimizer,
            "actions": self.collector.generator.bit_generator.state,
            "minibatches": [learner.generator.bit_generator.state for learner in self.learners],
        }
        for player, learner in enumerate(self.learners):
            for part in ("networks", "optimizer"):
                leaves = jax.tree.leaves_with_path(getattr(learner, part))
                arrays |= {_array_name(player, part, path): np.array(leaf) for path, leaf in leaves}
        return Checkpoint(step, arrays, numbers, records.copy())

    def restore(self, checkpoint: Checkpoint) -> None:
        """Resume from a checkpoint; a fork starts from its parent's, with random streams of its own.

        A fork resets what its run says.
        """
        run, numbers = self.run, checkpoint.numbers
        begins = begins_fork(run, checkpoint)
        reset = run.fork_reset if begins else ""
        if numbers["layout"] != self.collector.layout:
            raise ValueError("the state of the worlds was laid out otherwise")
        if numbers["optimizer"] != run.optimizer and reset != "optimizer":
            raise ValueError(f"it is of the optimizer {numbers['optimizer']}")
        self.collector.restore_state(checkpoint.arrays)
        self.collector.generator.bit_generator.state = numbers["actions"]
        for player, learner in enumerate(self.learners):
            _restore_learner(learner, player, checkpoint, reset)
        if begins:
            self.collector.fork()
            self.collector.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
            for player, learner in enumerate(self.learners):
                learner.generator = learner.fresh_order(player)


def _restore_learner(learner: Learner, player: int, checkpoint: Checkpoint, reset: str) -> None:
    """Take over everything but what a fork resets: the optimizer, or the critic with its moments."""

    def restored(part: str) -> Any:
        return jax.tree.map_with_path(partial(saved, part), getattr(learner, part))

    def saved(part: str, path: Any, fresh: Any) -> np.ndarray:
        name = _array_name(player, part, path)
        if reset and reset in re.split(r"[/.]", name):
            return np.array(fresh)  # a copy, as an optimizer's moments may begin as one array
        array = checkpoint.arrays[name]
        if array.shape != np.shape(fresh):
            raise ValueError(f"{name} is of shape {array.shape}, not {np.shape(fresh)}")
        return np.array(array)

    learner.networks, learner.optimizer = restored("networks"), restored("optimizer")
    learner.generator.bit_generator.state = checkpoint.numbers["minibatches"][player]


def _array_name(player: int, part: str, path: Any) -> str:
    """Return the name of an array in a checkpoint: networks/actor.0.1, player-2/optimizer/mean.critic.1.0."""
    whose = f"player-{player}/" if player else ""
    return f"{whose}{part}/{jax.tree_util.keystr(path, simple=True, separator='.')}"
