"""The compiled engine's trainer: a run's worlds, its learner, and their state as plain arrays."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np

from pneuma.config import Run, is_gymnasium_id, stream_seed
from pneuma.engines.batched.gymnasium_rollout import GymnasiumCollector
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.rollout import Collector
from pneuma.engines.loop import Trainer, begins_fork
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Checkpoint, Records


class BatchedTrainer(Trainer):
    """Trains one run by compiled programs.

    Attributes:
        collector: the worlds, and the random stream of actions.
        learner: the learner of the policy that all players share.
    """

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        self.collector: Collector | GymnasiumCollector = (
            GymnasiumCollector(run) if is_gymnasium_id(run.env) else Collector(run)
        )
        self.learner = Learner(run, self.collector.features, self.collector.actions)

    def update(self, before: int, after: int, records: Records) -> bool:
        rollout = self.collector.collect(self.learner.networks["actor"])
        metrics = self.learner.learn_from(rollout, left=1 - after / self.run.steps)
        records.metrics.append({"step": after, **metrics})
        records.episodes.extend(self.collector.episode_rows(rollout, before))
        if not self.learner.is_finite(metrics):
            return False
        is_last = after == self.run.updates * self.run.steps_per_update  # else the next update shows it
        return not (is_last and overflows(self.learner.policy(), self.collector.observations))

    def policy(self) -> Policy:
        return replace(self.learner.policy(), scaling=self.collector.scaling)

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        arrays = {name: array.copy() for name, array in self.collector.saved_state().items()}
        numbers = {
            "layout": self.collector.layout,
            "optimizer": self.run.optimizer,
            "actions": self.collector.generator.bit_generator.state,
            "minibatches": self.learner.generator.bit_generator.state,
        }
        for part in ("networks", "optimizer"):
            leaves = jax.tree.leaves_with_path(getattr(self.learner, part))
            arrays |= {_array_name(part, path): np.array(leaf) for path, leaf in leaves}
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
        _restore_learner(self.learner, checkpoint, reset)
        if begins:
            self.collector.fork()
            self.collector.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
            self.learner.generator = np.random.default_rng(stream_seed(run.stream, "minibatches"))


def _restore_learner(learner: Learner, checkpoint: Checkpoint, reset: str) -> None:
    """Take over everything but what a fork resets: the optimizer, or the critic with its moments."""

    def restored(part: str) -> Any:
        return jax.tree.map_with_path(partial(saved, part), getattr(learner, part))

    def saved(part: str, path: Any, fresh: Any) -> np.ndarray:
        name = _array_name(part, path)
        if reset and reset in re.split(r"[/.]", name):
            return np.array(fresh)  # a copy, as an optimizer's moments may begin as one array
        array = checkpoint.arrays[name]
        if array.shape != np.shape(fresh):
            raise ValueError(f"{name} is of shape {array.shape}, not {np.shape(fresh)}")
        return np.array(array)

    learner.networks, learner.optimizer = restored("networks"), restored("optimizer")
    learner.generator.bit_generator.state = checkpoint.numbers["minibatches"]


def _array_name(part: str, path: Any) -> str:
    """Return the name of an array in a checkpoint: networks/actor.0.1, optimizer/mean.critic.1.0."""
    return f"{part}/{jax.tree_util.keystr(path, simple=True, separator='.')}"
