"""When runs come to stay in one action, and how much of training they are in it: by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from pneuma.answers.one_action import find_one_action
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
    study.add("tanh", 0, evaluations=(), actions=[out] * 2 + [always] * 8)
    study.add("tanh", 1, evaluations=(), actions=[out] * 4 + [always] * 6)
    study.add("tanh", 2, evaluations=(), actions=[always, out] * 5)  # often in it, and never stays
    study.add("tanh", 3, evaluations=(), actions=[out] * 10, status="diverged", end=400)
    save_page(one_action_page(find_one_action(study.data)), tmp_path, ("svg",))
    left, right = figures[0].axes
    stairs = np.asarray(left.lines[0].get_xydata()).tolist()
    assert stairs == [[0, 1], [300, 0.75], [400, 0.75], [500, 0.375], [1000, 0.375]]
    fifths = np.asarray(right.lines[0].get_xydata())
    assert fifths[:, 0].tolist() == [1, 2, 3, 4, 5]
    # run 0: 0 1 1 1 1; run 1: 0 0 1 1 1; run 2: halves; run 3: 0 0, and then lost
    assert fifths[:, 1].tolist() == pytest.approx([0.125, 0.375, 2.5 / 3, 2.5 / 3, 2.5 / 3])
    assert "over 90 % of an evaluation's steps" in words(figures[0])


def test_one_action_needs_evaluations_of_actions(study: HandMade) -> None:
    with pytest.raises(UserError, match="has no evaluations with commonest_action"):
        find_one_action(study.data)
