"""The frames of an episode in any environment of Gymnasium that draws pictures of itself."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.error import DependencyNotInstalled

from pneuma.algorithms import is_masked
from pneuma.config import Run
from pneuma.engines.gymnasium_env import actions_in_space, errors_from, flattening, make_env
from pneuma.engines.policy import Policy
from pneuma.engines.sb3_open import LearnedPolicy
from pneuma.errors import UserError, install_command

FRAMES_PER_SECOND = 30
"""The frame rate of an environment whose metadata contain none."""


def frame_rate(run: Run) -> float:
    """Return how many frames of a run's environment are a second."""
    with closing(make_env(run)) as env:
        return float(env.metadata.get("render_fps") or FRAMES_PER_SECOND)


def episode_frames(run: Run, policy: Policy | LearnedPolicy | None, seed: int) -> Iterator[np.ndarray]:
    """Yield the frames of one episode, (height, width, 3) uint8; without a policy actions are random."""
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # PyGame looks for a screen, and warns if there is none
    with closing(make_env(run, "rgb_array")) as env, errors_from(f"{run.env} when it is drawn"):
        env.action_space.seed(seed)
        torch.manual_seed(seed)
        generator = np.random.default_rng(seed)
        state: Any = None
        try:
            observation, _ = env.reset(seed=seed)
            first_frame = _frame(run, env)
        except DependencyNotInstalled as error:
            if "pygame" not in str(error):
                raise
            raise UserError(f"{run.env} is drawn by pygame: {install_command('play')}") from None
        yield first_frame
        is_first, has_ended = True, False
        while not has_ended:
            if policy is None:
                action = env.action_space.sample()
            elif isinstance(policy, Policy):
                flat_observation = np.asarray(flattening(run, env.observation_space)(observation), np.float32)
                actions = policy.sample(flat_observation[None], generator)
                action = actions_in_space(env.action_space, actions)[0]
            else:
                masks = env.get_wrapper_attr("action_masks")() if is_masked(run.algorithm) else None
                action, state = policy.predict(observation, state, np.array([is_first]), action_masks=masks)
            observation, _, terminated, truncated, _ = env.step(action)
            yield _frame(run, env)
            is_first, has_ended = False, terminated or truncated


def _frame(run: Run, env: gymnasium.Env[Any, Any]) -> np.ndarray:
    frame: Any = env.render()
    if not isinstance(frame, np.ndarray) or frame.ndim != 3:
        raise UserError(f"{run.env} does not draw pictures")
    return frame
