"""What planned seeds can decide (`study verify --design`), against textbook formulas and real intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.claims.design import ContrastDesign, design_contrast
from pneuma.analysis.intervals import incidence_interval

from ..cli.calls import described, printed, refused
from .claim_files import changed, write_files

EVENT = (('outcome = "final-share-killed"', 'outcome = "collapsed"\nabove = 0.5'), ('"mean"', '"incidence"'))


def plan_of(folder: Path, *changes: tuple[str, str], seeds: int | str = 50) -> ContrastDesign:
    text = changed(*changes).replace("seeds = 8", f"seeds = {seeds}")
    claim_list = load_claims(write_files(folder, text))
    (planned,) = claim_list.contrasts_of(claim_list.claims["better"], "text")
    return design_contrast(planned)


def test_the_half_width_of_means_is_welchs(tmp_path: Path) -> None:
    """sqrt(2 / 50) times Student's quantile; 8 runs against 50 have Welch's degrees of freedom."""
    plan = plan_of(tmp_path)
    assert (plan.alpha, plan.seeds, plan.margin, plan.reason) == (0.05, (50, 50), 0.04, "")
    assert plan.half_width == pytest.approx(0.2 * stats.t.ppf(0.975, 98))
    assert plan.largest_sd == pytest.approx(0.04 / plan.half_width)
    unlike = plan_of(tmp_path, seeds="{ high = 8, low = 50 }")
    parts = np.array([1 / 8, 1 / 50])
    freedom = parts.sum() ** 2 / (parts**2 / [7, 49]).sum()
    assert unlike.half_width == pytest.approx(np.sqrt(parts.sum()) * stats.t.ppf(0.975, freedom))


def test_a_share_is_planned_by_the_interval_of_its_expected_count(tmp_path: Path) -> None:
    """Of a constant that is the count which it expects; else half of the runs have the event."""
    plan = plan_of(tmp_path, *EVENT, ('b = "low"', "value = 0.2"))
    interval = incidence_interval(10, 50)
    assert plan.half_width == pytest.approx((interval.high - interval.low) / 2)
    assert (plan.margin, plan.reason) == (None, "")
    plan = plan_of(tmp_path, *EVENT, ("margin = 0.04", "margin = 0.1"))
    assert plan.reason == f"100 runs tell it to ±{plan.half_width:.3g} only" and np.isnan(plan.largest_sd)
    assert plan_of(tmp_path, *EVENT, ("margin = 0.04", "margin = 0.3")).reason == ""


def test_a_range_is_known_less_well_than_a_difference(tmp_path: Path) -> None:
    """Two steps either way: a fourth of the error rate on each side is an eighth of it."""
    ladder = ('a = "high"', 'a = ["high", "low"]'), ('b = "low"', "value = 0"), ('"mean"', '"range"')
    low = 0.2 * stats.t.ppf(1 - 0.0125, 98)  # of the greatest of two steps
    high = 0.2 * stats.t.ppf(0.975, 98)  # all steps must be smaller
    assert plan_of(tmp_path, *ladder).half_width == pytest.approx((low + high) / 2)


def test_of_a_hazard_the_logarithm_is_planned(tmp_path: Path) -> None:
    """Half of 100 runs get there; by each event about a quarter of a run's variance: 1.96 / sqrt(50 / 4)."""
    hazard = ('"final-share-killed"', '"steps-to:0.1"'), ('"mean"', '"hazard"')
    assert plan_of(tmp_path, *hazard).half_width == pytest.approx(1.96 / np.sqrt(12.5), rel=0.02)


def test_groups_that_show_no_spread_decide_nothing(tmp_path: Path) -> None:
    """Two runs are always equally far from their median, and one run is alone."""
    assert "equally far" in plan_of(tmp_path, ('"mean"', '"spread"'), seeds=2).reason
    assert "at least 2 runs" in plan_of(tmp_path, seeds=1).reason


def test_the_command_prints_it_before_there_is_any_run(tmp_path: Path) -> None:
    """A second claim halves what each may err, also if one alone is selected."""
    own = changed().replace("seeds = 8", "seeds = 50")
    path = write_files(tmp_path, own + own[own.index("[claims.better]") :].replace("better", "again"))
    words = ("study", "verify", "--design", "--claims", path, "--results", tmp_path / "results")
    half_width = 0.2 * stats.t.ppf(1 - 0.025 / 2, 98)
    (row,) = described(*words, "better", "--json")["design"]
    assert row == {
        "claim": "better", "world": "text", "outcome": "final-share-killed", "a": "high", "b": "low",
        "seeds": [50, 50], "alpha": 0.025, "half_width": pytest.approx(half_width), "margin": 0.04,
        "largest_sd": pytest.approx(0.04 / half_width), "reason": "",
    }  # fmt: skip
    lines = printed(*words).splitlines()
    assert [line.split()[0] for line in lines[1:3]] == ["better", "again"]
    assert " ".join(lines[1].split()[3:]) == "50/50 0.455 SD 0.04 with an SD up to 0.0879"
    assert "unknown claim 'bettr'" in refused(*words, "bettr")
    assert not (tmp_path / "results").exists()


def test_what_is_planned_is_what_is_judged() -> None:
    """Of all shipped claims, with the same corrections."""
    judged = []
    for claim in described("study", "verify", "--json")["claims"]:
        judged += claim["contrasts"]
    planned = described("study", "verify", "--design", "--json")["design"]
    keys = ("claim", "world", "outcome", "a", "alpha", "margin")
    assert [[row[key] for key in keys] for row in planned] == [[row[key] for key in keys] for row in judged]
