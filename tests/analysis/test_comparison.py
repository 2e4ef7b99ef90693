"""Two conditions beside each other, against scipy and by hand."""

from __future__ import annotations

from pathlib import Path

import pytest
from scipy import stats

from pneuma.analysis.comparison import compare_conditions
from pneuma.errors import UserError

from .test_summaries import study

ARMS = {"a": (0.2, 0.4, 0.5, 0.9), "b": (0.1, 0.3, 0.3, 0.45)}


def test_means_their_difference_and_who_is_better(tmp_path: Path) -> None:
    (row,) = compare_conditions(study(tmp_path, ARMS), "a", "b", ["final-share-killed"]).to_dict("records")
    welch = stats.ttest_ind(ARMS["a"], ARMS["b"], equal_var=False).confidence_interval(0.95)
    assert (row["mean_a"], row["mean_b"]) == (pytest.approx(0.5), pytest.approx(0.2875))
    assert row["difference"] == pytest.approx(0.2125)
    assert (row["low"], row["high"]) == (pytest.approx(welch.low), pytest.approx(welch.high))
    assert row["p_better"] == pytest.approx((1 + 3 + 4 + 4) / 16)  # how many of b each of a's runs beats
    assert (row["seeds_a"], row["seeds_b"], row["without_value"]) == (4, 4, 0)


def test_steps_that_never_end_have_no_mean_but_an_order(tmp_path: Path) -> None:
    (row,) = compare_conditions(study(tmp_path, ARMS), "a", "b", ["steps-to:0.5"]).to_dict("records")
    assert row["mean_b"] == float("inf") and row["difference"] != row["difference"]
    assert row["p_better"] == pytest.approx((2 * 4 + 2 * 4 * 0.5) / 16)  # two of a's runs get there


@pytest.mark.parametrize(("b", "words"), [("a", "one condition"), ("c", "unknown condition")])
def test_what_cannot_be_compared_is_refused(tmp_path: Path, b: str, words: str) -> None:
    with pytest.raises(UserError, match=words):
        compare_conditions(study(tmp_path, ARMS), "a", b)
