"""The Markov decision process of the thesis's Fig. 2.1, a mailman's day, for tabular methods."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from pneuma.errors import UserError

POST_OFFICE, LETTERS, HOME = 0, 1, 2
GO_ON, GO_HOME = 0, 1
PLACES, ACTIONS = 3, 2
ACTION_NAMES = ("go on", "go home")
REWARDS = {(POST_OFFICE, LETTERS): 0.0, (LETTERS, HOME): 1.0, (POST_OFFICE, HOME): -1.0}
"""Delivering pays 1; going straight home gets him fired. The figure states no numbers."""


class MailmanEnv(gymnasium.Env[np.int64, np.int64]):
    """Three states: the post office, the letters and home.

    ## Observation and action space
    `Discrete(3)`: 0 post office (s1), 1 letters (s2), 2 home (s3). `Discrete(2)`: 0 go on to the next
    place, 1 go straight home.

    ## Reward
    1 for coming home after the letters, -1 for coming home without, 0 for going to the letters. The
    best route is s1, s2, s3 (thesis section 2.1), for every discount above 0.

    ## Start and end
    Starts at the post office, terminates at home.

    ## Arguments
    `slip`: probability that the other action is taken instead (default 0: deterministic).
    `noise`: standard deviation of normal noise on every reward (default 0).
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]

    def __init__(self, slip: float = 0.0, noise: float = 0.0, render_mode: str | None = None) -> None:
        if not 0 <= slip <= 1 or not 0 <= noise < float("inf"):
            raise UserError(f"slip = {slip}, noise = {noise}: a probability, and a number of at least 0")
        if render_mode is not None:
            raise UserError(f"render_mode = {render_mode!r} is not allowed: there is nothing to draw")
        self.observation_space = spaces.Discrete(PLACES)
        self.action_space = spaces.Discrete(ACTIONS)
        self.slip, self.noise, self.render_mode = slip, noise, render_mode
        self.place = HOME  # no day has begun

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.int64, dict[str, Any]]:
        super().reset(seed=seed)
        self.place = POST_OFFICE
        return np.int64(self.place), {}

    def step(self, action: np.int64) -> tuple[np.int64, float, bool, bool, dict[str, Any]]:
        if not self.action_space.contains(action):
            raise ValueError(f"action {action!r} is outside {self.action_space}")
        if self.place == HOME:
            raise gymnasium.error.ResetNeeded("no day is under way: call reset first")
        slipped = bool(self.slip) and self.np_random.random() < self.slip
        home = (action == GO_HOME) != slipped
        next_place = LETTERS if self.place == POST_OFFICE and not home else HOME
        reward = REWARDS[self.place, next_place]
        if self.noise:
            reward += float(self.np_random.normal(0.0, self.noise))
        self.place = next_place
        return np.int64(next_place), reward, next_place == HOME, False, {}


def decision_process(slip: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the process as arrays, for dynamic programming; learners never see it.

    Returns:
        (2, 2, 3) the probability of each next place, by place (post office or letters) and action; and (2, 2)
        the mean rewards. Noise changes neither.
    """
    chances, rewards = np.zeros((2, 2, 3)), np.zeros((2, 2))
    for place, action, slipped in np.ndindex(2, 2, 2):
        home = (action == GO_HOME) != bool(slipped)
        next_place = LETTERS if place == POST_OFFICE and not home else HOME
        chance = slip if slipped else 1 - slip
        chances[place, action, next_place] += chance
        rewards[place, action] += chance * REWARDS[place, next_place]
    return chances, rewards
