"""Crossed conditions: what each factor does, and whether it does the same at every level of another.

Each effect is tested with the others in the model, by Freedman and Lane's permutation of the residuals
of the model without it (Freedman and Lane 1983): exact where nothing else acts, close where it does.
Levels are coded as deviations from their mean, so that a main effect is the average over the other
factors' levels, each counted alike, however many runs each cell has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from pneuma.analysis.estimates import finite

DRAWS = 5_000


@dataclass(frozen=True)
class Effect:
    """One main effect or interaction.

    Attributes:
        factors: the factors that it joins; one is a main effect.
        degrees: of freedom: its own, and those that the model leaves to the errors.
        statistic: its F; inf where the model leaves no errors.
        p_value: by permutation; NaN where the design cannot tell it from others.
        share: of the variance that the model leaves without it, what it takes away (partial R²).
    """

    factors: tuple[str, ...]
    degrees: tuple[int, int]
    statistic: float
    p_value: float
    share: float


def factorial(
    values: ArrayLike,
    factors: Mapping[str, Sequence[str]],
    generator: np.random.Generator,
    order: int = 2,
    draws: int = DRAWS,
) -> list[Effect]:
    """Return every main effect and interaction up to an order.

    Args:
        values: (runs,) finite.
        factors: name to the (runs,) levels that each run had; balanced or not.
        generator: draws the permutations.
        order: how many factors an interaction may join.
        draws: how many permutations.
    """
    runs = finite(values)
    terms = [names for size in range(1, order + 1) for names in combinations(factors, size)]
    columns = {names: _columns([factors[name] for name in names]) for names in terms}
    shuffles = np.argsort(generator.random((draws, runs.size)), axis=1)
    return [_effect(names, runs, columns, shuffles) for names in terms]


def _columns(factors: list[Sequence[str]]) -> np.ndarray:
    """Return the sum-to-zero coding of a factor, or of an interaction, (runs, columns)."""
    coded = np.ones((len(factors[0]), 1))
    for levels in factors:
        names, index = np.unique(np.asarray(levels), return_inverse=True)
        own = np.vstack([np.eye(names.size - 1), -np.ones(names.size - 1)])[index]
        coded = (coded[:, :, None] * own[:, None, :]).reshape(len(index), -1)
    return coded


def _effect(
    names: tuple[str, ...],
    runs: np.ndarray,
    columns: Mapping[tuple[str, ...], np.ndarray],
    shuffles: np.ndarray,
) -> Effect:
    constant = np.ones((runs.size, 1))
    others = np.hstack([constant, *(own for term, own in columns.items() if term != names)])
    reduced, full = _basis(others), _basis(np.hstack([others, columns[names]]))
    gained, left = full.shape[1] - reduced.shape[1], runs.size - full.shape[1]
    degrees = columns[names].shape[1], left
    if gained < columns[names].shape[1] or gained == 0 or left < 1:
        return Effect(names, degrees, float("nan"), float("nan"), float("nan"))
    residuals = runs - reduced @ (reduced.T @ runs)
    if np.abs(residuals).max() <= 1e-12 * max(1.0, np.abs(runs).max()):
        return Effect(names, degrees, float("nan"), 1.0, float("nan"))
    # What is fitted lies in both models, and so takes no part in what either leaves.
    samples = np.vstack([residuals, residuals[shuffles]])  # (1 + draws, runs)
    tiny = 1e-12 * (residuals**2).sum()
    before = (samples**2).sum(axis=1) - ((samples @ reduced) ** 2).sum(axis=1)
    after = np.maximum((samples**2).sum(axis=1) - ((samples @ full) ** 2).sum(axis=1), tiny)
    taken = np.where(before - after > tiny, before - after, 0.0)  # rounding is no effect
    statistic = taken / gained / (after / left)
    p_value = float((statistic >= statistic[0] * (1 - 1e-9)).mean())
    found = float(statistic[0]) if after[0] > tiny else float("inf")
    return Effect(names, degrees, found, p_value, float(taken[0] / before[0]))


def _basis(columns: np.ndarray) -> np.ndarray:
    """Return orthonormal columns that span the same space, (runs, rank)."""
    left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, sizes > 1e-9 * sizes[0]]
