"""The seam between engines and environments: all that an engine asks of what a run is trained in.

    run → environment_of → check, collector, vec_env, evaluation

Pneuma's own worlds are one implementation, here; every other environment of Gymnasium's is the second
(`gymnasium_env.py`). What is heavy is imported when it is asked for: each engine needs but a part.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, Protocol

import numpy as np

from pneuma.config import Run, env_config, is_gymnasium_id, stream_seed
from pneuma.engines.records import Row


class Collects(Protocol):
    """Plays horizons for the engine `batched`; see `pneuma.engines.batched.rollout.Collector`.

    Attributes:
        features, actions: numbers in an observation, and how many actions there are.
        generator: draws the actions.
        layout: changes where the arrays of `saved_state` are laid out otherwise.
    """

    layout: str
    features: int
    actions: int
    generator: np.random.Generator

    @property
    def observations(self) -> np.ndarray:
        """What is seen now, (slots, features)."""
        ...

    def collect(self, actor: Any) -> Any:
        """Play one horizon, and return the `Rollout`."""
        ...

    def episode_rows(self, rollout: Any, first_step: int) -> list[dict[str, Any]]:
        """Return a rollout's finished episodes as records; `first_step` agent steps were taken before it."""
        ...

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return all that the next step depends on, but the generator: arrays by name."""
        ...

    def restore_state(self, saved: Any) -> None:
        """Go on from there.

        Raises:
            ValueError, KeyError: for a state that does not fit, or that cannot be reached again.
        """
        ...

    def fork(self) -> None:
        """Go on with random streams of the run's own; its player's XP anew where it says so."""
        ...


class Evaluates(Protocol):
    """Judges policies where they were not trained."""

    def evaluate(self, policy: Any, step: int) -> Row:
        """Return one row of `records.EVALUATION_COLUMNS` for the policy after `step` agent steps."""
        ...


class Environment(Protocol):
    """What a run's environment is to its engine."""

    def check(self, run: Run) -> None:
        """Make it once.

        Raises:
            UserError: where that fails, or the run's engine cannot train in it.
        """
        ...

    def collector(self, run: Run) -> Collects:
        """Return what plays for the engine `batched`."""
        ...

    def vec_env(self, run: Run) -> Any:
        """Return a `VecEnv` for the engine `sb3`, with `finished`, `saved_state`, `restore_state`, `fork`."""
        ...

    def evaluation(self, run: Run) -> Evaluates:
        """Return what judges the run's policies."""
        ...


def environment_of(run: Run) -> Environment:
    """Return what a run is trained in."""
    if is_gymnasium_id(run.env):
        foreign: Environment = import_module("pneuma.engines.gymnasium_env").GymnasiumEnvironment()
        return foreign
    return PneumaWorlds()


def slot_seeds(run: Run) -> list[int]:
    """Return the seeds of the worlds of a run's slots."""
    return [stream_seed(run.stream, "world", slot) for slot in range(run.slots)]


class PneumaWorlds:
    """Pneuma's own."""

    def check(self, run: Run) -> None:
        """Make the world."""
        import_module("pneuma.env.worlds").Worlds(1, env_config(run))

    def collector(self, run: Run) -> Collects:
        """Return the compiled rollout."""
        own: Collects = import_module("pneuma.engines.batched.rollout").Collector(run)
        return own

    def vec_env(self, run: Run) -> Any:
        """Return the worlds of the run's slots, each with a random stream of its own."""
        env = import_module("pneuma.env.sb3").PneumaVecEnv(slot_seeds(run), env_config(run))
        env.keep_finished = True
        return env

    def evaluation(self, run: Run) -> Evaluates:
        """Return the evaluation on worlds that training never sees."""
        own: Evaluates = import_module("pneuma.engines.evaluation").Evaluation(run)
        return own
