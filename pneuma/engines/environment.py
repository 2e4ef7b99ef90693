"""The interface between engines and environments.

    run → check_environment, first_capable_engine; make_vec_env

There are two implementations: one for Pneuma's own worlds, and one for all other Gymnasium environments
(`gymnasium_env.py`). Heavy modules are imported only when needed, as each engine needs a part of them.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from pneuma.config import ENGINES, Run, env_config, is_gymnasium_id, is_resumable, slot_seeds
from pneuma.engines.device import check_device


@contextmanager
def _restored_process() -> Iterator[None]:
    """Restore the working folder and how this process ends, which environments may change for themselves."""
    folder = os.getcwd()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        os.chdir(folder)
        if threading.current_thread() is threading.main_thread():  # others cannot change them
            for number, handler in handlers.items():
                if handler is not None:  # it is not Python's
                    signal.signal(number, handler)


@_restored_process()
def check_environment(run: Run) -> None:
    """Make a run's environment once, and refuse it if it is wrong or the run's engine cannot train in it."""
    check_device(run)
    if not is_resumable(run):
        from pneuma.engines.sb3_open import check_learner

        check_learner(run)
    elif is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_env import check_spaces

        check_spaces(run)
    else:
        from pneuma.env.worlds import Worlds

        Worlds(1, env_config(run))


@_restored_process()
def first_capable_engine(run: Run) -> str:
    """Return the first engine that can train in a run's environment. The environment is made for that."""
    from gymnasium.spaces import Discrete

    from pneuma.engines.gymnasium_env import closed_after, make_env

    with closed_after(run, make_env(run)) as env:
        return ENGINES[0] if isinstance(env.action_space, Discrete) else "sb3"


def make_vec_env(run: Run) -> Any:
    """Return the `VecEnv` for the engine `sb3`, whose `slots` can be saved and restored."""
    if is_gymnasium_id(run.env):
        from pneuma.engines.gymnasium_vec_env import GymnasiumVecEnv

        return GymnasiumVecEnv(run)
    from pneuma.env.sb3 import PneumaVecEnv

    world_config = env_config(run)
    return PneumaVecEnv(run.slots * world_config.players, slot_seeds(run), run.env, **vars(world_config))
