"""The calibration of the statistics: its parts, and that the committed table is what it prints."""

from __future__ import annotations

import contextlib
import io
import json

import numpy as np
import pytest

from pneuma.analysis import coverage as table
from pneuma.analysis.bands import BANDS
from pneuma.analysis.two_arms import PValues
from pneuma.bench import claim_lists
from pneuma.bench.coverage import band_coverage
from pneuma.cli import main


def test_the_committed_coverages_are_those_that_are_drawn() -> None:
    generator = np.random.default_rng(1)
    for i, seeds in enumerate(table.SEEDS):
        for band, least in table.LEAST_COVERAGE.items():
            samples, near = (1_000, 0.05) if band == "bootstrap" else (3_000, 0.03)
            drawn = [
                band_coverage(band, draw(generator, (samples, seeds)))
                for draw in claim_lists.DISTRIBUTIONS.values()
            ]
            assert min(drawn) == pytest.approx(least[i], abs=near), (band, seeds)


def test_a_t_band_covers_as_theory_says_and_a_range_by_hand() -> None:
    runs = np.random.default_rng(2).normal(size=(20_000, 3))
    assert band_coverage("ci", runs) == pytest.approx(0.95, abs=0.006)
    assert band_coverage("se", runs) == pytest.approx(3**-0.5, abs=0.014)  # of t with 2 degrees, within 1
    assert band_coverage("minmax", runs) == pytest.approx(1 - 2 / 8, abs=0.011)  # not all on one side


def test_between_two_numbers_of_runs_the_lesser_coverage_counts() -> None:
    assert table.coverage("ci", 3) == 0.815
    assert table.coverage("ci", 4) == table.coverage("ci", 5) == table.coverage("ci", 6) == 0.752
    assert table.coverage("ci", 1_000) == table.coverage("ci", 50) == 0.942
    assert table.coverage("ci", 19) == table.coverage("ci", 10) == 0.886
    assert table.is_trusted("ci", 20) and not table.is_trusted("ci", 19)
    assert not table.is_trusted("se", 50)
    assert table.coverage("ci", 2) == 0


def test_only_bands_about_the_mean_claim_to_cover_it() -> None:
    assert {name for name, band in BANDS.items() if band.about_mean} == {*table.LEAST_COVERAGE}
    assert table.coverage("variance", 50) is None and table.is_trusted("minmax", 3)


def test_distributions_have_mean_0_and_deviation_1() -> None:
    generator = np.random.default_rng(3)
    for name in ("normal", "80/20 bimodal"):
        runs = claim_lists.DISTRIBUTIONS[name](generator, (200, 1_000))
        assert runs.mean() == pytest.approx(0, abs=0.01) and runs.std() == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize(
    ("truths", "p", "wrong"),
    [
        (("alike",), (1e-6, 1.0, 1.0), True),
        (("alike",), (1.0, 1e-6, 1.0), True),
        (("alike",), (0.5, 0.5, 1e-6), False),
        (("alike",), (0.01, 0.99, 1.0), False),  # 60 claims: not enough
        (("edge",), (1e-6, 1.0, 1.0), False),
        (("edge",), (0.5, 0.5, 1e-6), True),
        (("far",), (1.0, 1e-6, 1.0), True),
    ],
)
def test_what_counts_as_a_false_verdict(
    monkeypatch: pytest.MonkeyPatch, truths: tuple[str, ...], p: tuple[float, float, float], wrong: bool
) -> None:
    assert _wrong_of_three(monkeypatch, truths, (*p, 1.0, 1.0), "greater") == (3 if wrong else 0)


@pytest.mark.parametrize(
    ("truths", "p", "wrong"),
    [
        (("half",), (1e-6, 1.0, 0.9, 0.9, 1.0), False),  # a difference that counts as none
        (("half",), (1e-6, 1.0, 1.0, 1e-6, 1.0), True),
        (("half",), (0.5, 0.5, 1e-6, 1.0, 1.0), False),
        (("edge",), (0.5, 0.5, 1e-6, 1.0, 1.0), True),
        (("far",), (1e-6, 1.0, 1.0, 1e-6, 1.0), False),
    ],
)
def test_what_counts_as_a_false_verdict_on_equivalence(
    monkeypatch: pytest.MonkeyPatch, truths: tuple[str, ...], p: tuple[float, ...], wrong: bool
) -> None:
    assert _wrong_of_three(monkeypatch, truths, p, "equal") == (3 if wrong else 0)


def _wrong_of_three(
    monkeypatch: pytest.MonkeyPatch, truths: tuple[str, ...], p: tuple[float, ...], claimed: str
) -> int:
    def given(
        kind: str, a: np.ndarray, b: np.ndarray, margin: float, generator: np.random.Generator
    ) -> PValues:
        return PValues(*(np.full(len(a), each) for each in p))

    monkeypatch.setattr(claim_lists, "_p_values", given)
    draw = claim_lists.DISTRIBUTIONS["normal"]
    return claim_lists._wrong_lists(3, draw, 4, claim_lists.Made(truths, claimed), np.random.default_rng(4))


@pytest.mark.slow
@pytest.mark.parametrize("name", claim_lists.DISTRIBUTIONS)
def test_lists_of_ten_seeds_keep_their_error_rate(name: str) -> None:
    draw = claim_lists.DISTRIBUTIONS[name]
    wrong = claim_lists._wrong_lists(400, draw, 10, claim_lists.Made(("alike",)), np.random.default_rng(5))
    known = 0.023  # the greatest of the three that docs/evidence.md has for ten seeds
    assert 0 < wrong / 400 < known + 3 * np.sqrt(known * (1 - known) / 400)


@pytest.mark.slow
def test_the_command_prints_one_document() -> None:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(["bench", "calibration", "--lists", "1", "--json"])
    document = json.loads(out.getvalue())
    assert code == 0 and document["schema"] == 1
    assert {row["seeds"] for row in document["false_verdicts"]} >= {"3", "50", "10/20/40"}
    assert {row["method"] for row in document["coverage"]} > {"ci", "se", "std", "BCa bootstrap"}
