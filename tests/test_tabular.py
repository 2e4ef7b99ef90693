"""Q-learning in tables: steps by hand, what noise is overestimated by, and numbers of the table."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

TABULAR = runpy.run_path(str(Path(__file__).parents[1] / "studies/tabular.py"))
POST_OFFICE, LETTERS, HOME = 0, 1, 2
GO_ON, GO_HOME = 0, 1


def test_a_day_goes_as_chosen() -> None:
    go = TABULAR["go"]
    assert go(POST_OFFICE, GO_ON) == (LETTERS, 0.0)
    assert go(POST_OFFICE, GO_HOME) == (HOME, -1.0)
    assert go(LETTERS, GO_ON) == go(LETTERS, GO_HOME) == (HOME, 1.0)


def test_a_step_of_q_learning_by_hand() -> None:
    # Eq. 3.2: 0.5 + 0.9 max(2, 3) - 1 = 2.2. At home nothing follows: 0.5 - 1 = -0.5.
    table = np.array([[[1.0, 0.0], [2.0, 3.0], [9.0, 9.0]]])
    error = TABULAR["temporal_difference"]
    assert error(table, 0, POST_OFFICE, GO_ON, 0.5, LETTERS, 0.9) == pytest.approx(2.2)
    assert error(table, 0, POST_OFFICE, GO_ON, 0.5, HOME, 0.9) == pytest.approx(-0.5)


def test_a_step_of_double_q_learning_by_hand() -> None:
    # Eq. 3.9: table 0 prefers action 1 (3 > 2), which table 1 rates 5: 0.5 + 0.9 x 5 - 1 = 4. Table 1 prefers
    # action 0 (7 > 5), which table 0 rates 2: 0.5 + 0.9 x 2 - 4 = -1.7.
    tables = np.array([[[1.0, 0.0], [2.0, 3.0], [0.0, 0.0]], [[4.0, 0.0], [7.0, 5.0], [0.0, 0.0]]])
    error, estimated_value = TABULAR["temporal_difference"], TABULAR["estimated_value"]
    assert error(tables, 0, POST_OFFICE, GO_ON, 0.5, LETTERS, 0.9) == pytest.approx(4.0)
    assert error(tables, 1, POST_OFFICE, GO_ON, 0.5, LETTERS, 0.9) == pytest.approx(-1.7)
    # What they hold the letters to be worth: the mean of 5 and 2; Q-learning with table 1 alone: 7.
    assert estimated_value(tables, LETTERS) == 3.5
    assert estimated_value(tables[1:], LETTERS) == 7.0


@pytest.mark.parametrize(("tables", "excess"), [(1, 0.474), (2, 0.0)])
def test_noise_is_overestimated_by_one_table_as_much_as_theory_says(tables: int, excess: float) -> None:
    """The letters' two actions pay 1 on average; acting at random, both entries are as noisy and independent.

    An entry of rate a under noise s varies by s sqrt(a / (2 - a)) = 2 sqrt(0.3 / 1.7) = 0.84, and the greater
    of two such is too great by 0.840 / sqrt(pi) = 0.474. Two tables err independently: by nothing on average.
    """
    condition = TABULAR["Condition"](0.3, reward_noise=2.0, tables=tables)
    _, overestimation = TABULAR["train"](condition, seed=0, steps=20_000, exploration=1.0)
    # Some 200 nearly independent values that vary by 0.7 or so: a standard error of 0.05; of two tables 0.07.
    assert overestimation == pytest.approx(excess, abs=0.2)


@pytest.mark.parametrize(
    ("name", "last_return"),
    [("rate-1", 0.952755905511811), ("noisy-double-rate-tenth", 0.6126915267749027)],
)
def test_a_run_is_that_of_the_published_table(name: str, last_return: float) -> None:
    """Of seed 3, as Pneuma's engine for tables had trained it."""
    condition = TABULAR["CONDITIONS"][name]
    assert TABULAR["train"](condition, seed=3)[0] == pytest.approx(last_return)
