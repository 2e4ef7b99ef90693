"""The compiled engine's trainer: a run's worlds, its learner, and their state as plain arrays."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.environment import make_collector, make_evaluation
from pneuma.engines.loop import begins_fork
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Checkpoint, CheckpointError, Records, Row


class BatchedTrainer:
    """Trains one run by compiled programs; implements `pneuma.engines.loop.Trainer`.

    Attributes:
        collector: the worlds, and the random stream of actions.
        learner: the learner of the policy that all players share.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.collector = make_collector(run)
        self.learner = Learner(run, self.collector.features, self.collector.actions)

    @cached_property
    def _evaluation(self) -> Any:
        return make_evaluation(self.run)

    def update(self, before: int, after: int, records: Records) -> bool:
        """Collect one horizon, and learn from it."""
        rollout = self.collector.collect(self.learner.networks["actor"])
        metrics = self.learner.learn_from(rollout)
        records.metrics.append({"step": after, **metrics})
        records.episodes.extend(self.collector.episode_rows(rollout, before))
        if not self.learner.is_finite(metrics):
            return False
        is_last = after == self.run.updates * self.run.steps_per_update  # else the next update shows it
        return not (is_last and overflows(self.policy(), self.collector.observations))

    def evaluate(self, step: int) -> Row:
        """Evaluate the policy."""
        return self._evaluation.evaluate(self.policy(), step)

    def policy(self) -> Policy:
        """Return the networks as a stored policy."""
        return self.learner.policy()

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        """Copy networks, optimizer, worlds and random streams."""
        arrays = {name: array.copy() for name, array in self.collector.saved_state().items()}
        numbers = {
            "layout": self.collector.layout,
            "optimizer": self.run.optimizer,
            "actions": self.collector.generator.bit_generator.state,
            "minibatches": self.learner.generator.bit_generator.state,
        }
        for part in ("networks", "optimizer"):
            named = _named(getattr(self.learner, part))
            arrays |= {f"{part}/{name}": np.array(array) for name, array in named}
        return Checkpoint(step, arrays, numbers, records.copy())

    def restore(self, checkpoint: Checkpoint) -> None:
        """Resume from a checkpoint; a fork starts from its parent's, with random streams of its own.

        A fork resets what its run says.
        """
        run = self.run
        begins = begins_fork(run, checkpoint)
        self._restore(checkpoint, run.fork_reset if begins else "")
        if begins:
            self.collector.fork()
            self.collector.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
            self.learner.generator = np.random.default_rng(stream_seed(run.stream, "minibatches"))

    def _restore(self, checkpoint: Checkpoint, reset: str) -> None:
        numbers = checkpoint.numbers
        try:
            if numbers["layout"] != self.collector.layout:
                raise ValueError("the state of the worlds was laid out otherwise")
            if numbers["optimizer"] != self.run.optimizer and reset != "optimizer":
                raise ValueError(f"it is of the optimizer {numbers['optimizer']}")
            self.collector.restore_state(checkpoint.arrays)
            self.collector.generator.bit_generator.state = numbers["actions"]
            _restore_learner(self.learner, checkpoint, reset)
        except (KeyError, ValueError, TypeError) as error:
            raise CheckpointError(f"cannot go on from step {checkpoint.step:,}: {error}") from None


def _restore_learner(learner: Learner, checkpoint: Checkpoint, reset: str) -> None:
    fresh = learner.networks
    learner.networks = _filled(learner.networks, "networks/", checkpoint)
    if reset != "optimizer":
        learner.optimizer = _filled(learner.optimizer, "optimizer/", checkpoint)
    if reset == "critic":
        learner.networks = {**learner.networks, "critic": fresh["critic"]}
        zero = initial_state(learner.run.optimizer, fresh)
        for name, moment in learner.optimizer.items():
            if name != "steps":
                part = zero[name]["critic"]  # copied, as an optimizer's moments may begin as one array
                learner.optimizer[name] = {**moment, "critic": _rebuilt(part, "", dict(_named(part)))}
    learner.generator.bit_generator.state = checkpoint.numbers["minibatches"]


def _filled(tree: Any, prefix: str, checkpoint: Checkpoint) -> Any:
    """Return a tree of this structure with the arrays of a checkpoint."""
    arrays = {}
    for name, leaf in _named(tree):
        array = checkpoint.arrays[prefix + name]
        if array.shape != np.shape(leaf):
            raise ValueError(f"{prefix}{name} is of shape {array.shape}, not {np.shape(leaf)}")
        arrays[name] = array
    return _rebuilt(tree, "", arrays)


def _rebuilt(tree: Any, path: str, arrays: dict[str, np.ndarray]) -> Any:
    if isinstance(tree, dict):
        return {key: _rebuilt(value, f"{path}.{key}".lstrip("."), arrays) for key, value in tree.items()}
    if isinstance(tree, tuple):
        return tuple(_rebuilt(value, f"{path}.{i}".lstrip("."), arrays) for i, value in enumerate(tree))
    return np.array(arrays[path])


def _named(tree: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the arrays of a tree of dictionaries and tuples with their paths."""
    if isinstance(tree, dict | tuple):
        items = tree.items() if isinstance(tree, dict) else enumerate(tree)
        for key, value in items:
            yield from _named(value, f"{path}.{key}".lstrip("."))
    else:
        yield path, tree
