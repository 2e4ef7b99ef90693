"""The interface between engines and environments.

    run → check_environment; make_collector, make_vec_env, make_evaluation

There are two implementations: one for Pneuma's own worlds, and one for all other Gymnasium environments
(`gymnasium_env.py`). Heavy modules are imported only when needed, as each engine needs a part of them.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from pneuma.config import Run, env_config, is_gymnasium_id, stream_seed


class Collects(Protocol):
    """Plays horizons for the engine `batched`, as `pneuma.engines.batched.rollout.Collector` does.

    Attributes:
        features, actions: the length of an observation, and the number of actions.
        generator: draws the actions.
        layout: identifies the layout of the arrays of `saved_state`.
    """

    layout: str
    features: int
    actions: int
    generator: np.random.Generator

    @property
    def observations(self) -> np.ndarray:
        """The current observations, (slots, features)."""
        ...

    def collect(self, actor: Any) -> Any:
        """Play one horizon and return the `Rollout`."""
        ...

    def episode_rows(self, rollout: Any, first_step: int) -> list[dict[str, Any]]:
        """Return a rollout's finished episodes as records, given the agent steps before it."""
        ...

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return everything that the next step depends on, except the generator: arrays by name."""
        ...

    def restore_state(self, saved: Any) -> None:
        """Resume from a saved state.

        Raises:
            ValueError, KeyError: for a state that does not fit, or cannot be reached again.
        """
        ...

    def fork(self) -> None:
        """Continue with random streams of the run's own, and with XP reset if asked for."""
        ...


def check_environment(run: Run) -> None:
    """Make a run's environment once, to find mistakes.

    Raises:
        UserError: when that fails, or the run's engine cannot train in it.
    """
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_env import check_spaces

        return check_spaces(run)
    from pneuma.env.worlds import Worlds

    Worlds(1, env_config(run))
    return None


def make_collector(run: Run) -> Collects:
    """Return the collector for the engine `batched`."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.batched.gymnasium_rollout import Collector as Foreign

        return Foreign(run)
    from pneuma.engines.batched.rollout import Collector

    return Collector(run)


def make_vec_env(run: Run) -> Any:
    """Return the `VecEnv` for the engine `sb3`, with `finished`, `saved_state`, `restore_state`, `fork`."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_vec_env import GymnasiumVecEnv

        return GymnasiumVecEnv(run)
    from pneuma.env.sb3 import PneumaVecEnv

    env = PneumaVecEnv(slot_seeds(run), env_config(run))
    env.keep_finished = True
    return env


def make_evaluation(run: Run) -> Any:
    """Return the evaluation of a run's policies, with a method `evaluate(policy, step)`."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_env import Evaluation as Foreign

        return Foreign(run)
    from pneuma.engines.evaluation import Evaluation

    return Evaluation(run)


def slot_seeds(run: Run) -> list[int]:
    """Return the seeds of the worlds in a run's slots."""
    return [stream_seed(run.stream, "world", slot) for slot in range(run.slots)]
