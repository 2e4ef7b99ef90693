"""One run's curve against examples worked out by hand; what episodes make is in test_curves."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.analysis.series import held_curve, make_grid, update_curve

NAN = float("nan")
GRID = make_grid(200)  # 1, 2, … 200; a twentieth is 10


def _at(curve: np.ndarray, *steps: int) -> list[float]:
    return [float(curve[step - 1]) for step in steps]


def test_updates_are_averaged_over_the_last_twentieth() -> None:
    curve = update_curve(np.array([4.0, 8.0, 12.0]), np.array([1.0, 2.0, 6.0]), GRID, 200)
    np.testing.assert_equal(_at(curve, 3, 4, 8, 12, 14, 18), [NAN, 1, 1.5, 3, 4, 6])  # (4, 14] has two


def test_an_update_stands_for_all_until_the_next() -> None:
    curve = update_curve(np.array([50.0, 100.0]), np.array([1.0, 3.0]), GRID, 150)
    np.testing.assert_equal(_at(curve, 49, 50, 99, 100, 150, 151), [NAN, 1, 1, 3, 3, NAN])


def test_an_update_that_is_not_finite_counts_as_none() -> None:
    """The explained variance of constant returns is NaN, and a diverged run's last loss may be."""
    step, values = np.array([10.0, 15.0, 20.0, 60.0]), np.array([1.0, NAN, 5.0, np.inf])
    curve = update_curve(step, values, GRID, 200)
    np.testing.assert_equal(_at(curve, 15, 19, 20, 60, 200), [1, 1, 5, 5, 5])  # 20: (10, 20] has 20 alone


@pytest.mark.parametrize("huge", [1e17, -1e30])
def test_a_huge_value_is_forgotten_with_its_window(huge: float) -> None:
    """Not kept in a running total, beside which all later values would be nothing."""
    step = np.arange(1.0, 201.0)
    values = np.where(step == 3, huge, 0.5)
    curve = update_curve(step, values, GRID, 200)
    assert curve[20:].tolist() == [0.5] * 180
    assert abs(curve[5]) > 1e15


def test_a_logged_nan_is_a_blank_until_the_next_entry() -> None:
    curve = held_curve(np.array([10.0, 20.0, 30.0]), np.array([1.0, NAN, 2.0]), GRID, 200)
    np.testing.assert_equal(_at(curve, 19, 20, 29, 30), [1, NAN, NAN, 2])
