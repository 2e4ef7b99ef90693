"""The contract between engines and studies.

An engine module has one function, `train(runs, checkpoints, on_update)`. It takes complete runs of
equal shapes and yields one `Result` for each as it ends. After every update it hands `on_update` a
`Progress`; a false answer stops the training there. What a run ends with depends on the run alone:
not on its neighbours in the group, on the number of workers, or on the order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Protocol

from pneuma.config import Run
from pneuma.engines.policy import Policy
from pneuma.engines.records import Checkpoint, Records

EVALUATIONS = 20
"""Evaluations per run."""


@dataclass(frozen=True)
class Progress:
    """The state of one run after an update.

    Attributes:
        run: the run.
        step: agent steps trained, over all slots.
        records: everything up to now; the engine goes on writing to it.
        checkpoint: takes a checkpoint of this moment, if called before the next update.
    """

    run: Run
    step: int
    records: Records
    checkpoint: Callable[[], Checkpoint]

    def __repr__(self) -> str:
        return f"seed {self.run.seed}: {self.step:,} of {self.run.steps:,} steps"


@dataclass(frozen=True)
class Result:
    """The end of a run.

    Attributes:
        run: the run.
        status: 'done'; 'diverged' where a loss, gradient, parameter or logit was not finite; or 'stopped'
            where `on_update` asked for it.
        step: agent steps trained, over all slots.
        records: everything up to then.
        policy: the last policy; None when it is not finite.
    """

    run: Run
    status: str
    step: int
    records: Records
    policy: Policy | None


OnUpdate = Callable[[Progress], bool]


class Engine(Protocol):
    """The interface of an engine module."""

    def train(
        self, runs: Sequence[Run], checkpoints: Mapping[int, Checkpoint], on_update: OnUpdate
    ) -> Iterator[Result]:
        """Train all runs of a group; `checkpoints` maps indices of `runs` to checkpoints to resume from.

        Raises:
            CheckpointError: for a checkpoint that the engine cannot go on from.
        """
        ...


def load_engine(name: str) -> Engine:
    """Import an engine by its name in `pneuma.config.ENGINE_VERSIONS`."""
    return import_module(f"pneuma.engines.{name}")


def evaluation_updates(run: Run) -> set[int]:
    """Return the updates, counted from 1, after which a run is evaluated.

    Evenly spread, the last update among them; fewer than `EVALUATIONS` in a run of fewer updates.
    """
    return _spread(run.updates, EVALUATIONS)


def checkpoint_steps(run: Run, count: int) -> set[int]:
    """Return the agent steps at which a run's checkpoints are kept; none if `count` is 0.

    That is after `count` updates, evenly spread, the last at its end; and after the first, so that a run
    can be forked however early it collapses.
    """
    first = {1} if count else set()
    return {update * run.steps_per_update for update in first | _spread(run.updates, count)}


def _spread(updates: int, count: int) -> set[int]:
    """Return `count` evenly spread numbers from 1 to `updates`, including the last."""
    return {-(-updates * k // count) for k in range(1, count + 1)}
