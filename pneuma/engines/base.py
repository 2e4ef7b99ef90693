"""The contract between engines and studies.

An engine module has one function, `train(runs, checkpoints, on_update)`. It takes complete runs of
equal shapes and yields one `Result` for each as it ends. After every update it hands `on_update` a
`Progress`; a false answer stops the training there. What a run ends with depends on the run alone:
not on its neighbours in the group, on the number of workers, or on the order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, Protocol

from pneuma.config import ACTION_NAMES, Run
from pneuma.engines.policy import Policy

EVALUATIONS = 20
"""Times that the frozen policy is evaluated over a run."""

EPISODE_COLUMNS = ("slot", "episode", "step", "return", "length", "kills", "hp", "ending")
METRIC_COLUMNS = (
    "step",
    "policy_loss",
    "value_loss",
    "entropy",
    "approx_kl",
    "clip_fraction",
    "grad_norm",
    "grad_norm_actor",
    "grad_norm_critic",
    "explained_variance",
    "dead_units",
    *(f"action_{i}" for i in range(len(ACTION_NAMES))),
)
EVALUATION_COLUMNS = (
    "step",
    "episodes",
    "share_killed",
    "score",
    "return",
    "length",
    "died",
    "argmax_starts",
    "argmax_share_killed",
    "argmax_score",
    "argmax_return",
    "random_share_killed",
    "hunter_share_killed",
)

Row = Mapping[str, Any]


@dataclass
class Records:
    """What a run writes down: rows of `EPISODE_`, `METRIC_` and `EVALUATION_COLUMNS`, in order."""

    episodes: list[Row] = field(default_factory=list)
    metrics: list[Row] = field(default_factory=list)
    evaluations: list[Row] = field(default_factory=list)


@dataclass(frozen=True)
class Progress:
    """Where one run of a group stands after an update; `step` counts agent steps over all slots."""

    run: Run
    step: int
    records: Records


@dataclass(frozen=True)
class Result:
    """How one run ended.

    Attributes:
        run: the run.
        status: 'done'; 'diverged' where a loss, gradient or parameter was not finite; or 'stopped'
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
    """What `load_engine` returns: a module with this function."""

    def train(
        self, runs: Sequence[Run], checkpoints: Mapping[int, Any], on_update: OnUpdate
    ) -> Iterator[Result]:
        """Train every run of a group; `checkpoints` maps an index of `runs` to where to go on from.

        Raises:
            ValueError: for a checkpoint that the engine cannot go on from.
        """
        ...


def load_engine(name: str) -> Engine:
    """Import an engine by its name in `pneuma.config.ENGINE_VERSIONS`."""
    return import_module(f"pneuma.engines.{name}")


def evaluation_updates(run: Run) -> set[int]:
    """Return the numbers, from 1, of the updates after which a run is evaluated.

    Evenly spread, the last update among them; fewer than `EVALUATIONS` in a run of fewer updates.
    """
    return {-(-run.updates * k // EVALUATIONS) for k in range(1, EVALUATIONS + 1)}
