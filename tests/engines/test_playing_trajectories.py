"""Where stored policies go: ways that can be worked out by hand, and every ending."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.policy import Policy
from pneuma.engines.trajectories import DROWNED, play_trajectories
from pneuma.env.worlds import Worlds

PIXELS_PER_STEP = 40.0  # 300 px/s for 8 ticks of 1/60 s
RIGHT, ATTACK = 3, 4
GODOT, TEXT = "pneuma/PneumaGodot-v0", "pneuma/Pneuma-v0"
FIRST = (204.0, -105.0)
"""Where Godot's players begin."""
DEADLY: dict[str, Any] = {"coast": "deadly", "bodies": "pass"}
"""A sea that drowns, and no monster in the way to it."""


def always(action: int, run: Run) -> Policy:
    """Return a policy that does one thing, whatever it sees."""
    features = Worlds(1).observations.shape[2] if run.order == "nearest" else 74
    bias = np.full(5, -1e4, np.float32)
    bias[action] = 0.0
    return Policy("tanh", ((np.zeros((features, 5), np.float32), bias),), ())


def play(action: int, episodes: int = 2, env: str = GODOT, **settings: Any) -> Any:
    run = make_run({"env": env, **settings})
    return play_trajectories(run, always(action, run), episodes)


def test_who_walks_right_from_godots_start_drowns_where_the_land_ends() -> None:
    found = play(RIGHT, **DEADLY)
    x, y = found.places[:, 0, 0].T
    steps = found.steps[0]
    np.testing.assert_allclose(x[:steps], FIRST[0] + PIXELS_PER_STEP * np.arange(steps))
    assert np.all(y == FIRST[1])
    level = Worlds(1).level
    row = int((FIRST[1] - level.top) / level.tile)
    shore = level.left + level.tile * (np.flatnonzero(level.terrain[row] != 2).max() + 1)
    assert x[steps - 1] < shore <= x[steps]
    assert found.endings == (DROWNED, DROWNED)
    assert found.kills.tolist() == [0, 0]


def test_where_the_coast_is_a_wall_nobody_drowns() -> None:
    found = play(RIGHT, episodes=6, env=TEXT, episode_steps=100)
    assert set(found.endings) <= {"killed", "time-limit"}
    assert "time-limit" in found.endings
    assert found.steps.max() == 100 == len(found.places) - 1


@pytest.mark.parametrize("reward", ["thesis", "nowhere:reward"])
def test_a_reward_of_ones_own_is_not_asked(reward: str) -> None:
    assert play(RIGHT, reward=[reward], **DEADLY).endings == (DROWNED, DROWNED)
