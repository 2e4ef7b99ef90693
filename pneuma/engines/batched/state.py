"""The whole state of a learner between two updates, as plain arrays, and back."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pneuma.config import stream_seed
from pneuma.engines.batched import Learner
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.checkpoint import Checkpoint, CheckpointError
from pneuma.engines.records import Records
from pneuma.env.state import LAYOUT_DIGEST

_WORLDS = ("worlds", "players", "monsters")
_EPISODES = ("returns", "lengths", "episodes", "begins")


def take_checkpoint(learner: Learner, step: int, records: Records) -> Checkpoint:
    """Copy all that the next update depends on."""
    collector = learner.collector
    arrays = {f"worlds/{name}": _bytes(getattr(collector.worlds, name)).copy() for name in _WORLDS}
    arrays |= {f"episodes/{name}": getattr(collector, name).copy() for name in _EPISODES}
    arrays |= {f"networks/{name}": np.array(array) for name, array in _named(learner.networks)}
    arrays |= {f"optimizer/{name}": np.array(array) for name, array in _named(learner.optimizer)}
    numbers = {
        "layout": LAYOUT_DIGEST,
        "optimizer": learner.run.optimizer,
        "actions": collector.generator.bit_generator.state,
        "minibatches": learner.generator.bit_generator.state,
    }
    return Checkpoint(step, arrays, numbers, records.copy())


def restore_checkpoint(learner: Learner, checkpoint: Checkpoint, reset: str = "") -> None:
    """Put a learner where a checkpoint was taken, but for what `reset` names: it stays as it begins.

    Raises:
        CheckpointError: for one that does not fit this learner.
    """
    numbers = checkpoint.numbers
    try:
        if numbers["layout"] != LAYOUT_DIGEST:
            raise ValueError("the state of the worlds was laid out otherwise")
        if numbers["optimizer"] != learner.run.optimizer and reset != "optimizer":
            raise ValueError(f"it is of the optimizer {numbers['optimizer']}")
        _restore_worlds(learner, checkpoint)
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
        learner.collector.generator.bit_generator.state = numbers["actions"]
        learner.generator.bit_generator.state = numbers["minibatches"]
    except (KeyError, ValueError, TypeError) as error:
        raise CheckpointError(f"cannot go on from step {checkpoint.step:,}: {error}") from None


def begin_fork(learner: Learner, checkpoint: Checkpoint) -> None:
    """Put a learner where its parent's checkpoint was taken, with random streams of its own from there on."""
    run, worlds = learner.run, learner.collector.worlds
    restore_checkpoint(learner, checkpoint, run.fork_reset)
    worlds.rekey([stream_seed(run.stream, "world", slot) for slot in range(run.slots)])
    if run.fork_reset == "xp":
        worlds.players["xp"] = 0.0
        worlds.observe()
    learner.collector.generator = np.random.default_rng(stream_seed(run.stream, "actions"))
    learner.generator = np.random.default_rng(stream_seed(run.stream, "minibatches"))


def _restore_worlds(learner: Learner, checkpoint: Checkpoint) -> None:
    collector = learner.collector
    pairs = [(_bytes(getattr(collector.worlds, name)), f"worlds/{name}") for name in _WORLDS]
    pairs += [(getattr(collector, name), f"episodes/{name}") for name in _EPISODES]
    for own, name in pairs:
        if own.shape != checkpoint.arrays[name].shape:
            raise ValueError(f"{name} is of shape {checkpoint.arrays[name].shape}, not {own.shape}")
        own[:] = checkpoint.arrays[name]
    collector.worlds.observe()


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
