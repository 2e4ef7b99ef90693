"""Estimated values of actions beside true ones: discounting by hand, and worlds in which all is known."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.config import make_run
from pneuma.engines.action_values import ActionValues, _steps_beyond, discounted
from pneuma.engines.policy import Policy


def test_discounted_sums_by_hand() -> None:
    # From the end: 4, 2 + 4/2 = 4, 1 + 4/2 = 3.
    np.testing.assert_array_equal(discounted(np.array([1.0, 2.0, 4.0]), 0.5), [3.0, 4.0, 4.0])
    np.testing.assert_array_equal(discounted(np.array([[1.0, 0.0], [0.0, 8.0]]), 0.25), [[1, 2], [0, 8]])


def always(action: int, value: float) -> Policy:
    """One action in every state, said to be worth `value`."""
    bias = np.zeros(5, np.float32)
    bias[action] = value
    return Policy("tanh", ((np.zeros((60, 5), np.float32), bias),), (), 0.1)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9])
def test_a_constant_reward_is_worth_the_geometric_series(
    gamma: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The time limit cuts no state short: all are worth 1 / (1 - gamma), but for the hundredth left out."""
    values = ActionValues(make_run({"algorithm": "dqn", "gamma": gamma, "episode_steps": 12}), 6)
    step = values.worlds.step

    def paid(actions: np.ndarray) -> int:
        ended = step(actions)
        values.worlds.events["reward"][:] = values.worlds.present
        return ended

    monkeypatch.setattr(values.worlds, "step", paid)
    told = values.measure(always(1, 7.0))
    assert told["q_estimate"] == 7.0
    assert told["q_true"] == pytest.approx(1 / (1 - gamma), rel=0.011)
    assert told["q_true"] <= 1 / (1 - gamma)


def test_a_time_limit_that_terminates_is_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"algorithm": "dqn", "gamma": 0.5, "episode_steps": 2, "time_limit": "terminate"}
    values = ActionValues(make_run(settings), 6)
    step = values.worlds.step

    def paid(actions: np.ndarray) -> int:
        ended = step(actions)
        values.worlds.events["reward"][:] = 1.0
        return ended

    monkeypatch.setattr(values.worlds, "step", paid)
    assert values.measure(always(1, 0.5))["q_true"] == pytest.approx((1.5 + 1) / 2)


def test_a_future_that_is_hardly_discounted_is_too_long_to_be_played() -> None:
    """At 0.999999 a hundredth is left after 4.6 million steps: more than an episode may have."""
    assert _steps_beyond(make_run({"algorithm": "dqn", "gamma": 0.999999})) is None
    assert _steps_beyond(make_run({"algorithm": "dqn", "gamma": 0.99})) == 459  # ln 0.01 / ln 0.99 = 458.2
    ActionValues(make_run({"algorithm": "dqn", "gamma": 0.999999}), 1)
