"""The trainer of the compiled engine: a run's worlds, who learns in them, and their state as plain arrays."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.batched.rollout import Collector, episode_rows
from pneuma.engines.checkpoint import Checkpoint, CheckpointError
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.loop import begins_fork
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Records, Row
from pneuma.engines.team import Team
from pneuma.env.state import LAYOUT_DIGEST

_WORLDS = ("worlds", "players", "monsters")
_EPISODES = ("returns", "lengths", "episodes", "begins")


class BatchedTrainer:
    """Trains one run by compiled programs; see `pneuma.engines.loop.Trainer`.

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

    @cached_property
    def _evaluation(self) -> Evaluation:
        return Evaluation(self.run)

    def update(self, before: int, after: int, records: Records) -> bool:
        """Collect one horizon, and learn from it."""
        count = len(self.learners)
        rollout = self.collector.collect([learner.networks["actor"] for learner in self.learners])
        told = [
            learner.learn_from(rollout.of_player(player, count))
            for player, learner in enumerate(self.learners)
        ]
        records.metrics.append({"step": after, **mean_metrics(told)})
        if count > 1:
            records.learners.extend(
                {"step": after, "learner": player, **own} for player, own in enumerate(told)
            )
        records.episodes.extend(episode_rows(rollout, before, self.run.slots * self.run.players))
        if not all(learner.is_finite(own) for learner, own in zip(self.learners, told, strict=True)):
            return False
        is_last = after == self.run.updates * self.run.steps_per_update  # what overflows shows in the next
        return not (is_last and self._overflows())

    def _overflows(self) -> bool:
        """Tell whether some learner's logits of what its players see are no numbers, as of huge weights."""
        seen, count = self.collector.worlds.observations, len(self.learners)  # seen: (N, players, features)
        return any(
            overflows(learner.policy(), seen[:, player::count].reshape(-1, seen.shape[2]))
            for player, learner in enumerate(self.learners)
        )

    def evaluate(self, step: int) -> Row:
        """Let the policy play where it was not trained."""
        return self._evaluation.evaluate(self.policy(), step)

    def policy(self) -> Policy | Team:
        """Return the policy, or the players'."""
        policies = tuple(learner.policy() for learner in self.learners)
        return policies[0] if len(policies) == 1 else Team(policies)

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        """Copy networks, optimizer, worlds and random streams."""
        arrays = {name: own.copy() for name, own in _collected(self.collector)}
        numbers = {
            "layout": LAYOUT_DIGEST,
            "optimizer": self.run.optimizer,
            "actions": self.collector.generator.bit_generator.state,
        }
        for player, learner in enumerate(self.learners):
            place = _place(player)
            arrays |= {f"{place}networks/{name}": np.array(own) for name, own in _named(learner.networks)}
            arrays |= {f"{place}optimizer/{name}": np.array(own) for name, own in _named(learner.optimizer)}
            numbers[f"{place}minibatches"] = learner.generator.bit_generator.state
        return Checkpoint(step, arrays, numbers, records.copy())

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint; as a fork of a parent's, with random streams of its own.

        A fork begins anew with what it is to reset.
        """
        run = self.run
        begins = begins_fork(run, checkpoint)
        self._restore(checkpoint, run.fork_reset if begins else "")
        if begins:
            worlds = self.collector.worlds
            worlds.rekey([stream_seed(run.stream, "world", slot) for slot in range(run.slots)])
            if run.fork_reset == "xp":
                worlds.players["xp"] = 0.0
                worlds.observe()
            self.collector.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
            for player, learner in enumerate(self.learners):
                learner.generator = np.random.default_rng(stream_seed(run.stream, "minibatches", player))

    def _restore(self, checkpoint: Checkpoint, reset: str) -> None:
        numbers = checkpoint.numbers
        try:
            if numbers["layout"] != LAYOUT_DIGEST:
                raise ValueError("the state of the worlds was laid out otherwise")
            if numbers["optimizer"] != self.run.optimizer and reset != "optimizer":
                raise ValueError(f"it is of the optimizer {numbers['optimizer']}")
            _restore_worlds(self.collector, checkpoint)
            self.collector.generator.bit_generator.state = numbers["actions"]
            for player, learner in enumerate(self.learners):
                _restore_learner(learner, checkpoint, _place(player), reset)
        except (KeyError, ValueError, TypeError) as error:
            raise CheckpointError(f"cannot go on from step {checkpoint.step:,}: {error}") from None


def mean_metrics(told: list[dict[str, float]]) -> dict[str, float]:
    """Return the means of learners' metrics over the learners."""
    if len(told) == 1:
        return told[0]
    return {name: float(np.mean([own[name] for own in told])) for name in told[0]}


def _place(player: int) -> str:
    """Return how the names of what belongs to a learner begin."""
    return f"player-{player}/" if player else ""


def _collected(collector: Collector) -> list[tuple[str, np.ndarray]]:
    """Return the arrays of worlds and episodes by name; nobody idles in worlds of one player."""
    idle = ("idle",) if collector.worlds.players.shape[1] > 1 else ()
    return [
        *((f"worlds/{name}", _bytes(getattr(collector.worlds, name))) for name in _WORLDS),
        *((f"episodes/{name}", getattr(collector, name)) for name in (*_EPISODES, *idle)),
    ]


def _restore_worlds(collector: Collector, checkpoint: Checkpoint) -> None:
    for name, own in _collected(collector):
        if own.shape != checkpoint.arrays[name].shape:
            raise ValueError(f"{name} is of shape {checkpoint.arrays[name].shape}, not {own.shape}")
        own[:] = checkpoint.arrays[name]
    collector.worlds.observe()


def _restore_learner(learner: Learner, checkpoint: Checkpoint, place: str, reset: str) -> None:
    fresh = learner.networks
    learner.networks = _filled(learner.networks, f"{place}networks/", checkpoint)
    if reset != "optimizer":
        learner.optimizer = _filled(learner.optimizer, f"{place}optimizer/", checkpoint)
    if reset == "critic":
        learner.networks = {**learner.networks, "critic": fresh["critic"]}
        zero = initial_state(learner.run.optimizer, fresh)
        for name, moment in learner.optimizer.items():
            if name != "steps":
                part = zero[name]["critic"]  # copied, as an optimizer's moments may begin as one array
                learner.optimizer[name] = {**moment, "critic": _rebuilt(part, "", dict(_named(part)))}
    learner.generator.bit_generator.state = checkpoint.numbers[f"{place}minibatches"]


def _filled(tree: Any, prefix: str, checkpoint: Checkpoint) -> Any:
    """Return a tree like this one with the arrays of a checkpoint."""
    arrays = {}
    for name, own in _named(tree):
        array = checkpoint.arrays[prefix + name]
        if array.shape != np.shape(own):
            raise ValueError(f"{prefix}{name} is of shape {array.shape}, not {np.shape(own)}")
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


def _bytes(array: np.ndarray) -> np.ndarray:
    """Return an array's memory, (bytes,) uint8."""
    return array.reshape(-1).view(np.uint8)
