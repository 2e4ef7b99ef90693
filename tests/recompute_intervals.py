"""The intervals of `recompute_verdicts.py`, by SciPy, or written from docs/claims.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
from scipy import stats

Ends = tuple[float, float] | None
"""The ends of an interval; None if there is none."""
Values = Mapping[str, np.ndarray]


def interval(
    kind: str,
    a: Sequence[str],
    b: Sequence[str],
    values: Values,
    constant: float,
    alpha: float,
    most: float | None = None,
) -> tuple[float, Ends]:
    """Return the effect and the ends of its interval; no ends if the runs of a group do not differ.

    Unless the values are known to lie between 0 and `most`: then equal runs have an interval, too.
    """
    if kind == "hazard":
        return of_hazard(values[a[0]], values[b[0]], alpha)
    if kind == "incidence":
        return of_shares([values[name] for name in (*a, *b)], constant, alpha)
    if "spread" in kind:
        values = {name: abs(runs - np.median(runs)) for name, runs in values.items()}
    varies = all(
        len(runs) > 1 and np.ptp(runs) > 1e-12 * abs(runs).max()
        for runs in (values[name] for name in (*a, *b))
    )
    if kind == "range":
        effect, ends = of_range(a, b, values, constant, alpha)
    elif kind == "spread":  # of ratios: errors in proportion to the means, in logarithms
        if not varies:
            return float("nan"), None
        first, second = values[a[0]], values[b[0]]
        effect = float(np.log(first.mean()) - np.log(second.mean()))
        test = stats.ttest_ind(first / first.mean(), second / second.mean(), equal_var=False)
        ends = tuple(effect + np.array(test.confidence_interval(1 - alpha)))
    elif most is not None and not varies and kind in ("mean", "main-effect", "interaction"):
        return of_bounded(a, b, values, constant, alpha, most, kind)
    elif kind in ("main-effect", "interaction"):
        factors = {"main-effect": [1 / len(a)] * len(a), "interaction": [1.0, -1.0]}[kind]
        weights = Counter(dict(zip(a, factors, strict=True)))
        weights.subtract(dict(zip(b, factors, strict=True)))
        effect, error, freedom = of_sum(weights, values)
        half = stats.t.ppf(1 - alpha / 2, freedom) * error
        ends = effect - half, effect + half
    else:
        first = values[a[0]] - constant
        effect = first.mean() - sum(values[name].mean() for name in b)
        if not varies:
            return effect, None
        if b:
            test = stats.ttest_ind(first, values[b[0]], equal_var=kind == "difference of spreads")
        else:
            test = stats.ttest_1samp(first, 0)
        ends = tuple(test.confidence_interval(1 - alpha))
    return effect, ends if varies else None


def of_sum(weights: Mapping[str, float], values: Values) -> tuple[float, float, float]:
    """Return a weighted sum of means, its standard error and Satterthwaite's degrees of freedom."""
    effect = sum(weight * values[name].mean() for name, weight in weights.items())
    squares = {name: (weight * stats.sem(values[name])) ** 2 for name, weight in weights.items()}
    rest = sum(square**2 / (len(values[name]) - 1) for name, square in squares.items())
    total = sum(squares.values())
    return effect, total**0.5, total**2 / rest if rest else 1.0


def of_bounded(
    a: Sequence[str],
    b: Sequence[str],
    values: Values,
    constant: float,
    alpha: float,
    most: float,
    kind: str,
) -> tuple[float, Ends]:
    """Return a difference of means between 0 and `most`, with the ends of each mean, squared and added.

    Of equal runs a share may be unlike them that none of so many would show with a chance of alpha / 2.
    """
    assert kind == "mean", "no published main effect or interaction has equal runs"
    effect, squares = -constant, np.zeros(2)
    for names, sign in ((a, 1), (b, -1)):
        for name in names:
            runs = values[name]
            unlike = 1 - (alpha / 2) ** (1 / len(runs))
            distances = np.array([-unlike * runs[0], unlike * (most - runs[0])])
            if np.ptp(runs) > 0:
                distances = np.array([-1, 1]) * stats.sem(runs) * stats.t.ppf(1 - alpha / 2, len(runs) - 1)
            effect += sign * runs.mean()
            squares += np.sort(sign * distances) ** 2
    low, high = effect - squares[0] ** 0.5, effect + squares[1] ** 0.5
    return float(effect), (float(low), float(high))


def of_hazard(first: np.ndarray, second: np.ndarray, alpha: float) -> tuple[float, Ends]:
    """Return Peto's logarithm of the ratio of two rates: (observed minus expected) over the variance."""
    surplus, variance = 0.0, 0.0
    for time in sorted({*first[0][first[1] > 0], *second[0][second[1] > 0]}):
        at_risk = np.array([(group[0] >= time).sum() for group in (first, second)])
        deaths = np.array([sum((group[0] == time) * group[1]) for group in (first, second)])
        share = at_risk[0] / at_risk.sum()
        surplus += deaths[0] - deaths.sum() * share
        if at_risk.sum() > 1:
            left = (at_risk.sum() - deaths.sum()) / (at_risk.sum() - 1)
            variance += deaths.sum() * share * (1 - share) * left
    if not variance:
        return float("nan"), None
    half = stats.norm.ppf(1 - alpha / 2) / variance**0.5
    return surplus / variance, (surplus / variance - half, surplus / variance + half)


def of_shares(groups: Sequence[np.ndarray], constant: float, alpha: float) -> tuple[float, Ends]:
    tests = [stats.binomtest(int(runs.sum()), len(runs)) for runs in groups]
    (p, one), *others = [(test.statistic, test.proportion_ci(1 - alpha, method="exact")) for test in tests]
    if not others:
        return p - constant, (one.low - constant, one.high - constant)
    ((q, two),) = others
    low = p - q - ((p - one.low) ** 2 + (two.high - q) ** 2) ** 0.5
    high = p - q + ((one.high - p) ** 2 + (q - two.low) ** 2) ** 0.5
    return p - q, (low, high)


def of_range(
    a: Sequence[str], b: Sequence[str], values: Values, constant: float, alpha: float
) -> tuple[float, Ends]:
    """Compare each step from group to group of a with each of b; groups of both cancel, or count twice."""
    steps_a: list[tuple[str, ...]] = [*permutations(a, 2)]
    steps_b: list[tuple[str, ...]] = [*permutations(b, 2)] or [()]
    effects, lows, highs = np.empty((3, len(steps_a), len(steps_b)))
    for place in np.ndindex(effects.shape):
        weights = Counter(dict(zip(steps_a[place[0]], (1, -1), strict=True)))
        weights.update(dict(zip(steps_b[place[1]], (-1, 1), strict=False)))
        effect, error, freedom = of_sum(weights, values)
        low, high = (stats.t.ppf(1 - alpha / 2 / len(steps), freedom) * error for steps in (steps_a, steps_b))
        effects[place] = effect - constant
        lows[place], highs[place] = effects[place] - low, effects[place] + high
    return effects.min(axis=1).max(), (lows.min(axis=1).max(), highs.max(axis=0).min())
