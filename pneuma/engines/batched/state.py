"""The whole state of a training between two updates, as plain arrays, and back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pneuma.config import stream_seed
from pneuma.engines.batched.learner import Learner
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.batched.rollout import Collector
from pneuma.engines.batched.training import Training
from pneuma.engines.checkpoint import Checkpoint, CheckpointError
from pneuma.engines.records import Records
from pneuma.env.state import LAYOUT_DIGEST

_WORLDS = ("worlds", "players", "monsters")
_EPISODES = ("returns", "lengths", "episodes", "begins")


def take_checkpoint(training: Training, step: int, records: Records) -> Checkpoint:
    """Copy all that the next update depends on."""
    collector = training.collector
    arrays = {name: own.copy() for name, own in _collected(collector)}
    numbers = {
        "layout": LAYOUT_DIGEST,
        "optimizer": training.run.optimizer,
        "actions": collector.generator.bit_generator.state,
    }
    for player, learner in enumerate(training.learners):
        place = _place(player)
        arrays |= {f"{place}networks/{name}": np.array(own) for name, own in _named(learner.networks)}
        arrays |= {f"{place}optimizer/{name}": np.array(own) for name, own in _named(learner.optimizer)}
        numbers[f"{place}minibatches"] = learner.generator.bit_generator.state
    return Checkpoint(step, arrays, numbers, records.copy())


def restore_checkpoint(training: Training, checkpoint: Checkpoint, reset: str = "") -> None:
    """Put a training where a checkpoint was taken, but for what `reset` names: it stays as it begins.

    Raises:
        CheckpointError: for one that does not fit.
    """
    numbers = checkpoint.numbers
    try:
        if numbers["layout"] != LAYOUT_DIGEST:
            raise ValueError("the state of the worlds was laid out otherwise")
        if numbers["optimizer"] != training.run.optimizer and reset != "optimizer":
            raise ValueError(f"it is of the optimizer {numbers['optimizer']}")
        _restore_worlds(training.collector, checkpoint)
        training.collector.generator.bit_generator.state = numbers["actions"]
        for player, learner in enumerate(training.learners):
            _restore_learner(learner, checkpoint, _place(player), reset)
    except (KeyError, ValueError, TypeError) as error:
        raise CheckpointError(f"cannot go on from step {checkpoint.step:,}: {error}") from None


def begin_fork(training: Training, checkpoint: Checkpoint) -> None:
    """Put a training where its parent's checkpoint was taken, with random streams of its own from then on."""
    run, worlds = training.run, training.collector.worlds
    restore_checkpoint(training, checkpoint, run.fork_reset)
    worlds.rekey([stream_seed(run.stream, "world", slot) for slot in range(run.slots)])
    if run.fork_reset == "xp":
        worlds.players["xp"] = 0.0
        worlds.observe()
    training.collector.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
    for player, learner in enumerate(training.learners):
        learner.generator = np.random.default_rng(stream_seed(run.stream, "minibatches", player))


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
