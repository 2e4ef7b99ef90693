"""What the reference engine adds to Stable-Baselines3, on an environment that costs nothing.

Measured in a process of its own that is pinned to one thread, as workers are: NumPy's and torch's
thread pools otherwise get in each other's way.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn

from pneuma.config import BASES, Run, make_run
from pneuma.engines import sb3
from pneuma.study.executors.local import one_thread_environment

ROUNDS = 5
STEPS = 4096
CASE = "small network, free world"


class FreeVecEnv(VecEnv):
    """One world of 60 features that never changes and never ends."""

    def __init__(self) -> None:
        self.render_mode = None
        super().__init__(1, spaces.Box(-1, 1, (60,), np.float32), spaces.Discrete(5))
        self._observation = np.zeros((1, 60), np.float32)
        self._infos: list[dict[str, Any]] = [{}]

    def reset(self) -> np.ndarray:
        """Return the one observation."""
        return self._observation

    def step_async(self, actions: np.ndarray) -> None:
        """Ignore the actions."""

    def step_wait(self) -> VecEnvStepReturn:
        """Return the one observation again."""
        return self._observation, np.ones(1, np.float32), np.zeros(1, np.bool_), self._infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute."""
        return [getattr(self, attr_name)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method."""
        return [getattr(self, method_name)(*method_args, **method_kwargs)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Say that it is not wrapped."""
        return [False]


def bench_reference() -> dict[str, Any]:
    """Return steps a second of both, and the median over rounds of the ratio of their times per step."""
    command = [sys.executable, "-m", "pneuma.bench.reference"]
    done = subprocess.run(command, env=one_thread_environment(), stdout=subprocess.PIPE, check=True)
    report: dict[str, Any] = json.loads(done.stdout)
    return report


def measure() -> dict[str, Any]:
    """Measure in this process; see `bench_reference`."""
    torch.set_num_threads(1)
    run = make_run({**BASES["table-6-2"], "steps": STEPS})
    _seconds(run, alone=True)  # warm up
    ours, theirs = [], []
    for _ in range(ROUNDS):
        theirs.append(_seconds(run, alone=True))
        ours.append(_seconds(run, alone=False))
    ours_over_theirs = statistics.median(a / b for a, b in zip(ours, theirs, strict=True))
    return {
        "cases": [_case("sb3", ours), _case("Stable-Baselines3", theirs)],
        "ratios": {CASE: ours_over_theirs},
    }


def _seconds(run: Run, alone: bool) -> float:
    """Return the processor time of one training; both sides run on one thread."""
    env = FreeVecEnv()
    start = time.process_time()
    if alone:
        sb3.make_model(run, env).learn(run.steps, log_interval=None)
    else:
        sb3.train_one(run, lambda progress: True, env=env)
    return time.process_time() - start


def _case(engine: str, seconds: Sequence[float]) -> dict[str, Any]:
    rate = STEPS / statistics.median(seconds)
    return {"case": CASE, "engine": engine, "runs": 1, "steps_per_second": rate}


if __name__ == "__main__":
    print(json.dumps(measure()))
