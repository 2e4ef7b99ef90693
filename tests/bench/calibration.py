"""Calibration: how often a list of claims has a false verdict, and how often intervals cover.

Lists of claims whose truth is known are simulated and judged by the code that judges claims. The arms of a
claim are equal, or differ by half the margin (which counts as no difference), by exactly the margin (where a
false verdict of equivalence is most likely), or by much more. docs/evidence.md has the results.

    python -m tests.bench.calibration [LISTS]
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import comb
from typing import Any

import numpy as np
from scipy import special

from pneuma.analysis import intervals, pvalues
from pneuma.analysis.contrasts import Contrast
from pneuma.analysis.curves import BANDS
from pneuma.analysis.intervals import mean
from pneuma.analysis.judgement import INCONCLUSIVE, decide, significant_direction
from pneuma.analysis.pvalues import ManyPValues, PValues
from pneuma.cli.output import print_result, rows_result

SEEDS = (3, 5, 10, 20, 50)
CLAIMS = {"mean": 50, "incidence": 10}
"""Claims of each kind in a list."""
MEANS = {"mean": 60}
ONE_ARM = {"one mean": 30, "one share": 30}
MARGINS = {"mean": 0.5, "incidence": 0.2, "one mean": 0.5, "one share": 0.2}
"""Margins of means, in standard deviations."""
FAR = {"mean": 2.0, "incidence": 0.7, "one mean": 2.0, "one share": 0.7}
"""Effects of claims that are far apart."""
FOUND_EQUAL = 4.5
"""Standard errors to the margin at which most of 60 claims are found equivalent, and the others look large:
where a correction that steps down over what was found is furthest off."""
EVENT_SHARE = 0.2
FEWER = 4
"""Lists whose arms are not all alike are simulated so many times more rarely."""

ROUNDS = ((400, 60, 1.0), (3_000, 10, 0.1), (20_000, 10, 0.01))
"""Relabelings drawn, samples that share them, and the greatest p-value of the round before by which a sample
is tested again by more: no greater one can come to a verdict, and the least that counts is 4e-4. So few share
one set of many that lists are as good as independent."""
TRUE_FINDINGS = {"alike": ("equal",), "edge": ("greater",), "far": ("greater",)}
"""Verdicts on each truth that are not false."""
TRUE_OF_EQUAL = {"alike": "supported", "half": "supported", "edge": "refuted", "far": "refuted"}
"""Verdicts on claims of equivalence that are not false."""

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]


def _bimodal(generator: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Draw runs of which four fifths lie around 10 and one fifth, which failed, around 2."""
    values = np.where(generator.random(shape) < 0.8, 10.0, 2.0) + generator.normal(size=shape)
    return (values - 8.4) / np.sqrt(1 + 0.16 * 64)


DISTRIBUTIONS: dict[str, Draw] = {
    "normal": lambda generator, shape: generator.normal(size=shape),
    "80/20 bimodal": _bimodal,
    "t, 3 degrees": lambda generator, shape: generator.standard_t(3, size=shape) / np.sqrt(3),
}
"""Distributions with mean 0 and standard deviation 1."""


@dataclass(frozen=True)
class Setting:
    """How the claims of a list are simulated.

    Attributes:
        truths: the differences of the arms, in turn: alike, half, edge or far.
        claimed: the direction of all claims.
        sizes: number of claims of each kind.
        errors: the margin of means in standard errors of the difference; None: that of `MARGINS`.
        spread: standard deviation of the first arm of means, divided by the second's.
    """

    truths: tuple[str, ...]
    claimed: str = "greater"
    sizes: Mapping[str, int] = field(default_factory=lambda: CLAIMS)
    errors: float | None = None
    spread: float = 1.0

    def margin(self, kind: str, seeds: int) -> float:
        """Return the margin of a kind of claim."""
        return MARGINS[kind] if self.errors is None else self.errors * float(np.sqrt(2 / seeds))

    def truths_of(self, size: int) -> list[str]:
        """Return the truth of each of `size` claims."""
        return [self.truths[i % len(self.truths)] for i in range(size)]


MIXED = ("alike", "edge", "far")
SETTINGS = {
    "alike": Setting(("alike",)),
    "at the margin": Setting(("edge",)),
    "mixed": Setting(MIXED),
    "no difference, alike": Setting(("alike",), "equal"),
    "no difference, half": Setting(("half",), "equal"),
    "no difference, mixed": Setting(("half", "edge", "far"), "equal"),
    "one arm, alike": Setting(("alike",), sizes=ONE_ARM),
    "one arm, at the margin": Setting(("edge",), sizes=ONE_ARM),
    "one arm, mixed": Setting(MIXED, sizes=ONE_ARM),
    "alike, of 4.5 errors": Setting(("alike",), sizes=MEANS, errors=FOUND_EQUAL),
    "at the margin, of 4.5 errors": Setting(("edge",), sizes=MEANS, errors=FOUND_EQUAL),
    "alike, spread x 3": Setting(("alike",), sizes=MEANS, spread=3.0),
    "alike, spread x 10": Setting(("alike",), sizes=MEANS, spread=10.0),
}


def bench_calibration(lists: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield rows of two tables as they come: ("coverage", row), then ("false_verdicts", row).

    Args:
        lists: number of simulated lists in each setting, each of which has a random generator of its own.
    """
    for row in coverages(lists * 10, np.random.default_rng(0)):
        yield "coverage", row
    for i, (truth, setting) in enumerate(SETTINGS.items()):
        generator = np.random.default_rng([0, i])
        count = lists if truth == "alike" else max(1, lists // FEWER)
        for name, draw in DISTRIBUTIONS.items():
            for seeds in SEEDS:
                wrong = wrong_lists(count, draw, seeds, setting, generator)
                row = {"truth": truth, "distribution": name, "seeds": str(seeds), "lists": count}
                upper = intervals.incidence_interval(wrong, count, level=0.9).high  # one-sided, 95 %
                yield "false_verdicts", {**row, "false_rate": wrong / count, "upper_bound": upper}


# --- Lists of claims ---------------------------------------------------------------------------------

Arms = dict[str, tuple[np.ndarray, np.ndarray]]
"""Both arms of all claims of many lists, by kind, (lists * claims, seeds)."""


def wrong_lists(lists: int, draw: Draw, seeds: int, setting: Setting, generator: np.random.Generator) -> int:
    """Return how many of `lists` lists have a false verdict."""
    arms = _make_arms(lists, draw, seeds, setting, generator)
    wrong = np.zeros(lists, dtype=bool)
    nowhere, size = intervals.no_interval(), sum(setting.sizes.values())
    for kind, (a, b) in arms.items():
        truths = setting.truths_of(setting.sizes[kind])
        p = p_of_kind(kind, a, b, setting.margin(kind, seeds), generator)
        for row, p_of_claim in enumerate(zip(*p, strict=True)):
            contrast = Contrast(0.0, nowhere, PValues(*p_of_claim), (seeds, seeds))
            verdict, _ = decide(contrast, setting.claimed, size)
            place, claim = divmod(row, len(truths))
            wrong[place] |= is_false(verdict, contrast, truths[claim], setting.claimed)
    return int(wrong.sum())


def is_false(verdict: str, contrast: Contrast, truth: str, claimed: str) -> bool:
    """Return whether a verdict is false."""
    if verdict == INCONCLUSIVE:
        return False
    if claimed == "equal":
        return verdict != TRUE_OF_EQUAL[truth]
    return significant_direction(contrast) not in TRUE_FINDINGS[truth]


def _make_arms(lists: int, draw: Draw, seeds: int, setting: Setting, generator: np.random.Generator) -> Arms:
    arms: Arms = {}
    for kind, size in setting.sizes.items():
        margin = setting.margin(kind, seeds)
        effects = {"alike": 0.0, "half": margin / 2, "edge": margin, "far": FAR[kind]}
        each = np.tile([effects[truth] for truth in setting.truths_of(size)], lists)[:, None]
        shape = (lists * size, seeds)
        narrow = np.sqrt(2 / (1 + setting.spread**2))  # the standard error of the difference stays the same
        if kind in ("incidence", "one share"):
            arms[kind] = generator.random(shape) < EVENT_SHARE + each, generator.random(shape) < EVENT_SHARE
        else:
            wide = setting.spread * narrow * draw(generator, shape) + each
            arms[kind] = wide, narrow * draw(generator, shape)
    return arms


def p_of_kind(
    kind: str, a: np.ndarray, b: np.ndarray, margin: float, generator: np.random.Generator
) -> ManyPValues:
    """Return p-values of claims of one kind, each (samples,); those with one arm ignore b."""
    seeds = a.shape[1]
    if kind == "incidence":
        return pvalues.incidence_p_values(a.sum(axis=1), seeds, b.sum(axis=1), seeds, margin)
    if kind == "one share":
        return pvalues.one_share_p_values(a.sum(axis=1), seeds, EVENT_SHARE, margin)
    p = np.zeros((len(PValues._fields), len(a)))
    for draws, together, close in ROUNDS:
        again = np.flatnonzero(np.minimum(2 * np.minimum(p[0], p[1]), p[2]) <= close)
        if not len(again):
            break
        for rows in np.split(again, range(together, len(again), together)):
            if kind == "one mean":
                flips = pvalues.sign_flips(seeds, generator, draws)
                p[:, rows] = pvalues.one_mean_p_values(a[rows], margin, flips)
                exact = len(flips) == 2**seeds
            else:
                labels = pvalues.relabel(seeds, seeds, generator, draws)
                p[:, rows] = pvalues.mean_p_values(a[rows], b[rows], margin, labels)
                exact = len(labels) == comb(2 * seeds, seeds)
        if exact:
            break
    return PValues(*p)


# --- Intervals and bands ---------------------------------------------------------------------------


def coverages(samples: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield how often each interval, or band of a figure, covers the truth.

    Args:
        samples: number of simulated bands; a twentieth of it for slow methods.
        generator: draws the runs.
    """
    fewer = max(1, samples // 20)
    bands = [name for name, band in BANDS.items() if band.edges]
    one_by_one = [
        ("BCa bootstrap", lambda runs: intervals.bootstrap_interval(runs, mean, generator), 0.0),
        ("deviation", intervals.deviation_interval, 1.0),
    ]
    for name, draw in DISTRIBUTIONS.items():
        for seeds in SEEDS:
            runs = draw(generator, (samples, seeds))
            for band in bands:
                yield _covered(band, name, seeds, band_coverage(band, runs))
            for method, interval, truth in one_by_one:
                made = [each for each in map(interval, runs[:fewer]) if each.exists]
                share = np.mean([each.low <= truth <= each.high for each in made]) if made else np.nan
                yield _covered(method, name, seeds, float(share))
    for seeds in SEEDS:
        count = np.arange(seeds + 1)
        chance = special.comb(seeds, count) * EVENT_SHARE**count * (1 - EVENT_SHARE) ** (seeds - count)
        made = [intervals.incidence_interval(int(k), seeds) for k in count]
        covering = [each.low <= EVENT_SHARE <= each.high for each in made]
        yield _covered("Clopper-Pearson", f"share {EVENT_SHARE}", seeds, float(chance @ covering))


def _covered(method: str, distribution: str, seeds: int, share: float) -> dict[str, Any]:
    return {"method": method, "distribution": distribution, "seeds": seeds, "coverage": share}


def band_coverage(band: str, runs: np.ndarray) -> float:
    """Return how often a figure's band covers the mean 0 of (samples, runs)."""
    edges = BANDS[band].edges
    assert edges
    low, high = edges(runs.T)
    return float(((low <= 0) & (high >= 0)).mean())


def main(lists: int = 2000) -> None:
    tables: dict[str, list[dict[str, Any]]] = {"coverage": [], "false_verdicts": []}
    for table, row in bench_calibration(lists):
        tables[table].append(row)
    for table, rows in tables.items():
        print_result(rows_result(table, rows), "table")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
