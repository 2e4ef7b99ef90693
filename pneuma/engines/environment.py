"""The seam between engines and environments: all that an engine asks of what a run is trained in.

    run → check_environment; make_collector, make_vec_env, make_evaluation

Pneuma's own worlds are one implementation, every other environment of Gymnasium's the second
(`gymnasium_env.py`). What is heavy is imported when it is asked for: each engine needs but a part.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from pneuma.config import Run, env_config, is_gymnasium_id, stream_seed


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


def check_environment(run: Run) -> None:
    """Make a run's environment once.

    Raises:
        UserError: where that fails, or the run's engine cannot train in it.
    """
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_env import check_spaces

        return check_spaces(run)
    from pneuma.env.worlds import Worlds

    Worlds(1, env_config(run))
    return None


def make_collector(run: Run) -> Collects:
    """Return what plays for the engine `batched`."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.batched.gymnasium_rollout import Collector as Foreign

        return Foreign(run)
    from pneuma.engines.batched.rollout import Collector

    return Collector(run)


def make_vec_env(run: Run) -> Any:
    """Return a `VecEnv` for the engine `sb3`, with `finished`, `saved_state`, `restore_state`, `fork`."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_vec_env import GymnasiumVecEnv

        return GymnasiumVecEnv(run)
    from pneuma.env.sb3 import PneumaVecEnv

    env = PneumaVecEnv(slot_seeds(run), env_config(run))
    env.keep_finished = True
    return env


def make_evaluation(run: Run) -> Any:
    """Return what judges a run's policies where they were not trained, by `evaluate(policy, step)`."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_env import Evaluation as Foreign

        return Foreign(run)
    from pneuma.engines.evaluation import Evaluation

    return Evaluation(run)


def slot_seeds(run: Run) -> list[int]:
    """Return the seeds of the worlds of a run's slots."""
    return [stream_seed(run.stream, "world", slot) for slot in range(run.slots)]
