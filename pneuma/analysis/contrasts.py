"""Contrasts: one arm of runs against another, or against a constant, with an effect, an interval and tests.

A contrast carries five one-sided p-values, each valid by itself: that the effect is above no
difference, below it, within the margin on both sides, and beyond it, above and below. What they come to
for a claim is for `pneuma.analysis.verdicts`. Which test each kind uses, and what it assumes, is in
docs/evidence.md.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pneuma.analysis import incidence, intervals, permutation, two_arms
from pneuma.analysis.estimates import deviation, finite
from pneuma.analysis.intervals import Interval, no_interval
from pneuma.analysis.two_arms import OneSided, PValues, two_one_sided

CONTRAST_KINDS = ("mean", "spread", "incidence", "paired")
"""Difference of means; ratio of standard deviations; difference of shares of runs with an event (values
0 or 1); mean difference of runs that belong together one by one."""

CONSTANT_KINDS = ("mean", "incidence")
"""Which of them one arm can be held against a constant in."""

LEVEL = 0.05
"""The error rate at which too few seeds are called too few."""


@dataclass(frozen=True)
class Contrast:
    """What runs say on one comparison.

    Attributes:
        kind: one of `CONTRAST_KINDS`.
        effect: mean, or share, of a less that of b or the constant; or the ratio of deviations a over b.
        interval: its 95 % interval.
        p_greater: one-sided p-value that the effect is above no difference (0; or a ratio of 1).
        p_less: that it is below.
        p_equivalent: that it is within the margin on both sides; 1 where there is no margin.
        seeds: runs of a and of b; 0 for a constant.
        reason: what hinders a conclusion, in words; empty where nothing does.
        smallest_greater, smallest_less: the smallest p-value of either direction that so many runs can give.
        p_far_greater, p_far_less: that it is beyond the margin, above and below; 1 where there is none.
    """

    kind: str
    effect: float
    interval: Interval
    p_greater: float
    p_less: float
    p_equivalent: float
    seeds: tuple[int, int]
    reason: str = ""
    smallest_greater: float = 0.0
    smallest_less: float = 0.0
    p_far_greater: float = 1.0
    p_far_less: float = 1.0

    @property
    def p_different(self) -> float:
        """The two-sided p-value of a difference: twice the lesser of both directions."""
        return min(1.0, 2 * min(self.p_greater, self.p_less))

    @property
    def p_any(self) -> float:
        """The p-value of anything found: it bounds the chance of any false finding."""
        return min(self.p_different, self.p_equivalent)


def compare(
    kind: str, a: ArrayLike, b: ArrayLike, margin: float | None, generator: np.random.Generator
) -> Contrast:
    """Compare arm a with arm b.

    Args:
        kind: one of `CONTRAST_KINDS`.
        a: (runs,) finite values, one per run.
        b: the same of the other arm; of as many runs, in the same order, for "paired".
        margin: within what a difference counts as none: in the outcome's unit, or as a share, or as a
            ratio above 1 for "spread". None where no such claim can be made.
        generator: draws relabelings where there are too many to count.

    Raises:
        ValueError: for an unknown kind, values that are not finite, or a margin out of range.
    """
    first, second = finite(a), finite(b)
    _check(kind, CONTRAST_KINDS, margin)
    if kind == "paired" and first.size != second.size:
        raise ValueError(f"paired arms of {first.size} and {second.size} runs")
    fewest = 1 if kind == "incidence" else 2
    seeds = (first.size, second.size)
    if min(seeds) < fewest:
        return undecided(kind, _too_few(seeds, fewest), seeds, _effect(kind, first, second))
    if kind == "paired":
        return _one_sample(first - second, margin, generator, "paired", seeds)
    if kind == "incidence":
        return _incidence(first, second, margin)
    return (_mean if kind == "mean" else _spread)(first, second, margin, generator)


def compare_with(
    kind: str, a: ArrayLike, value: float, margin: float | None, generator: np.random.Generator
) -> Contrast:
    """Compare one arm with a constant: is its mean, or its share of runs, above or below it?

    Args:
        kind: one of `CONSTANT_KINDS`.
        a: (runs,) finite values.
        value: the constant, in their unit.
        margin: as for `compare`.
        generator: draws turns of signs where there are too many to count.

    Raises:
        ValueError: as for `compare`.
    """
    runs = finite(a)
    _check(kind, CONSTANT_KINDS, margin)
    seeds = (runs.size, 0)
    if kind == "incidence":
        return _incidence_with(runs, value, margin)
    if runs.size < 2:
        effect = float(runs[0] - value) if runs.size else float("nan")
        return undecided(kind, _too_few(seeds[:1], 2), seeds, effect)
    return _one_sample(runs - value, margin, generator, "mean", seeds)


def _check(kind: str, kinds: tuple[str, ...], margin: float | None) -> None:
    if kind not in kinds:
        raise ValueError(f"contrast of kind {kind!r}; there are " + ", ".join(kinds))
    if margin is not None and not margin > (1 if kind == "spread" else 0):
        raise ValueError(f"a margin of {margin} for a contrast of kind {kind}")


def _mean(a: np.ndarray, b: np.ndarray, margin: float | None, generator: np.random.Generator) -> Contrast:
    labels = permutation.relabel(a.size, b.size, generator)
    found = two_arms.mean_p_values(a[None], b[None], margin, labels)
    interval = intervals.difference_interval(a, b)
    return _contrast("mean", _effect("mean", a, b), interval, found, (a.size, b.size), labels.smallest_p)


def _spread(a: np.ndarray, b: np.ndarray, margin: float | None, generator: np.random.Generator) -> Contrast:
    seeds, effect = (a.size, b.size), _effect("spread", a, b)
    equal = [name for name, arm in (("a", a), ("b", b)) if not _differ(arm)]
    if equal:
        reason = f"all runs of arm {' and of arm '.join(equal)} are equal: there is no spread to compare"
        return undecided("spread", reason, seeds, effect)
    labels = permutation.relabel(a.size, b.size, generator)
    found = two_arms.spread_p_values(a[None], b[None], margin, labels)
    interval = intervals.deviation_ratio_interval(a, b)
    return _contrast("spread", effect, interval, found, seeds, labels.smallest_p)


def _incidence(a: np.ndarray, b: np.ndarray, margin: float | None) -> Contrast:
    counts_a, counts_b = np.array([_count(a)]), np.array([_count(b)])
    found = two_arms.incidence_p_values(counts_a, a.size, counts_b, b.size, margin)
    interval = intervals.incidence_difference_interval(counts_a[0], a.size, counts_b[0], b.size)
    most = two_arms.incidence_p_values(np.array([a.size]), a.size, np.array([0]), b.size, None)
    least = two_arms.incidence_p_values(np.array([0]), a.size, np.array([b.size]), b.size, None)
    seeds, smallest = (a.size, b.size), (float(most.greater[0]), float(least.less[0]))
    return _contrast("incidence", _effect("incidence", a, b), interval, found, seeds, *smallest)


def _one_sample(
    differences: np.ndarray,
    margin: float | None,
    generator: np.random.Generator,
    kind: str,
    seeds: tuple[int, int],
) -> Contrast:
    """Test a mean of differences by turning their signs, which supposes that they lie alike to both sides."""
    signs = permutation.sign_flips(differences.size, generator)
    shifts = np.array([0.0] if margin is None else [0.0, -margin, margin])
    samples = differences + shifts[:, None]
    size = np.abs(samples).max()  # so that units do not matter to what counts as equal
    p_greater, p_less = permutation.tails(signs @ (samples / (size or 1.0)).T)
    found = two_one_sided(p_greater, p_less, 1)
    interval = intervals.mean_interval(differences)
    return _contrast(kind, float(differences.mean()), interval, found, seeds, 1 / len(signs))


def _incidence_with(runs: np.ndarray, value: float, margin: float | None) -> Contrast:
    if not runs.size:
        return undecided("incidence", _too_few((0,), 1))
    count, above, below = _count(runs), incidence.p_share_above, incidence.p_share_below
    own = intervals.incidence_interval(count, runs.size)
    interval = Interval(own.low - value, own.high - value, own.level, own.method)

    def one_sided(share: float) -> OneSided:  # beyond an end of the scale no share can be
        p_above = 0.0 if share < 0 else 1.0 if share > 1 else above(count, runs.size, share)
        p_below = 0.0 if share > 1 else 1.0 if share < 0 else below(count, runs.size, share)
        return np.array([p_above]), np.array([p_below])

    beyond = (None, None) if margin is None else (one_sided(value + margin), one_sided(value - margin))
    found = two_arms.p_values(one_sided(value), *beyond)
    smallest = (above(runs.size, runs.size, value), below(0, runs.size, value))
    return _contrast("incidence", float(runs.mean() - value), interval, found, (runs.size, 0), *smallest)


def _contrast(
    kind: str,
    effect: float,
    interval: Interval,
    found: PValues,
    seeds: tuple[int, int],
    smallest_greater: float,
    smallest_less: float | None = None,
) -> Contrast:
    """Return the contrast of one sample; both directions have the same smallest p unless it is given."""
    greater, less, equivalent, far_greater, far_less = (float(p[0]) for p in found)
    smallest = (smallest_greater, smallest_greater if smallest_less is None else smallest_less)
    reason = _reason(min(smallest))
    return Contrast(
        kind, effect, interval, greater, less, equivalent, seeds, reason, *smallest, far_greater, far_less
    )


def _count(runs: np.ndarray) -> int:
    if not np.isin(runs, (0, 1)).all():
        raise ValueError("an incidence is of values 0 or 1")
    return int(runs.sum())


def _differ(arm: np.ndarray) -> bool:
    """Tell whether runs differ by more than rounding."""
    return bool(permutation.scaled(arm[None]).any())


def _effect(kind: str, a: np.ndarray, b: np.ndarray) -> float:
    if not a.size or not b.size:
        return float("nan")
    if kind != "spread":
        return float(a.mean() - b.mean())
    over, under = float(deviation(a)), float(deviation(b))
    if under == 0 or not _differ(b):
        return float("inf") if over > 0 and _differ(a) else float("nan")
    return over / under


def undecided(
    kind: str, reason: str, seeds: tuple[int, int] = (0, 0), effect: float = float("nan")
) -> Contrast:
    """Return a comparison that tells nothing, for a reason."""
    return Contrast(kind, effect, no_interval(), 1.0, 1.0, 1.0, seeds, reason, 1.0, 1.0)


def _too_few(seeds: tuple[int, ...], fewest: int) -> str:
    if min(seeds) == 0:
        return "an arm has no runs"
    return f"an arm has {min(seeds)} run{'s' * (min(seeds) > 1)}; it takes {fewest} to see how runs differ"


def _reason(smallest: float) -> str:
    if 2 * smallest <= LEVEL:
        return ""
    return f"too few seeds: the smallest p possible is {2 * smallest:.2g}"
