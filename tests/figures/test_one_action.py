"""When runs come to stay in one action, and how much of training they are in it: by hand."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pneuma.analysis.one_action import find_one_action, time_in_one_action, updates_in_one_action
from pneuma.errors import UserError
from pneuma.figures.grid import save_page
from pneuma.figures.shares import one_action_page

from .hand_made import HandMade, words


def test_runs_that_come_to_stay_in_one_action_are_counted_when_they_do(
    tmp_path: Path, figures: list[Figure]
) -> None:
    """Ten evaluations, every 100 steps. Kaplan and Meier by hand: 3 of 4 after step 300, half of these
    after 500, when one run has been lost at 400."""
    study, out, always = HandMade(tmp_path), 0.5, 0.95
    study.fields |= {"horizon": 50, "slots": 1}
    study.add("tanh", 0, evaluations=(), actions=[out] * 2 + [always] * 8)
    study.add("tanh", 1, evaluations=(), actions=[out] * 4 + [always] * 6)
    study.add("tanh", 2, evaluations=(), actions=[always, out] * 5)  # often in it, and never stays
    study.add("tanh", 3, evaluations=(), actions=[out] * 10, status="diverged", end=400)
    answer = find_one_action(study.data)
    save_page(one_action_page(answer), tmp_path, ("svg",))
    left, right = figures[0].axes
    stairs = np.asarray(left.lines[0].get_xydata()).tolist()
    assert stairs == [[0, 1], [300, 0.75], [400, 0.75], [500, 0.375], [1000, 0.375]]
    # the right panel is of training's updates, of which none is in one action
    assert np.asarray(right.lines[0].get_xydata()).tolist() == [[fifth, 0] for fifth in range(1, 6)]
    # of evaluations, run 0: 0 1 1 1 1; run 1: 0 0 1 1 1; run 2: halves; run 3: 0 0, and then lost
    assert answer.tables["time"]["share"].tolist() == pytest.approx([0.125, 0.375, 2.5 / 3, 2.5 / 3, 2.5 / 3])
    assert "over 90 % of an evaluation's steps" in words(figures[0])


def test_each_fifth_has_as_many_evaluations_although_they_follow_whole_updates() -> None:
    """Of twenty evaluations the fourth is at 1,000,448 steps, just past a fifth of 5,000,192."""
    steps = np.array([math.ceil(250_000 * number / 1024) * 1024 for number in range(1, 21)])
    always = np.repeat([1.0, 0.0], [4, 16])
    run: Any = SimpleNamespace(
        evaluation_points=lambda column: (steps, always), update_steps=1024, budget=5_000_192
    )
    study_data: Any = SimpleNamespace(of_condition=lambda condition: [run])
    assert time_in_one_action(study_data, "tanh").runs[0].tolist() == [1, 0, 0, 0, 0]


def test_updates_in_one_action_are_counted_by_fifths_of_the_budget() -> None:
    """Of ten updates of 100 steps the second and the fifth to seventh; another run diverged after three."""
    signs = {"one action": [(200.0, 200.0), (500.0, 700.0)]}
    whole: Any = SimpleNamespace(signs=signs, update_steps=100, end=1000, budget=1000)
    ended: Any = SimpleNamespace(signs=signs, update_steps=100, end=300, budget=1000)
    study_data: Any = SimpleNamespace(of_condition=lambda condition: [whole, ended])
    shares = updates_in_one_action(study_data, "tanh").runs
    assert shares[0].tolist() == [0.5, 0, 1, 0.5, 0]
    np.testing.assert_array_equal(shares[1], [0.5, 0, np.nan, np.nan, np.nan])


def test_one_action_needs_evaluations_of_actions(study: HandMade) -> None:
    with pytest.raises(UserError, match="has no evaluations with commonest_action"):
        find_one_action(study.data)
