"""The intervals of `recompute_verdicts.py`, by SciPy, or written from what docs/claims.md says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np
from scipy import stats

Ends = tuple[float, float] | None
"""Of an interval; None if there is none."""


def interval(
    kind: str,
    a: Sequence[str],
    b: Sequence[str],
    values: Mapping[str, np.ndarray],
    constant: float,
    alpha: float,
) -> tuple[float, Ends]:
    """Return the effect and the ends of its interval; none if an arm shows nothing of how runs differ."""
    if kind == "range":
        return of_range(a, b, values, constant, alpha)
    if kind in ("main-effect", "interaction"):
        share = 1 / len(a) if kind == "main-effect" else 1.0
        signs = [1.0] * len(a) if kind == "main-effect" else [1.0, -1.0]
        parts = [(values[name], share * sign) for name, sign in zip(a, signs, strict=True)]
        parts += [(values[name], -share * sign) for name, sign in zip(b, signs, strict=True)]
        return of_sum(parts, alpha)
    if kind == "hazard":
        return of_hazard(values[a[0]], values[b[0]], alpha)
    first, second = values[a[0]], values[b[0]] if b else None
    if kind == "incidence":
        return of_shares(first, second, constant, alpha)
    if kind == "spread":
        assert second is not None
        first, second = (abs(own - np.median(own)) for own in (first, second))
    effect = first.mean() - (constant if second is None else second.mean())
    if any(varies_not(own) for own in (first, second) if own is not None):
        return effect, None
    if second is None:
        test = stats.ttest_1samp(first - constant, 0)
    else:
        test = stats.ttest_ind(first, second, equal_var=kind == "spread")
    found = test.confidence_interval(1 - alpha)
    return effect, (found.low, found.high)


def varies_not(runs: np.ndarray) -> bool:
    return len(runs) < 2 or np.ptp(runs) <= 1e-12 * abs(runs).max()


def of_sum(parts: Sequence[tuple[np.ndarray, float]], alpha: float) -> tuple[float, Ends]:
    """Return the interval of a weighted sum of means, with Satterthwaite's degrees of freedom."""
    effect = sum(weight * runs.mean() for runs, weight in parts)
    if any(varies_not(runs) for runs, _ in parts):
        return effect, None
    errors = [weight**2 * runs.var(ddof=1) / len(runs) for runs, weight in parts]
    freedom = sum(errors) ** 2 / sum(
        e**2 / (len(runs) - 1) for e, (runs, _) in zip(errors, parts, strict=True)
    )
    half = stats.t.ppf(1 - alpha / 2, freedom) * sum(errors) ** 0.5
    return effect, (effect - half, effect + half)


def of_hazard(first: np.ndarray, second: np.ndarray, alpha: float) -> tuple[float, Ends]:
    """Return Peto's logarithm of the ratio of two rates: (observed less expected) by the variance."""
    surplus, variance = 0.0, 0.0
    for time in sorted({*first[0][first[1] > 0], *second[0][second[1] > 0]}):
        group = np.array([(first[0] >= time).sum(), (second[0] >= time).sum()])
        deaths = np.array([sum((arm[0] == time) * arm[1]) for arm in (first, second)])
        share = group[0] / group.sum()
        surplus += deaths[0] - deaths.sum() * share
        if group.sum() > 1:
            left = (group.sum() - deaths.sum()) / (group.sum() - 1)
            variance += deaths.sum() * share * (1 - share) * left
    if not variance:
        return float("nan"), None
    half = stats.norm.ppf(1 - alpha / 2) / variance**0.5
    return surplus / variance, (surplus / variance - half, surplus / variance + half)


def of_shares(
    first: np.ndarray, second: np.ndarray | None, constant: float, alpha: float
) -> tuple[float, tuple[float, float]]:
    if second is None:
        found = stats.binomtest(int(first.sum()), len(first)).proportion_ci(1 - alpha, method="exact")
        return first.mean() - constant, (found.low - constant, found.high - constant)
    exact = [
        stats.binomtest(int(own.sum()), len(own)).proportion_ci(1 - alpha, method="exact")
        for own in (first, second)
    ]
    (p, one), (q, two) = (first.mean(), exact[0]), (second.mean(), exact[1])
    low = p - q - ((p - one.low) ** 2 + (two.high - q) ** 2) ** 0.5
    high = p - q + ((one.high - p) ** 2 + (q - two.low) ** 2) ** 0.5
    return p - q, (low, high)


def of_range(
    a: Sequence[str], b: Sequence[str], values: Mapping[str, np.ndarray], constant: float, alpha: float
) -> tuple[float, Ends]:
    """Compare each step from arm to arm of a with each of b; arms that both have cancel, or count twice."""
    steps_a: list[tuple[str, ...]] = [*permutations(a, 2)]
    steps_b: list[tuple[str, ...]] = [*permutations(b, 2)] or [()]
    effects, lows, highs = (np.empty((len(steps_a), len(steps_b))) for _ in range(3))
    for place in np.ndindex(effects.shape):
        weight = Counter[str]()
        for step, sign in ((steps_a[place[0]], 1), (steps_b[place[1]], -1)):
            if step:
                weight[step[0]] += sign
                weight[step[1]] -= sign
        parts = [(values[name], count) for name, count in weight.items() if count]
        effect = sum(count * own.mean() for own, count in parts) - constant
        errors = [count**2 * own.var(ddof=1) / len(own) for own, count in parts]
        rest = sum(error**2 / (len(own) - 1) for error, (own, _) in zip(errors, parts, strict=True))
        freedom = sum(errors) ** 2 / rest if rest else 1
        low, high = (
            stats.t.ppf(1 - alpha / 2 / len(steps), freedom) * sum(errors) ** 0.5
            for steps in (steps_a, steps_b)
        )
        effects[place], lows[place], highs[place] = effect, effect - low, effect + high
    seen = effects.min(axis=1).max()
    if any(varies_not(values[name]) for name in {*a, *b}):
        return seen, None
    return seen, (lows.min(axis=1).max(), highs.max(axis=0).min())
