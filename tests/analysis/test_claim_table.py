"""The design check: how near so many seeds tell an effect, against textbook formulas and real intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.claims.table import ClaimContrast, plan_contrasts
from pneuma.analysis.intervals import incidence_interval
from pneuma.study.store import Store

from .claim_files import HIGH, LOW, changed, judge_one, save_runs, write_files

PILOT = """
[pilot]
command = "pneuma study summary mine --seeds 50,51"
[pilot.spreads.text]
final-share-killed = 0.1
"collapsed above 0.5" = 0.1
"""
INCIDENCE = (
    ('outcome = "final-share-killed"', 'outcome = "collapsed"\nabove = 0.5'),
    ('"mean"', '"incidence"'),
    ('b = "low"', "value = 0.2"),
)  # fmt: skip


def plan_of(folder: Path, *changes: tuple[str, str], seeds: int | str = 50) -> ClaimContrast:
    text = changed(*changes).replace("seeds = 8", f"seeds = {seeds}") + PILOT
    (plan,) = plan_contrasts(load_claims(write_files(folder, text)))
    return plan


def test_the_half_width_of_means_is_welchs(tmp_path: Path) -> None:
    """0.1 sqrt(2 / 50) times Student's quantile; 8 runs against 50 have Welch's degrees of freedom."""
    plan = plan_of(tmp_path)
    assert (plan.alpha, plan.planned, plan.spread, plan.margin) == (0.05, (50, 50), 0.1, 0.04)
    assert plan.half_width == pytest.approx(0.02 * stats.t.ppf(0.975, 98)) and plan.why_undecidable == ""
    unlike = plan_of(tmp_path, seeds="{ high = 8, low = 50 }")
    parts = np.array([0.01 / 8, 0.01 / 50])
    freedom = parts.sum() ** 2 / (parts**2 / [7, 49]).sum()
    assert unlike.half_width == pytest.approx(np.sqrt(parts.sum()) * stats.t.ppf(0.975, freedom))


def test_a_half_width_beyond_the_margin_decides_nothing(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, seeds=8)
    assert plan.why_undecidable == "16 runs tell it to ±0.107 only, and the margin is 0.04"
    assert plan_of(tmp_path, ("margin = 0.04", "margin = 0.2"), seeds=8).why_undecidable == ""
    own = plan_of(tmp_path, ("margin = 0.04", "margin = 0.04\nspread = 0.01"), seeds=8)
    assert (own.spread, own.why_undecidable) == (0.01, "")  # of the claim's own arms


def test_a_share_is_planned_by_the_interval_of_its_expected_count(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, *INCIDENCE, ("margin = 0.04", "margin = 0.1"))
    interval = incidence_interval(5, 50)
    assert plan.half_width == pytest.approx((interval.high - interval.low) / 2)


def test_a_range_is_known_less_well_than_a_difference(tmp_path: Path) -> None:
    """Two steps either way: a fourth of the error rate on each side is an eighth of it."""
    ladder = ('a = "high"', 'a = ["high", "low"]'), ('b = "low"', "value = 0.3"), ('"mean"', '"range"')
    plan = plan_of(tmp_path, *ladder)
    difference = plan_of(tmp_path).half_width
    assert plan.half_width is not None and difference is not None and plan.half_width > difference
    low = 0.02 * stats.t.ppf(1 - 0.0125, 98)  # of the greatest of two steps
    high = 0.02 * stats.t.ppf(0.975, 98)  # all steps must be smaller
    assert plan.half_width == pytest.approx((low + high) / 2)


def test_a_claim_that_cannot_be_decided_is_not_admitted(store: Store, tmp_path: Path) -> None:
    """Though its runs are there; of two outcomes one is enough."""
    text = changed(('"final-share-killed"', '["final-share-killed", "final-return"]')) + PILOT
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    one = judge_one(store, tmp_path, text)
    assert one.verdict == "untestable"
    assert one.reason.startswith("not admitted: 16 runs tell it to ±")
    assert one.reason.endswith("; no pilot has a spread of final-return")
    enough = text.replace("[pilot.spreads.text]", "[pilot.spreads.text]\nfinal-return = 0.01")
    assert not any(row.refused for row in plan_contrasts(load_claims(write_files(tmp_path, enough))))


def test_arms_that_show_no_spread_decide_nothing(tmp_path: Path) -> None:
    """Two runs are always equally far from their median, and one run is alone."""
    spread = ('"mean"', '"spread"')
    assert "equally far" in plan_of(tmp_path, spread, seeds=2).why_undecidable
    assert "at least 2 runs" in plan_of(tmp_path, seeds=1).why_undecidable
    needed = ('"final-share-killed"', '["final-share-killed", "final-return"]')
    text = changed(needed, ('"greater"', '"greater"\nneed = "all"'), ("margin = 0.04", "margin = 0.2"))
    refused = {row.refused for row in plan_contrasts(load_claims(write_files(tmp_path, text + PILOT)))}
    assert refused == {"no pilot has a spread of final-return"}  # one that can be decided is not enough
