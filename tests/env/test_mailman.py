"""The mailman's day (thesis Fig. 2.1): Gymnasium's contract, its transitions, and the best route."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.algorithms import MAILMAN
from pneuma.env.mailman import MailmanEnv
from pneuma.errors import UserError

OFFICE, LETTERS, HOME = 0, 1, 2  # s1, s2, s3
GO_ON, GO_HOME = 0, 1
GAMMAS = [0.1, 0.3, 0.5, 0.7, 0.9, 0.99]


def make(**settings: Any) -> MailmanEnv:
    env = gymnasium.make(MAILMAN, **settings).unwrapped
    assert isinstance(env, MailmanEnv)
    return env


def days(env: MailmanEnv, first: int, second: int, count: int) -> Iterator[list[tuple[int, float, bool]]]:
    """Yield days of an environment: place, reward and end after each of at most two actions."""
    for _ in range(count):
        env.reset()
        told = []
        for action in (first, second):
            there, reward, terminated, truncated, _ = env.step(np.int64(action))
            assert not truncated
            told.append((int(there), reward, terminated))
            if terminated:
                break
        yield told


# --- The contract --------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [{"slip": -0.1}, {"slip": 1.1}, {"slip": float("nan")}, {"noise": -1.0},
                                      {"noise": float("inf")}, {"noise": float("nan")}], ids=str)  # fmt: skip
def test_settings_out_of_range_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=next(iter(settings))):
        MailmanEnv(**settings)


# --- Transitions ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "second", "day"),
    [
        (GO_ON, GO_ON, [(LETTERS, 0.0, False), (HOME, 1.0, True)]),
        (GO_ON, GO_HOME, [(LETTERS, 0.0, False), (HOME, 1.0, True)]),
        (GO_HOME, GO_ON, [(HOME, -1.0, True)]),
    ],
)
def test_a_day_without_slips_goes_as_chosen(
    first: int, second: int, day: list[tuple[int, float, bool]]
) -> None:
    env = make()
    assert env.reset(seed=0)[0] == OFFICE
    assert list(days(env, first, second, 1)) == [day]


def test_a_slip_takes_the_other_action_as_often_as_set() -> None:
    env = make(slip=0.3)
    env.reset(seed=0)
    home = sum(day[0][0] == HOME for day in days(env, GO_ON, GO_ON, 4000))
    # 1200 expected; the standard deviation is sqrt(4000 x 0.3 x 0.7) = 29.
    assert abs(home - 1200) < 4 * 29
    away = sum(day[0][0] == LETTERS for day in days(env, GO_HOME, GO_ON, 4000))
    assert abs(away - 1200) < 4 * 29


# --- The best route ------------------------------------------------------------------------------


def learn_model(env: MailmanEnv, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Estimate P(s' | s, a), (2, 2, 3), and the mean reward of each s and a, (2, 2), from days played."""
    visits, paid = np.zeros((2, 2, 3)), np.zeros((2, 2))
    for first in (GO_ON, GO_HOME):
        for second in (GO_ON, GO_HOME):
            for day in days(env, first, second, count):
                place = OFFICE
                for action, (there, reward, _) in zip((first, second), day, strict=False):
                    visits[place, action, there] += 1
                    paid[place, action] += reward
                    place = there
    return visits / visits.sum(axis=-1, keepdims=True), paid / visits.sum(axis=-1)


def iterate_values(chances: np.ndarray, rewards: np.ndarray, gamma: float) -> np.ndarray:
    """Return Q(s, a) of the office and the letters by value iteration (thesis Eq. 2.1); home is worth 0."""
    values = np.zeros(3)
    for _ in range(200):
        action_values = rewards + gamma * chances @ values
        values = np.array([*action_values.max(axis=-1), 0.0])
    return np.asarray(action_values)


@pytest.mark.parametrize("gamma", GAMMAS)
@pytest.mark.parametrize(
    "settings", [{}, {"noise": 0.5}, {"slip": 0.2}, {"slip": 0.4, "noise": 0.3}], ids=str
)
def test_the_best_route_is_over_the_letters(settings: dict[str, Any], gamma: float) -> None:
    env = make(**settings)
    env.reset(seed=11)
    values = iterate_values(*learn_model(env, 1500), gamma)
    assert values[OFFICE, GO_ON] > values[OFFICE, GO_HOME]
    # By hand: home from the letters pays 1 either way. From the office, going on comes out with
    # (1 - slip) x gamma - slip, going home with slip x gamma - (1 - slip).
    slip = settings.get("slip", 0.0)
    assert values[LETTERS] == pytest.approx([1.0, 1.0], abs=0.08)
    assert values[OFFICE] == pytest.approx([(1 - slip) * gamma - slip, slip * gamma - (1 - slip)], abs=0.08)
