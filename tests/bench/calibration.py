"""Calibration: how often a list of claims has a false verdict, and how often intervals cover.

Lists of claims whose truth is known are simulated and judged by the code that judges claims. The arms of a
claim are equal, or differ by half the margin (which counts as no difference), by exactly the margin (where a
false verdict of equivalence is most likely), or by much more. docs/claims.md has the results.

    python -m tests.bench.calibration [LISTS]           # all tables: about an hour with 400 lists
    python -m tests.bench.calibration limits            # those of what a verdict rests on: some minutes
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy import special, stats

from pneuma.analysis import EDGED_BANDS, intervals
from pneuma.analysis.claims.contrasts import compare
from pneuma.analysis.claims.verdicts import decide
from pneuma.analysis.curves import Curve
from pneuma.analysis.environments import AGGREGATES, bootstrap
from pneuma.analysis.intervals import mean
from pneuma.cli.output import print_result, rows_result

SEEDS = (5, 10, 30)
ALPHA = 0.05
CLAIMS = {"mean": 30, "spread": 10, "incidence": 10}
"""Claims of each kind in a list."""
MEANS = {"mean": 50}
ONE_ARM = {"one mean": 25, "one share": 25}
SHARES = ("incidence", "one share")
EVENT_SHARE = 0.2
ERRORS = 4.5
"""Standard errors to the margin of means: at which about half of arms that are alike are found to be."""
SHARE_MARGIN, FAR_SHARE, FAR = 0.4, 0.7, 3.0
"""Of shares: the margin, and claims that are far apart; of means these are so many margins apart."""

Draw = Callable[[np.random.Generator, int], np.ndarray]


def _bimodal(generator: np.random.Generator, runs: int) -> np.ndarray:
    """Draw runs of which four fifths lie around 10 and one fifth, which failed, around 2."""
    values = np.where(generator.random(runs) < 0.8, 10.0, 2.0) + generator.normal(size=runs)
    return (values - 8.4) / np.sqrt(1 + 0.16 * 64)


DISTRIBUTIONS: dict[str, Draw] = {
    "normal": lambda generator, runs: generator.normal(size=runs),
    "80/20": _bimodal,
    "t, 3 degrees": lambda generator, runs: generator.standard_t(3, size=runs) / np.sqrt(3),
    "two values": lambda generator, runs: np.where(generator.random(runs) < 0.5, -1.0, 1.0),
}
"""Distributions with mean 0 and standard deviation 1."""


@dataclass(frozen=True)
class Setting:
    """How the claims of a list are simulated.

    Attributes:
        truths: the differences of the arms, in turn: alike, half, edge or far.
        claimed: the direction of all claims.
        sizes: number of claims of each kind.
        spread: standard deviation of the first arm of means, divided by the second's.
        fewer: runs of the first arm, divided by the second's.
    """

    truths: tuple[str, ...]
    claimed: str = "greater"
    sizes: Mapping[str, int] = field(default_factory=lambda: CLAIMS)
    spread: float = 1.0
    fewer: int = 1


SETTINGS = {
    "alike": Setting(("alike",)),
    "at the margin": Setting(("edge",), sizes={"mean": 40, "incidence": 10}),
    "no difference, half a margin": Setting(("half",), "equal", MEANS),
    "no difference, at the margin": Setting(("edge",), "equal", {"mean": 40, "incidence": 10}),
    "one arm, alike": Setting(("alike",), sizes=ONE_ARM),
    "one arm, at the margin": Setting(("edge",), sizes=ONE_ARM),
    "alike, spread x 3": Setting(("alike",), sizes=MEANS, spread=3.0),
    "alike, a third of the runs": Setting(("alike",), sizes=MEANS, fewer=3),
}
FALSE = {
    ("alike", "greater"): ("supported",), ("edge", "greater"): ("refuted",), ("far", "greater"): ("refuted",),
    ("alike", "equal"): ("refuted",), ("half", "equal"): ("refuted",), ("edge", "equal"): ("supported",),
    ("far", "equal"): ("supported",),
}  # fmt: skip
"""False verdicts on a claim, by its truth and direction; where arms are alike `less` is false as well."""


def bench_calibration(lists: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield rows of two tables as they come: ("coverage", row), then ("false_verdicts", row).

    Args:
        lists: number of simulated lists in each setting, each of which has a random generator of its own.
    """
    for row in coverages(lists * 10, np.random.default_rng(0)):
        yield "coverage", row
    for i, (truth, setting) in enumerate(SETTINGS.items()):
        generator = np.random.default_rng([0, i])
        for name, draw in DISTRIBUTIONS.items():
            for seeds in SEEDS:
                wrong = sum(is_wrong(draw, seeds, setting, generator) for _ in range(lists))
                row = {"truth": truth, "distribution": name, "seeds": str(seeds), "lists": lists}
                upper = intervals.incidence_interval(wrong, lists, level=0.9).high  # one-sided, 95 %
                yield "false_verdicts", {**row, "false_rate": wrong / lists, "upper_bound": upper}


# --- Lists of claims ---------------------------------------------------------------------------------


def is_wrong(draw: Draw, seeds: int, setting: Setting, generator: np.random.Generator) -> bool:
    """Simulate a list; return whether any of its verdicts is false."""
    contrasts, wrong = sum(setting.sizes.values()), False
    for kind, size in setting.sizes.items():
        for place in range(size):
            truth = setting.truths[place % len(setting.truths)]
            a, b, margin = make_arms(kind, truth, draw, seeds, setting, generator)
            told = verdicts(kind, a, b, margin, setting.claimed, 1 - ALPHA / contrasts)
            wrong |= told[0] in FALSE[truth, setting.claimed]
            wrong |= truth == "alike" and told[1] == "supported"
    return wrong


def verdicts(
    kind: str, a: np.ndarray, b: np.ndarray | float, margin: float, claimed: str, level: float
) -> list[str]:
    """Return the verdict in the claimed direction, and in `less`."""
    plain = {"one mean": "mean", "one share": "incidence"}.get(kind, kind)
    ends = compare(plain, a, b, level).simultaneous
    return [decide(ends, claimed, margin), decide(ends, "less", None)]


def make_arms(
    kind: str, truth: str, draw: Draw, seeds: int, setting: Setting, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray | float, float]:
    """Return the two arms of a claim, or one and a constant, and its margin."""
    few, alone = max(seeds // setting.fewer, 2), kind.startswith("one")
    if kind in SHARES:
        effect = {"alike": 0.0, "half": SHARE_MARGIN / 2, "edge": SHARE_MARGIN, "far": FAR_SHARE}[truth]
        a = (generator.random(few) < EVENT_SHARE + effect) * 1.0
        b: np.ndarray | float = EVENT_SHARE if alone else (generator.random(seeds) < EVENT_SHARE) * 1.0
        return a, b, SHARE_MARGIN
    margin = ERRORS * float(np.sqrt(1 / few + (0 if alone else setting.spread**-2 / seeds)))
    effect = {"alike": 0.0, "half": margin / 2, "edge": margin, "far": FAR * margin}[truth]
    a = draw(generator, few) + effect
    return a, 0.0 if alone else draw(generator, seeds) / setting.spread, margin


# --- Where intervals promise too much ------------------------------------------------------------------

STRICT = 0.0015
"""About the error rate of one contrast in a list of 33."""
NOISE = 0.05
"""The deviation of runs around what they all come to."""


def failing_arms(samples: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield how often arms of equal means differ, of which one has all runs near 0.8.

    Of the other four fifths end near 1, and one fifth fails and ends near 0.
    """
    for seeds in (10, 30):
        found = 0
        for _ in range(samples):
            failing = 1.0 * (generator.random(seeds) < 0.8) + NOISE * generator.normal(size=seeds)
            sound = 0.8 + NOISE * generator.normal(size=seeds)
            ends = compare("mean", failing, sound, 1 - STRICT).simultaneous
            found += ends.low > 0 or ends.high < 0
        yield {"runs an arm": seeds, "nominal": STRICT, "found different": found / samples}


def far_shares() -> Iterator[dict[str, Any]]:
    """Yield how often the interval of a difference of shares misses it at worst, summed over all tables."""
    for seeds in SEEDS:
        counts = np.arange(seeds + 1)
        for alpha in (ALPHA, STRICT):
            contrasts = [
                [
                    intervals.incidence_difference_interval(int(a), seeds, int(b), seeds, 1 - alpha)
                    for b in counts
                ]
                for a in counts
            ]
            low = np.array([[ends.low for ends in row] for row in contrasts])
            high = np.array([[ends.high for ends in row] for row in contrasts])
            for name, gaps in SHARES_APART.items():
                worst = 0.0
                for apart in gaps:
                    misses = (low > apart) | (high < apart)
                    for share in np.linspace(0, 1 - apart, 21):
                        chance = np.outer(
                            stats.binom.pmf(counts, seeds, share + apart),
                            stats.binom.pmf(counts, seeds, share),
                        )
                        worst = max(worst, float(chance[misses].sum()))
                yield {"runs an arm": seeds, "nominal": alpha, "shares apart": name, "missed at most": worst}


SHARES_APART = {
    "up to 0.6": np.linspace(0, 0.6, 25),
    "0.6 to 0.9": np.linspace(0.6, 0.9, 13),
    "over 0.9": np.linspace(0.9, 1, 21)[1:-1],
}


def bootstrap_over_environments(samples: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield how often 95 % bootstrap intervals of a mean score over environments cover it, of normal runs."""
    mean_score = AGGREGATES["mean"]
    for seeds in (3, 5, 10):
        for environments in (1, 2, 5):
            covered = 0
            for _ in range(samples):
                runs = list(generator.normal(size=(environments, seeds)))
                low, high = bootstrap(mean_score, runs, resamples=1_000)
                covered += low <= 0 <= high
            yield {"runs": seeds, "environments": environments, "coverage": covered / samples}


# --- Intervals and bands ---------------------------------------------------------------------------


def coverages(samples: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield how often each interval, or band of a figure, covers the truth.

    Args:
        samples: number of simulated bands; a twentieth of it for slow methods.
        generator: draws the runs.
    """
    fewer = max(1, samples // 20)
    bands = EDGED_BANDS[:1] + EDGED_BANDS[2:]  # of which two are one
    one_by_one = [
        ("BCa bootstrap", lambda runs: intervals.bootstrap_interval(runs, mean, generator), 0.0),
        ("deviation", intervals.deviation_interval, 1.0),
    ]
    for name, draw in DISTRIBUTIONS.items():
        for seeds in SEEDS:
            runs = draw(generator, samples * seeds).reshape(samples, seeds)
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
    """Return how often a figure's band covers the mean 0 of (samples, runs); NaN for too few runs."""
    frame = Curve("", pd.DataFrame(runs)).frame(band).dropna()
    return float(((frame["low"] <= 0) & (frame["high"] >= 0)).mean())


def main(lists: int = 400) -> None:
    tables: dict[str, list[dict[str, Any]]] = {"coverage": [], "false_verdicts": []}
    for table, row in bench_calibration(lists):
        tables[table].append(row)
    for table, rows in tables.items():
        print_result(rows_result(table, rows), "table")


def print_limits() -> None:
    generator = np.random.default_rng(1)
    tables = {
        "failing_arms": failing_arms(20_000, generator),
        "far_shares": far_shares(),
        "bootstrap_over_environments": bootstrap_over_environments(4_000, generator),
    }
    for table, rows in tables.items():
        print_result(rows_result(table, list(rows)), "table")


if __name__ == "__main__":
    if sys.argv[1:] == ["limits"]:
        print_limits()
    else:
        main(*map(int, sys.argv[1:]))
        print_limits()
