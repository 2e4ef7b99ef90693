"""Tables and the mailman: steps by hand, the best route, overestimation where noise makes it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.algorithms import MAILMAN
from pneuma.config import Run, make_run
from pneuma.engines.mailman import GO_HOME, GO_ON, HOME, LETTERS, POST_OFFICE, MailmanEnv, decision_process
from pneuma.engines.tabular import estimated_values, exploration_rate, policy_values, temporal_difference

from .trained import train

BOTH = ("q-learning", "double-q-learning")


def run_of(algorithm: str = "q-learning", **settings: object) -> Run:
    small = {"horizon": 10, "steps": 400, "learning_rate": 0.5, "evaluation_episodes": 5, "gamma": 0.9}
    return make_run({"env": MAILMAN, "algorithm": algorithm, **small, **settings})


# --- One step ----------------------------------------------------------------------------------------


def test_a_step_of_q_learning_by_hand() -> None:
    # Eq. 3.2: 0.5 + 0.9 max(2, 3) - 1 = 2.2. At home nothing follows: 0.5 - 1 = -0.5.
    table = np.array([[[1.0, 0.0], [2.0, 3.0], [9.0, 9.0]]])
    step: Any = (POST_OFFICE, GO_ON, 0.5)
    assert temporal_difference(table, 0, (*step, LETTERS), 0.9) == pytest.approx(2.2)
    assert temporal_difference(table, 0, (*step, None), 0.9) == pytest.approx(-0.5)


def test_a_step_of_double_q_learning_by_hand() -> None:
    # Eq. 3.9: table 0 prefers action 1 (3 > 2), which table 1 rates 5: 0.5 + 0.9 x 5 - 1 = 4. Table 1 prefers
    # action 0 (7 > 5), which table 0 rates 2: 0.5 + 0.9 x 2 - 4 = -1.7.
    tables = np.array([[[1.0, 0.0], [2.0, 3.0], [0.0, 0.0]], [[4.0, 0.0], [7.0, 5.0], [0.0, 0.0]]])
    step: Any = (POST_OFFICE, GO_ON, 0.5, LETTERS)
    assert temporal_difference(tables, 0, step, 0.9) == pytest.approx(4.0)
    assert temporal_difference(tables, 1, step, 0.9) == pytest.approx(-1.7)
    # What they hold the letters to be worth: the mean of 5 and 2; Q-learning with table 1 alone: 7.
    assert estimated_values(tables)[LETTERS] == 3.5
    assert estimated_values(tables[1:])[LETTERS] == 7.0


def test_exploration_falls_in_a_line_and_stays() -> None:
    run = run_of(exploration=0.2, exploration_fraction=0.5)  # from 1 to 0.2 over 200 steps
    assert [exploration_rate(run, taken) for taken in (0, 100, 200, 400)] == pytest.approx([1, 0.6, 0.2, 0.2])
    assert exploration_rate(run_of(exploration=0.2), 0) == 0.2


# --- What can be computed ----------------------------------------------------------------------------


def test_values_of_the_figures_process_by_hand() -> None:
    # Without slips: from the letters either action pays 1; from the office home pays -1, the letters 0.
    process = decision_process()
    assert policy_values(process, np.array([GO_HOME, GO_ON]), 0.9).tolist() == [-1, 1]


def test_the_computed_process_is_the_one_that_is_played() -> None:
    env, count = MailmanEnv(slip=0.3), 4000
    env.reset(seed=0)
    chances, rewards = decision_process(0.3)
    for place, action in np.ndindex(2, 2):
        seen, earned = np.zeros(3), 0.0
        for _ in range(count):
            env.reset()
            env.place = place
            there, reward, *_ = env.step(np.int64(action))
            seen[there] += 1 / count
            earned += reward / count
        # One standard error is at most 0.5 / sqrt(4000) = 0.008, of the reward twice that.
        np.testing.assert_allclose(seen, chances[place, action], atol=0.03)
        assert earned == pytest.approx(rewards[place, action], abs=0.06)


# --- Whole runs --------------------------------------------------------------------------------------


@pytest.mark.parametrize("algorithm", BOTH)
def test_the_best_route_is_found_and_its_value(algorithm: str) -> None:
    result, _ = train(run_of(algorithm, steps=4000, exploration=0.5))
    last = result.records.evaluations[-1]
    assert last["argmax_return"] == 1.0
    assert (last["q_estimate"], last["q_true"]) == pytest.approx((0.95, 0.95), abs=1e-3)  # of 0.9 and 1


@pytest.mark.parametrize(("algorithm", "excess"), [("q-learning", 0.474), ("double-q-learning", 0.0)])
def test_noise_is_overestimated_by_one_table_as_much_as_theory_says(algorithm: str, excess: float) -> None:
    """The letters' two actions pay 1 on average; acting at random, both entries are as noisy and independent.

    An entry of rate a under noise s varies by s sqrt(a / (2 - a)) = 2 sqrt(0.3 / 1.7) = 0.84, and the greater
    of two such is too great by 0.840 / sqrt(pi) = 0.474. Two tables err independently: by nothing on average.
    """
    settings = {"steps": 20_000, "horizon": 50, "learning_rate": 0.3, "reward_noise": 2.0, "exploration": 1.0}
    _, taken = train(run_of(algorithm, evaluation_episodes=1, **settings))
    told = [estimated_values(checkpoint.arrays["tables"])[LETTERS] - 1 for checkpoint in taken[10:]]
    # 390 nearly independent values that vary by 0.7 or so: a standard error of 0.035 (0.05 of two tables).
    assert np.mean(told) == pytest.approx(excess, abs=0.13)


# --- The mailman's day (thesis Fig. 2.1) ----------------------------------------------------------


def test_a_day_without_slips_goes_as_chosen() -> None:
    env, letters = MailmanEnv(), (LETTERS, 0.0, False)
    days = {
        (GO_ON, GO_ON): [letters, (HOME, 1.0, True)],
        (GO_ON, GO_HOME): [letters, (HOME, 1.0, True)],
        (GO_HOME,): [(HOME, -1.0, True)],
    }
    for actions, day in days.items():
        assert env.reset(seed=0)[0] == POST_OFFICE
        assert [(int(told[0]), told[1], told[2]) for told in map(env.step, map(np.int64, actions))] == day
        with pytest.raises(gymnasium.error.ResetNeeded):
            env.step(np.int64(GO_ON))
