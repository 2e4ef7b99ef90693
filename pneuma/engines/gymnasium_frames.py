"""Episodes to watch in any environment of Gymnasium that draws pictures of itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.error import DependencyNotInstalled

from pneuma.config import Run
from pneuma.engines.gymnasium_env import actions_in, blamed, flattening, make_env
from pneuma.engines.policy import Policy
from pneuma.engines.sb3_open import LearnedPolicy
from pneuma.errors import UserError, install_extra

FRAMES_PER_SECOND = 30
"""Of an environment that does not say how fast it is."""

Act = Callable[[Any], Any]


def frame_rate(run: Run) -> float:
    """Return how many frames of a run's environment are a second."""
    with closing(make_env(run)) as env:
        return float(env.metadata.get("render_fps") or FRAMES_PER_SECOND)


def episode_frames(run: Run, policy: Policy | LearnedPolicy | None, seed: int) -> Iterator[np.ndarray]:
    """Yield the frames of one episode, (height, width, 3) uint8; without a policy actions are random."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # PyGame looks for a screen, and prints what it lacks
    with closing(make_env(run, "rgb_array")) as env, blamed(f"{run.env} when it is drawn"):
        env.action_space.seed(seed)
        choose_action = _acting(run, policy, env, seed)
        try:
            observation, _ = env.reset(seed=seed)
            first_frame = _frame(run, env)
        except DependencyNotInstalled as error:
            if "pygame" not in str(error):
                raise
            raise UserError(f"{run.env} is drawn by pygame: {install_extra('play')}") from None
        yield first_frame
        has_ended = False
        while not has_ended:
            observation, _, terminated, truncated, _ = env.step(choose_action(observation))
            yield _frame(run, env)
            has_ended = terminated or truncated


def _frame(run: Run, env: gymnasium.Env[Any, Any]) -> np.ndarray:
    frame: Any = env.render()
    if not isinstance(frame, np.ndarray) or frame.ndim != 3:
        raise UserError(f"{run.env} does not draw pictures")
    return frame


def _acting(run: Run, policy: Policy | LearnedPolicy | None, env: gymnasium.Env[Any, Any], seed: int) -> Act:
    """Return a function that samples an action for an observation as the environment gives it."""
    if policy is None:
        return lambda observation: env.action_space.sample()
    if isinstance(policy, Policy):
        flatten, generator = flattening(run, env.observation_space), np.random.default_rng(seed)

        def sample(observation: Any) -> Any:
            flat_observation = np.asarray(flatten(observation), np.float32)
            return actions_in(env.action_space, policy.sample(flat_observation[None], generator))[0]

        return sample
    torch.manual_seed(seed)
    state: Any = None
    starts = np.ones(1, bool)

    def predict(observation: Any) -> Any:
        nonlocal state, starts
        action, state = policy.predict(observation, state, starts)
        starts = np.zeros(1, bool)
        return action

    return predict
