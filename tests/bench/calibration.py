"""Calibration: how often a list of claims has a false verdict, and what intervals of few runs miss.

Lists of claims whose truth is known are simulated and judged by the code that judges claims. The arms of a
claim are equal, or differ by exactly the margin. docs/claims.md has the results.

    python -m tests.bench.calibration [LISTS]           # all tables: about half an hour with 400 lists
    python -m tests.bench.calibration limits            # those of what a verdict rests on: some minutes
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from pneuma.analysis import intervals
from pneuma.analysis.claims.verdicts import decide
from pneuma.analysis.curves import Curve
from pneuma.analysis.environments import AGGREGATES, bootstrap
from pneuma.cli.output import print_result, rows_result

from ..analysis.two_groups import compare

SEEDS = (5, 10, 30)
ALPHA = 0.05
CLAIMS = {"mean": 30, "spread": 10, "incidence": 10}
"""Claims of each kind in a list."""
MEANS = {"mean": 50}
EVENT_SHARE = 0.2
ERRORS = 4.5
"""Standard errors to the margin of means: at which about half of arms that are alike are found to be."""
SHARE_MARGIN = 0.4
SPREAD_MARGIN = float(np.log(1.5))

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
    """How the claims of a list, all in the direction `greater`, are simulated.

    Attributes:
        stream: number of the random generator.
        is_at_margin: whether the arms of each claim differ by its margin; otherwise they are equal.
        sizes: number of claims of each kind.
        spread: standard deviation of the first arm of means, divided by the second's.
        fewer: runs of the first arm, divided by the second's.
    """

    stream: int
    is_at_margin: bool
    sizes: Mapping[str, int]
    spread: float = 1.0
    fewer: int = 1


SETTINGS = {
    "alike": Setting(0, False, CLAIMS),
    "at the margin": Setting(1, True, {"mean": 40, "incidence": 10}),
    "alike, spread x 3": Setting(6, False, MEANS, spread=3.0),
    "alike, a third of the runs": Setting(7, False, MEANS, fewer=3),
}


def bench_calibration(lists: int) -> Iterator[dict[str, Any]]:
    """Yield how many of so many lists have a false verdict, by setting, distribution and number of seeds."""
    for truth, setting in SETTINGS.items():
        generator = np.random.default_rng([0, setting.stream])
        for name, draw in DISTRIBUTIONS.items():
            for seeds in SEEDS:
                wrong = sum(is_wrong(draw, seeds, setting, generator) for _ in range(lists))
                row = {"truth": truth, "distribution": name, "seeds": str(seeds), "lists": lists}
                upper = intervals.incidence_interval(wrong, lists, level=0.9).high  # one-sided, 95 %
                yield {**row, "false_rate": wrong / lists, "upper_bound": upper}


# --- Lists of claims ---------------------------------------------------------------------------------


def is_wrong(draw: Draw, seeds: int, setting: Setting, generator: np.random.Generator) -> bool:
    """Simulate a list; return whether any of its verdicts is false, in the claimed direction or in `less`."""
    level, is_false = 1 - ALPHA / sum(setting.sizes.values()), False
    for kind, size in setting.sizes.items():
        for _ in range(size):
            a, b, margin = make_arms(kind, draw, seeds, setting, generator)
            ends = compare(kind, a, b, level).simultaneous
            if setting.is_at_margin:
                is_false |= decide(ends, "greater", margin) == "does not hold"
            else:
                is_false |= "holds" in (decide(ends, "greater", margin), decide(ends, "less", None))
    return is_false


def make_arms(
    kind: str, draw: Draw, seeds: int, setting: Setting, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the two arms of a claim, and its margin."""
    few = max(seeds // setting.fewer, 2)
    if kind == "incidence":
        effect = SHARE_MARGIN * setting.is_at_margin
        a = (generator.random(few) < EVENT_SHARE + effect) * 1.0
        return a, (generator.random(seeds) < EVENT_SHARE) * 1.0, SHARE_MARGIN
    margin = ERRORS * float(np.sqrt(1 / few + setting.spread**-2 / seeds))
    a = draw(generator, few) + margin * setting.is_at_margin
    if kind == "spread":
        margin = SPREAD_MARGIN
    return a, draw(generator, seeds) / setting.spread, margin


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


def band_coverage(band: str, runs: np.ndarray) -> float:
    """Return how often a figure's band covers the mean 0 of (samples, runs); NaN for too few runs."""
    frame = Curve("", pd.DataFrame(runs)).frame(band).dropna()
    return float(((frame["low"] <= 0) & (frame["high"] >= 0)).mean())


def main(lists: int = 400) -> None:
    print_result(rows_result("false_verdicts", list(bench_calibration(lists))), "table")


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
